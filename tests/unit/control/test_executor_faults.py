import logging
from dataclasses import replace

import numpy as np
import pytest
from harness.retarget import retarget

from so101_motion.common.errors import BusError, FollowingError, NotHolding
from so101_motion.common.modes import Mode
from so101_motion.planning.timing import online

Q_GOAL = np.array([0.6, -0.4, 0.5, -0.3, 1.0])


@pytest.fixture(autouse=True)
def expected_log(caplog):
    """A fault is logged once; keep it out of the test's output."""
    caplog.set_level(logging.CRITICAL, logger="so101_motion.control.joint_controller")


def start_moving(sim):
    future = sim.executor.execute(
        online.point_to_point(sim.state.q_ref, Q_GOAL, sim.limits, sim.dt)
    )
    sim.clock.advance(0.4)
    return future


def test_a_driver_that_raises_in_mid_motion_ends_everything_with_its_error(sim):
    move = start_moving(sim)
    stopping = sim.executor.stop()
    sim.clock.advance(0.01)
    unplugged = BusError("servo 3 does not answer")
    sim.arm.disconnect(unplugged)
    assert sim.error_after(0.01, move) is unplugged
    assert stopping.exception(timeout=0) is unplugged
    assert sim.state.mode is Mode.FAULT
    assert sim.state.fault == "servo 3 does not answer"
    assert not sim.state.arm_moving


def test_a_joint_that_fell_silent_while_it_lagged_is_not_sent_back_to_where_it_was(
    make_sim, taped_arm, clock
):
    class SilentArm(taped_arm):
        """Its first servo is not heard from the hundredth goal on."""

        heard = 0.0

        def read(self):
            reading = super().read()
            if len(self.tape) < 100:
                self.heard = reading.q[0]
                return reading
            q = np.array([self.heard, *reading.q[1:]])
            return replace(reading, q=q, unanswered=frozenset({"shoulder_pan"}))

    sim = make_sim(SilentArm(clock))
    sim.executor.start()
    error = sim.error_after(5.0, sim.executor.execute(sim.slow_move(3.0)))
    assert isinstance(error, FollowingError)
    steps = np.diff(sim.arm.goals[:, 0])
    assert steps.min() > -1e-3
    assert sim.state.mode is Mode.HOLDING


def test_a_fault_refuses_motion_and_says_why(sim):
    sim.arm.disconnect(BusError("servo 3 restarted: check it, then let the arm hold again"))
    sim.clock.advance(0.1)
    with pytest.raises(NotHolding, match=r"in a fault: .*check it; clear it, then let .* hold"):
        sim.after(0.1, retarget(sim.executor, Q_GOAL, sim.limits))


def test_holding_again_leads_out_of_a_fault_without_a_jump(sim):
    start_moving(sim)
    sim.arm.disconnect(BusError("unplugged"))
    sim.clock.advance(1.0)
    assert sim.state.mode is Mode.FAULT
    sim.arm.reconnect()
    sim.clock.advance(0.1)
    assert sim.state.mode is Mode.FAULT  # it is the user who says go on
    sim.after(0.0, sim.executor.hold())
    assert sim.state.mode is Mode.HOLDING
    assert sim.state.fault is None
    np.testing.assert_array_equal(sim.state.q_ref, sim.state.q)
    sim.after(5.0, start_moving(sim))


def test_holding_does_not_lead_out_of_a_fault_that_is_still_there(sim):
    sim.arm.disconnect(BusError("unplugged"))
    sim.clock.advance(0.1)
    with pytest.raises(BusError, match="unplugged"):
        sim.after(0.0, sim.executor.hold())
    assert sim.state.mode is Mode.FAULT


def test_joints_can_be_released_out_of_a_fault(sim):
    sim.arm.disconnect(BusError("unplugged"))
    sim.clock.advance(0.1)
    sim.arm.reconnect()
    sim.after(0.0, sim.executor.release())
    assert sim.state.mode is Mode.LIMP
    assert sim.state.fault is None


def test_a_driver_that_fails_to_let_go_is_a_fault(sim):
    sim.arm.disconnect(BusError("unplugged"))
    with pytest.raises(BusError, match="unplugged"):
        sim.after(0.0, sim.executor.release())
    assert sim.state.mode is Mode.FAULT


def test_the_snapshot_stays_fresh_in_a_fault(sim):
    sim.arm.disconnect(BusError("unplugged"))
    sim.clock.advance(0.1)
    sim.arm.reconnect()
    sim.clock.advance(10.0)
    assert sim.clock.now() - sim.state.t <= 0.05


def test_a_fault_is_logged_once(sim, caplog):
    caplog.set_level(logging.ERROR, logger="so101_motion.control.joint_controller")
    sim.arm.disconnect(BusError("unplugged"))
    sim.clock.advance(1.0)
    assert [record.getMessage() for record in caplog.records] == [
        "the arm is in a fault: unplugged"
    ]


def test_a_driver_that_fails_at_the_start_is_closed_and_the_error_reaches_the_caller(make_sim):
    sim = make_sim()
    sim.arm.disconnect(BusError("no servo answers"))
    with pytest.raises(BusError, match="no servo answers"):
        sim.executor.start()
    assert sim.arm.is_closed
    sim.executor.close()


def test_an_arm_in_a_fault_can_be_closed(sim):
    start_moving(sim)
    sim.arm.disconnect(BusError("unplugged"))
    sim.clock.advance(0.1)
    sim.executor.close()
    assert sim.arm.is_closed


def test_a_listener_for_failures_that_fails_itself_ends_nothing_else(sim):
    def no_threads(error, recent):
        raise RuntimeError("can't start new thread")

    sim.executor.on_failure(no_threads)
    motion = sim.executor.execute(sim.to_goal(Q_GOAL))
    sim.clock.advance(0.1)
    sim.arm.disconnect(ConnectionError("the cable"))
    with pytest.raises(ConnectionError):
        sim.after(0.1, motion)
    sim.arm.reconnect()
    sim.after(0.1, sim.executor.stop())
    sim.after(0.1, sim.executor.hold())
    assert sim.state.mode is Mode.HOLDING
