"""Joints outside their calibrated range: left where they are until a motion needs them."""

import numpy as np
import pytest
from harness.held_calibration import filed

from so101_motion.calib.record import record
from so101_motion.common.errors import FollowingError, Interrupted, MotionError
from so101_motion.common.modes import Mode
from so101_motion.control.limit_recovery import remarks
from so101_motion.drivers.emulator import registers as emu
from so101_motion.drivers.emulator.hand import Hand, parse_script

CRAWL_DEG = 14.0
"""Faster than this nobody comes in [deg/s]: 8 by our caps, 8.8 is the slowest the servos can, and
they break loose with a jerk. Less than the planner allows for leaving a bad start."""


def torque(bench, joint):
    return bench.world.servo(joint).memory.raw(emu.TORQUE_ENABLE)


def deg(ticks):
    return ticks * 360.0 / 4096.0


def speeds(bench, i, seconds):
    """How fast joint ``i`` is while time passes [deg/s]."""
    found, before = [], bench.q_deg[i]
    for _ in range(round(seconds / 0.1)):
        bench.advance(0.1)
        found.append(abs(bench.q_deg[i] - before) / 0.1)
        before = bench.q_deg[i]
    return found


def propped(bench, joint):
    """Something lies under a joint that would fall."""
    shaft = bench.world.servo(joint).drive.shaft
    if joint in ("shoulder_lift", "elbow_flex"):
        shaft.upper = shaft.output


# Being opened


def test_a_limp_joint_outside_stays_limp_and_the_others_are_held(bench):
    before = bench.q_deg
    rig = bench.open(calibration_file=filed(bench, shoulder_pan=(2130, 3000)))
    bench.advance(3.0)

    assert bench.q_deg == pytest.approx(before, abs=0.5)
    assert [torque(bench, i) for i in range(1, 7)] == [0, 1, 1, 1, 1, 1]
    assert rig.arm.state.mode is Mode.HOLDING
    (remark,) = remarks(rig.arm.state.reading)
    assert "shoulder_pan is 7." in remark
    assert "the next move brings it in, slowly" in remark


def test_holding_again_does_not_move_one_that_is_driven_either(bench):
    bench.open().close()
    rig = bench.open(calibration_file=filed(bench, shoulder_pan=(2130, 3000)))
    bench.advance(1.0)
    before = bench.q_deg
    rig.reload()
    bench.emulator.unplug()
    bench.advance(1.0)
    bench.emulator.plug()
    bench.advance(3.0)
    bench.finish(rig.executor.hold())
    bench.advance(1.0)

    assert bench.q_deg == pytest.approx(before, abs=0.5)
    assert torque(bench, 1) == 1


def test_one_that_is_pushed_inside_by_hand_is_held_when_it_is_asked_for(bench):
    rig = bench.open(calibration_file=filed(bench, shoulder_pan=(2130, 3000)))
    bench.advance(0.5)
    bench.world.servo("shoulder_pan").drive.shaft.put(2500.0)
    bench.advance(0.5)
    assert torque(bench, 1) == 0, "nobody has asked"
    q = rig.arm.state.q
    bench.finish(rig.arm.retarget(q))
    bench.advance(0.5)

    assert torque(bench, 1) == 1
    assert not rig.arm.state.reading.out_of_range
    assert bench.q_deg[0] == pytest.approx(deg(2500 - 2048), abs=0.5)


# Being moved


@pytest.mark.parametrize(
    ("driven", "joint", "ends"),
    [(True, "shoulder_lift", (1100, 1960)), (False, "elbow_flex", (1100, 1960))],
)
def test_a_move_brings_it_in_slowly_and_arrives(bench, driven, joint, ends):
    if driven:
        bench.open().close()
        bench.advance(0.5)
    else:
        propped(bench, joint)
    i = record.JOINTS.index(joint)
    rig = bench.open(calibration_file=filed(bench, **{joint: ends}))
    bench.advance(1.0)
    inside = rig.arm.state.reading.out_of_range[joint]
    assert rig.arm.state.q_ref[i] == inside
    goal = np.degrees(rig.arm.state.q_ref)
    goal[0 if i else 1] += 10.0
    goal[i] += 15.0 if inside < 0 else -15.0
    motion = bench.go(rig, *goal)
    bench.under_way(motion, rig, 0.0)
    coming = []
    while rig.arm.state.reading.out_of_range:
        coming += speeds(bench, i, 0.1)
        assert len(coming) < 50
    bench.finish(motion)

    assert max(coming) < CRAWL_DEG
    assert np.degrees(rig.arm.state.q) == pytest.approx(goal, abs=0.35)
    assert bench.world.servo(joint).memory.raw(emu.GOAL_VELOCITY) > 2000, "its caps are back"


