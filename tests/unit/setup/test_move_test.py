"""The test motions on simulated joints, planned by the real planner, on a clock the test drives."""

import threading

import numpy as np
import pytest

from so101_motion.common.clock import ManualClock
from so101_motion.common.geometry import SE3
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.planning.goals import JointGoal
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.setup.move_test import JAW_SWING, LIMITS, SWING, MoveTest

READY = np.radians([0.0, -45.0, 45.0, 60.0, 0.0])


@pytest.fixture(scope="module", autouse=True)
def planning_process():
    """One rig stays open, so that the others find the planning process running."""
    with open_simulated(clock=ManualClock()) as rig:
        rig.arm.plan(JointGoal(q=READY))
        yield


@pytest.fixture
def rig(clock):
    with open_simulated(clock=clock, q_start=READY, q_jaw_start=0.5) as rig:
        yield rig


def make(rig):
    return MoveTest(arm=rig.arm, gripper=rig.gripper, clock=rig.clock, name="simulated arm")


def carried_out(clock, call, meanwhile=lambda: None):
    """What ``call`` returns, time passing as it needs it."""
    found = []
    thread = threading.Thread(target=lambda: found.append(call()))
    thread.start()
    while thread.is_alive():
        clock.advance(0.05)
        meanwhile()
    thread.join()
    return found[0]


def test_an_outline_moves_nothing_and_says_what_will(rig, clock):
    before = rig.arm.state.q
    outline = make(rig).outline()
    clock.advance(1.0)
    np.testing.assert_array_equal(rig.arm.state.q, before)
    assert [swing.joint for swing in outline.swings] == [*ARM_JOINTS, GRIPPER_JOINT]
    assert outline.obstacles == ()
    assert "6° back and forth" in outline.sentence
    assert 10.0 < outline.duration < 60.0


def test_every_joint_moves_alone_within_what_was_said_and_comes_back(rig, clock):
    test = make(rig)
    outline, start = test.outline(), rig.arm.state
    seen, joints = [], []
    report = carried_out(
        clock,
        lambda: test.move_and_measure(outline, lambda progress: joints.append(progress.joint)),
        lambda: seen.append(rig.arm.state),
    )
    assert report.passed, report.text()
    assert joints == [*ARM_JOINTS, GRIPPER_JOINT, ""]
    off = np.abs([state.q_ref - start.q_ref for state in seen])
    assert np.max(off) == pytest.approx(SWING, abs=1e-6)
    moving = off > 1e-4
    assert np.max(np.sum(moving, axis=1)) == 1
    assert np.max(np.abs([state.qd_ref for state in seen])) <= LIMITS.velocity[0] + 1e-9
    np.testing.assert_allclose(rig.arm.state.q, start.q, atol=1e-3)
    jaw = [state.q_jaw for state in seen]
    width = rig.gripper.opened - rig.gripper.closed
    assert max(jaw) - start.q_jaw == pytest.approx(JAW_SWING * width, rel=0.05)
    assert rig.gripper.q_jaw == pytest.approx(start.q_jaw, abs=0.01)
    assert all(joint.lag is not None for joint in report.joints[:5])


@pytest.mark.parametrize("moving", [True, False], ids=["while it moves", "while it is measured"])
def test_a_stop_ends_the_test(rig, clock, moving):
    test = make(rig)
    outline, start = test.outline(), rig.arm.state.q_ref
    stops = []

    def stop_once():
        state = rig.arm.state
        has_left = np.max(np.abs(state.q_ref - start)) > 0.5 * SWING
        if has_left and state.arm_moving is moving and not stops:
            stops.append(threading.Thread(target=rig.arm.stop))
            stops[0].start()

    report = carried_out(clock, lambda: test.move_and_measure(outline), stop_once)
    stops[0].join()
    assert not report.passed
    assert "the arm holds" in report.ended_by
    assert [joint.verdict for joint in report.joints[2:]] == ["not tested"] * 4
    q = rig.arm.state.q
    clock.advance(2.0)
    np.testing.assert_allclose(rig.arm.state.q, q, atol=1e-3)


def test_a_cancelled_test_ends_like_a_stopped_one(rig, clock):
    test = make(rig)
    outline = test.outline()

    def cancel():
        if rig.arm.is_moving:
            test.cancel()

    report = carried_out(clock, lambda: test.move_and_measure(outline), cancel)
    assert "the arm holds" in report.ended_by
    assert not rig.arm.is_moving


def test_a_test_that_was_cancelled_before_it_began_does_not_move(rig, clock):
    test, start = make(rig), rig.arm.state.q
    outline = test.outline()
    test.cancel()
    report = carried_out(clock, lambda: test.move_and_measure(outline))
    assert not report.passed
    np.testing.assert_allclose(rig.arm.state.q, start, atol=np.radians(0.5))


def test_a_joint_near_its_end_swings_to_the_other_side_only(clock):
    q = READY.copy()
    q[4] = np.radians(160.0)
    with open_simulated(clock=clock, q_start=q) as rig:
        outline = make(rig).outline()
    roll = outline.swings[4]
    assert max(roll.stops) == pytest.approx(q[4], abs=1e-6)
    assert min(roll.stops) == pytest.approx(q[4] - 2.0 * SWING, abs=1e-6)
    assert (roll.stops[0], roll.stops[-1]) == pytest.approx((q[4], q[4]), abs=1e-6)


def test_a_joint_that_cannot_move_freely_is_named_and_left_out(rig):
    tip = rig.arm.model.frame(READY, "jaw_tip").p
    walls = tuple(
        Obstacle(
            name=f"wall {side}",
            shape=Box(size=np.array([0.3, 0.01, 0.3])),
            T_base_obstacle=SE3.from_translation(tip + np.array([0.0, side * 0.05, 0.1])),
        )
        for side in (-1.0, 1.0)
    )
    rig.arm.scene = Scene(obstacles=walls)
    outline = make(rig).outline()
    blocked = dict(outline.obstacles)
    assert "shoulder_pan" in blocked
    assert "more open pose" in blocked["shoulder_pan"]
    assert "shoulder_pan" not in [swing.joint for swing in outline.swings]
