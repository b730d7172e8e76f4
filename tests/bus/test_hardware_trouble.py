"""An arm on hardware in trouble: joints held fast, cables out, hot servos, the supply."""

from types import SimpleNamespace

import numpy as np
import pytest
from harness.emulated_rig import rad
from harness.held_calibration import filed
from so101_viewer.page import texts

from so101_motion.cli.plan_move import planned_move
from so101_motion.common.errors import PortUnavailable, ServoAlarm
from so101_motion.common.modes import Mode
from so101_motion.common.state import ANSWERS_AGAIN
from so101_motion.drivers.emulator.hand import Hand, parse_script
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal, LeaveContactGoal

# Trouble: reported by name, nothing else lost, over when it is cleared


def test_setting_up_anew_without_a_port_says_what_helps_and_succeeds_by_itself_later(bench):
    rig = bench.open()
    bench.advance(0.5)
    before = bench.q_deg
    bench.emulator.unplug()
    bench.advance(0.2)
    with pytest.raises(PortUnavailable, match="check the USB cable"):
        rig.reload()
    with pytest.raises(PortUnavailable, match=r"check the USB cable.*goes on trying"):
        bench.finish(rig.executor.hold())
    bench.emulator.plug()
    bench.advance(2.0)

    assert rig.servos.is_connected
    bench.finish(rig.executor.hold())
    assert bench.q_deg == pytest.approx(before, abs=0.5)


def test_servos_that_answer_again_are_not_said_to_be_silent_any_more(bench):
    rig = bench.open()
    bench.advance(0.5)
    bench.emulator.bus.faults.loss = 1.0
    bench.advance(1.0)
    assert "no servo answers" in rig.arm.state.fault
    bench.emulator.bus.faults.loss = 0.0
    bench.advance(1.0)
    assert (rig.arm.state.mode, rig.arm.state.fault) == (Mode.FAULT, ANSWERS_AGAIN)
    bench.finish(rig.executor.hold())
    assert rig.arm.state.fault is None
    bench.emulator.bus.faults.loss = 1.0
    bench.advance(1.0)
    bench.world.disconnect("elbow_flex")
    bench.emulator.bus.faults.loss = 0.0
    bench.advance(1.0)
    assert "no reply from servo 3 (elbow_flex)" in rig.arm.state.fault


class Weight:
    """What bears down on the shoulder for a while, more than its servo can hold [N m]."""

    def __init__(self, clock, until):
        self._clock, self._until = clock, until

    @property
    def busy(self):
        return self._clock.now() < self._until

    def torque(self, joint, t, q, qd):
        is_there = joint == "shoulder_lift" and t < self._until
        return 8.0 - 4.0 * qd if is_there and q < rad(66.0) else 0.0


def test_an_arm_that_is_pushed_until_a_servo_gives_up_stays_where_it_was_pushed(bench):
    """It would sink otherwise: a servo that has given up carries less than the arm weighs."""
    rig = bench.open()
    bench.finish(bench.go(rig, 0, 50, -60, 0, 0))
    here = bench.q_deg[1]
    bench.world.hand = Weight(bench.clock, until=bench.clock.now() + 3.0)
    bench.advance(2.8)
    pushed = bench.q_deg[1]
    bench.advance(2.2)  # let go at 3 s; what sank meanwhile is made up for within 2 s
    left = bench.q_deg
    bench.advance(3.0)

    assert left[1] == pytest.approx(pushed, abs=4.0)
    assert left[1] > here + 8.0
    assert bench.q_deg == pytest.approx(left, abs=0.1)
    assert not rig.arm.state.reading.alarms
    assert rig.servos.health[1].latched == ("overload",)
    bench.finish(bench.go(rig, 0, 50, -60, 0, 0))
    assert bench.q_deg[1] == pytest.approx(here, abs=0.6)


@pytest.mark.parametrize(("highest", "is_outside"), [(3350, False), (3000, True)])
def test_a_joint_whose_servo_has_let_go_is_named_and_holds_where_it_sank_to(
    bench, highest, is_outside
):
    file = filed(bench, elbow_flex=(4096 - highest, highest))
    rig = bench.open(calibration_file=file)
    bench.finish(bench.go(rig, 0, -45, 70, 0, 0))
    bench.advance(0.5)
    began = bench.q_deg[2]
    bench.world.warm("elbow_flex", 72.0)
    bench.advance(2.0)
    state = rig.arm.state
    assert bench.q_deg[2] > began + 8.0, "it sinks"
    assert texts.mode(state) == "elbow_flex has let go"
    assert "support the arm" in texts.blocked(state).text
    for jogs in (False, True):
        with pytest.raises(ServoAlarm, match=r"elbow_flex: .* has let go .* support the arm"):
            bench.finish(rig.arm.retarget(np.zeros(5)) if jogs else bench.go(rig, 0, 0, 0, 0, 0))
    with pytest.raises(ServoAlarm, match="let it cool below 55"):
        bench.finish(rig.arm.move(LeaveContactGoal(), wait=False))
    source = SimpleNamespace(open=lambda: SimpleNamespace(arm=rig.arm, close=lambda: None))
    with pytest.raises(ServoAlarm, match="let it cool below 55"):  # not that it is in the floor
        planned_move(source, "home", Scene(floor_z=0.5), 16, yes=True, as_json=True)
    bench.advance(2.5)  # until it lies on its stop
    sunk = bench.q_deg
    bench.world.warm("elbow_flex", 30.0)
    for _ in range(10):
        bench.advance(0.1)
        assert bench.q_deg == pytest.approx(sunk, abs=1.5), "nothing jumps"
    state = rig.arm.state
    assert (texts.mode(state), texts.blocked(state)) == ("Idle, holding", None)
    assert set(state.reading.out_of_range) == ({"elbow_flex"} if is_outside else set())
    bench.finish(bench.go(rig, 0, -45, 70, 0, 0))
    assert bench.q_deg[2] == pytest.approx(began, abs=0.6)


def test_a_warm_servo_slows_the_arm_down(bench):
    rig = bench.open()
    fast = rig.arm.plan(goal_of(30)).duration
    bench.world.warm("elbow_flex", 62.0)
    bench.advance(1.0)

    assert rig.arm.plan(goal_of(30)).duration > 1.3 * fast


def goal_of(pan_deg):
    return JointGoal(q=np.radians([float(pan_deg), 0, 0, 0, 0]))


def test_an_answer_lost_at_that_moment_does_not_bring_a_limp_joint_back(bench):
    rig = bench.open()
    bench.advance(0.5)
    rig.arm.set_torque(False)
    script = "0 shoulder_pan start\n0.5 shoulder_pan 40\n0.6 shoulder_pan release"
    bench.world.hand = Hand(parse_script(script), bench.clock.now())
    bench.advance(0.34)  # last seen 40 ms ago
    bench.emulator.bus.faults.lose_next = 6  # one reading of all servos
    here = bench.arm_deg(rig)[0]
    bench.finish(rig.executor.hold())

    assert np.degrees(rig.arm.state.q_ref[0]) == pytest.approx(here, abs=0.35)