def test_a_jaw_outside_comes_in_when_it_is_moved_and_not_when_the_arm_is(bench):
    rig = bench.open(calibration_file=filed(bench, gripper=(2120, 3300)))
    bench.advance(0.5)
    jaw = bench.q_deg[5]
    bench.finish(bench.go(rig, *(np.degrees(rig.arm.state.q_ref) + 10.0)))
    assert bench.q_deg[5] == pytest.approx(jaw, abs=0.5)
    motion = rig.gripper.move(0.3, wait=False)
    assert max(speeds(bench, 5, 0.4)) < CRAWL_DEG
    bench.finish(motion)

    assert rig.gripper.aperture == pytest.approx(0.3, abs=0.02)


def test_a_stop_on_the_way_in_stops_it_there(bench):
    i, joint = 1, "shoulder_lift"
    propped(bench, joint)
    rig = bench.open(calibration_file=filed(bench, **{joint: (1100, 1956)}))
    bench.advance(0.5)
    goal = np.degrees(rig.arm.state.q_ref) - np.array([0, 0, 0, 20.0, 0])
    motion = bench.go(rig, *goal)
    bench.under_way(motion, rig, 0.5)
    stopping = rig.executor.stop()
    here = bench.q_deg
    bench.finish(stopping)
    with pytest.raises(Interrupted):
        bench.finish(motion)
    bench.advance(2.0)

    assert deg(1956 - 2048) + 1.0 < here[i] < -1.0
    assert bench.q_deg[i] == pytest.approx(here[i], abs=4.0), "no goal, no trim"
    assert set(rig.arm.state.reading.out_of_range) == {joint}
    bench.finish(bench.go(rig, *goal))
    assert not rig.arm.state.reading.out_of_range


def test_one_that_cannot_come_in_ends_the_motion_by_name_and_is_left_alone(bench):
    rig = bench.open(calibration_file=filed(bench, shoulder_pan=(2130, 3000)))
    bench.advance(0.5)
    shaft = bench.world.servo("shoulder_pan").drive.shaft
    shaft.upper = shaft.output + 5
    motion = bench.go(rig, *(np.degrees(rig.arm.state.q_ref) + 10.0))
    with pytest.raises(FollowingError, match=r"shoulder_pan was outside.*did not come in"):
        bench.finish(motion)
    bench.advance(1.0)

    assert rig.arm.state.mode is Mode.HOLDING
    assert abs(rig.servos.health[0].load) < 0.1


def test_nothing_is_streamed_to_an_arm_with_a_joint_outside(bench):
    rig = bench.open(calibration_file=filed(bench, shoulder_pan=(2130, 3000)))
    bench.advance(0.5)
    stream = rig.arm.stream()
    with pytest.raises(MotionError, match="nothing can be streamed"):
        bench.finish(stream.future)


def test_a_servo_that_restarts_outside_its_limits_is_not_made_to_leap_inside(bench):
    bench.open().close()
    rig = bench.open(calibration_file=filed(bench, shoulder_pan=(2130, 3000)))
    bench.advance(0.5)
    bench.world.reboot("shoulder_pan")
    bench.advance(2.0)
    assert rig.arm.state.mode is Mode.FAULT
    bench.finish(rig.executor.hold())
    bench.advance(1.0)

    assert bench.q_deg[0] == pytest.approx(0.0, abs=0.5)
    assert torque(bench, 1) == 0
    bench.finish(bench.go(rig, *(np.degrees(rig.arm.state.q_ref) + 10.0)))


# Guided outside by a hand


@pytest.mark.parametrize(
    ("joint", "lets_go", "ending"), [("elbow_flex", True, "stop"), ("shoulder_pan", False, "hold")]
)
def test_a_joint_that_a_hand_guided_outside_stays_there_when_it_is_held(
    bench, joint, lets_go, ending
):
    i = ("shoulder_pan", "shoulder_lift", "elbow_flex").index(joint)
    rig = bench.open(calibration_file=filed(bench, **{joint: (1900, 2200)}))
    bench.advance(1.0)
    rig.arm.set_manual(True)
    bench.emulator.advance()
    there = bench.q_deg[i] + 40.0
    release = f"2.15 {joint} release\n" if lets_go else f"9.0 {joint} {there}\n"
    script = f"0.1 {joint} start\n2.1 {joint} {there}\n{release}"
    bench.world.hand = Hand(parse_script(script), bench.clock.now())
    bench.advance(2.2)
    before = bench.q_deg
    assert before[i] > deg(2200 - 2048) + 15.0

    (rig.arm.stop if ending == "stop" else lambda: rig.arm.set_manual(False))()
    fastest = max(speeds(bench, i, 1.0))

    assert fastest < CRAWL_DEG
    assert bench.q_deg == pytest.approx(before, abs=3.0)
    assert torque(bench, i + 1) == 1
    assert rig.arm.state.mode is Mode.HOLDING
    (remark,) = remarks(rig.arm.state.reading)
    assert f"{joint} is " in remark
