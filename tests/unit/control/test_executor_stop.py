import threading

import numpy as np
import pytest
from harness.retarget import retarget

from so101_motion.common.errors import Interrupted, MotionError
from so101_motion.common.modes import Mode
from so101_motion.control.executor import Channel
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits

Q_GOAL = np.array([1.2, -0.8, 1.0, -0.6, 2.0])
JAW_LIMITS = MotionLimits.uniform(velocity=2.0, acceleration=10.0, jerk=100.0, n=1)


def start_moving(sim, for_=0.8):
    future = sim.executor.execute(online.point_to_point(np.zeros(5), Q_GOAL, sim.limits, sim.dt))
    sim.clock.advance(for_)
    return future


def test_the_next_setpoint_after_a_stop_already_slows_down(sim):
    move = start_moving(sim)
    asked = sim.clock.now()
    sim.arm.tape.clear()
    before = sim.state
    stopped = sim.executor.stop()
    sim.clock.advance(2 * sim.dt)
    assert sim.state.mode is Mode.STOPPING
    speeds = np.diff(np.vstack([before.q_ref, sim.arm.goals]), axis=0) / sim.dt
    assert sim.arm.times[0] - asked <= 2 * sim.dt
    assert np.all(np.abs(speeds[0]) < np.abs(before.qd_ref))
    assert np.all(np.abs(speeds[1]) < np.abs(speeds[0]))
    sim.after(2.0, stopped)
    assert move.exception(timeout=0).by == "stop"


@pytest.mark.parametrize("for_", [0.05, 0.3, 0.8, 1.3, 1.6])
def test_stop_keeps_within_speed_acceleration_and_jerk(sim, for_):
    start_moving(sim, for_)
    sim.after(2.0, sim.executor.stop())
    q = sim.arm.goals[1:]
    for limit, order in (("velocity", 1), ("acceleration", 2), ("jerk", 3)):
        cap = max(getattr(sim.limits, limit)[0], getattr(sim.stop_limits, limit)[0])
        assert np.max(np.abs(np.diff(q, order, axis=0))) / sim.dt**order <= cap * 1.02


def test_stop_stays_on_the_path_that_was_being_followed(sim):
    start_moving(sim)
    sim.after(2.0, sim.executor.stop())
    along = sim.state.q_ref @ Q_GOAL / (Q_GOAL @ Q_GOAL)
    assert 0.0 < along < 1.0
    np.testing.assert_allclose(
        sim.arm.goals[1:] @ Q_GOAL / (Q_GOAL @ Q_GOAL) * Q_GOAL[:, None],
        sim.arm.goals[1:].T,
        atol=1e-6,
    )


def test_a_stop_is_over_when_the_joints_are_at_rest(sim):
    move = start_moving(sim)
    stopped = sim.executor.stop()
    while not stopped.done():
        assert not move.done()
        sim.clock.advance(sim.dt)
    assert move.done()
    assert np.max(np.abs(sim.state.qd)) <= 0.01
    assert sim.state.mode is Mode.HOLDING
    held = sim.state.q_ref
    sim.clock.advance(1.0)
    np.testing.assert_allclose(sim.state.q, held, atol=1e-6)


@pytest.mark.parametrize("mode", [Mode.HOLDING, Mode.LIMP])
def test_stopping_what_does_not_move_is_over_at_once(sim, mode):
    if mode is Mode.LIMP:
        sim.after(0.0, sim.executor.release())
    assert sim.after(0.0, sim.executor.stop()) is None
    assert sim.state.mode is mode


def test_a_second_stop_joins_the_first_and_the_first_reason_counts(sim):
    move = start_moving(sim)
    first = sim.executor.stop(by="cancelled")
    sim.clock.advance(0.05)
    second = sim.executor.stop()
    sim.clock.advance(2.0)
    assert first.done()
    assert second.done()
    assert move.exception(timeout=0).by == "cancelled"


def test_a_motion_asked_for_before_the_stop_never_begins(sim):
    sim.arm.tape.clear()
    trajectory = online.point_to_point(np.zeros(5), Q_GOAL, sim.limits, sim.dt)
    entered, leave = threading.Event(), threading.Event()  # the I/O thread is busy meanwhile
    gate = sim.executor.call(lambda _: entered.set() or leave.wait(60.0))
    entered.wait(60.0)
    move = sim.executor.execute(trajectory)
    stopped = sim.executor.stop()
    assert move.exception(timeout=0).by == "stop"
    leave.set()
    sim.clock.advance(1.0)
    assert gate.done()
    assert stopped.done()
    assert sim.arm.tape == []


def test_a_motion_asked_for_after_a_stop_at_rest_begins(sim):
    sim.executor.stop()
    move = start_moving(sim)
    sim.after(5.0, move)


@pytest.mark.parametrize("turns", [False, True])
def test_a_stop_cannot_be_undone_by_a_newer_motion(sim, turns):
    start_moving(sim)
    stopped = sim.executor.stop()
    sim.clock.advance(0.03)
    if turns:
        newer = retarget(sim.executor, np.zeros(5), sim.limits)
    else:
        newer = sim.executor.execute(
            online.point_to_point(sim.state.q_ref, Q_GOAL, sim.limits, sim.dt)
        )
    assert isinstance(sim.error_after(0.01, newer), MotionError)
    sim.after(2.0, stopped)


def test_stopping_the_jaw_leaves_the_arm_alone(sim):
    arm = start_moving(sim, 0.1)
    jaw = retarget(sim.executor, np.array([1.0]), JAW_LIMITS, channel=Channel.JAW)
    sim.clock.advance(0.3)
    stopped = sim.executor.stop(Channel.JAW)
    sim.clock.advance(0.02)
    assert sim.state.mode is Mode.MOVING
    sim.after(1.0, stopped)
    assert isinstance(jaw.exception(timeout=0), Interrupted)
    assert 0.0 < sim.state.q_jaw_ref < 1.0
    sim.after(5.0, arm)


def test_the_jaw_may_set_off_while_the_arm_is_stopping(sim):
    start_moving(sim)
    stopped = sim.executor.stop(Channel.ARM)
    sim.clock.advance(0.02)
    jaw = retarget(sim.executor, np.array([1.0]), JAW_LIMITS, channel=Channel.JAW)
    sim.after(3.0, jaw)
    assert stopped.done()


def test_stopping_everything_waits_for_both(sim):
    start_moving(sim, 0.8)
    retarget(sim.executor, np.array([1.0]), JAW_LIMITS, channel=Channel.JAW)
    sim.clock.advance(0.3)
    stopped = sim.executor.stop()
    while not stopped.done():
        sim.clock.advance(sim.dt)
    assert not sim.state.arm_moving
    assert not sim.state.jaw_moving


def test_interrupting_ends_that_motion_and_completes_at_rest(sim):
    move = start_moving(sim)
    sim.after(2.0, sim.executor.interrupt(move, "cancelled"))
    assert move.exception(timeout=0).by == "cancelled"
    assert not sim.state.arm_moving


def test_interrupting_a_motion_that_is_over_leaves_its_successor_alone(sim):
    first = start_moving(sim, 5.0)
    second = retarget(sim.executor, np.zeros(5), sim.limits)
    sim.clock.advance(0.5)
    sim.after(0.0, sim.executor.interrupt(first, "cancelled"))
    sim.after(5.0, second)


def test_interrupting_the_motion_that_a_newer_one_has_just_superseded_does_nothing(sim):
    first = start_moving(sim)
    second = retarget(sim.executor, np.zeros(5), sim.limits)
    interrupted = sim.executor.interrupt(first, "a newer motion")
    sim.after(0.01, interrupted)
    assert first.exception(timeout=0).by == "a newer motion"
    sim.after(5.0, second)


def test_interrupting_a_motion_before_its_first_setpoint_keeps_the_arm_where_it_is(sim):
    move = sim.executor.execute(online.point_to_point(np.zeros(5), Q_GOAL, sim.limits, sim.dt))
    sim.after(1.0, sim.executor.interrupt(move, "cancelled"))
    assert move.exception(timeout=0).by == "cancelled"
    assert np.max(np.abs(sim.state.q)) < 1e-5


def test_a_stop_while_settling_ends_the_motion_as_interrupted(sim):
    move = start_moving(sim, 0.0)
    while sim.state.arm_moving and np.any(sim.state.q_ref != Q_GOAL):
        sim.clock.advance(sim.dt)
    sim.after(1.0, sim.executor.stop())
    assert move.exception(timeout=0).by == "stop"
    np.testing.assert_array_equal(sim.state.q_ref, Q_GOAL)


def test_the_outcome_is_seen_only_after_the_state_shows_it(sim):
    seen = []
    move = start_moving(sim)
    move.add_done_callback(lambda _: seen.append((sim.state.arm_moving, sim.state.mode)))
    sim.executor.stop()
    sim.clock.advance(2.0)
    assert seen == [(False, Mode.HOLDING)]
