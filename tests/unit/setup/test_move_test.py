"""The test motions on simulated joints, planned by the real planner, on a clock the test drives."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from so101_motion.common.errors import NotPossibleNow
from so101_motion.common.geometry import SE3
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.setup.move_test import (
    JAW_SWING,
    LIMITS,
    SWING,
    JointAccuracy,
    MoveReport,
    MoveTest,
)

pytestmark = pytest.mark.usefixtures("planning_process")

READY = np.radians([0.0, -45.0, 45.0, 60.0, 0.0])


@pytest.fixture
def rig(clock):
    with open_simulated(clock=clock, q_start=READY, q_jaw_start=0.5) as rig:
        yield rig


def make(rig):
    return MoveTest(rig, name="simulated arm")


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
        lambda: test.move_and_measure(outline, lambda joint, _share: joints.append(joint)),
        lambda: seen.append(rig.arm.state),
    )
    assert report.passed, report.text()
    assert joints == [*ARM_JOINTS, GRIPPER_JOINT]
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


# As an operation


def offered(view):
    return [offer.title for offer in view.offers if offer.why_not is None]


def pass_until(clock, is_so):
    while not is_so():
        clock.advance(0.05)


def test_it_is_planned_by_itself_moves_when_told_and_asks_how_the_arm_moved(rig, clock):
    test = make(rig)
    assert test.view.offer("plan").due_in == 0.0
    with pytest.raises(NotPossibleNow, match="plan the test first"):
        test.ask("move")
    test.ask("plan")
    view = test.view
    assert view.text.startswith("This will move: shoulder_pan, ")
    assert view.offer("move").asks
    test.ask("move")
    pass_until(clock, lambda: test.view.rows and test.view.rows[0].mark == "✓")
    view = test.view
    assert view.doing == "moving shoulder_lift; Space or Stop ends it"
    assert view.picture.lit == ("shoulder_lift",)
    assert [row.mark for row in view.rows] == ["✓", "●", *"○○○○"]
    assert offered(view) == ["Stop the test"]
    pass_until(clock, lambda: not test.is_running)
    view = test.view
    assert view.text.startswith("Passed: all joints move as commanded. Did the arm move as in")
    assert (offered(view), view.is_over) == (["Yes", "No, it differs", "Test again"], False)
    test.ask("answer", as_shown=True)
    assert (offered(test.view), test.view.is_over) == (["Test again"], True)
    test.ask("answer", as_shown=False)
    assert "Two motors may be swapped" in test.view.trouble


def test_a_plan_is_no_good_once_the_arm_was_moved_by_hand(rig, clock):
    test = make(rig)
    test.ask("plan")
    rig.arm.set_torque(False)
    clock.advance(0.1)
    view = test.view
    assert "Move it by hand to a pose like the blue ghost's" in view.text
    assert (offered(view), len(view.picture.ghost)) == (["Hold the joints"], 6)
    test._q_planned = test._q_planned + 0.1
    rig.arm.set_torque(True)
    clock.advance(0.1)
    assert test.view.offer("plan").due_in == 0.0
    with pytest.raises(NotPossibleNow):
        test.ask("move")


@pytest.mark.parametrize("stops", ["the command", "the arm"])
def test_a_stopped_test_offers_another_and_is_not_shown_of_a_limp_arm(rig, clock, stops):
    test = make(rig)
    test.ask("plan")
    test.ask("move")
    pass_until(clock, lambda: rig.arm.is_moving)
    stop = threading.Thread(target=rig.arm.stop if stops == "the arm" else test.close)
    stop.start()
    pass_until(clock, lambda: not stop.is_alive() and not test.is_running)
    view = test.view
    assert view.trouble == "The test was not finished: it was stopped, and the arm holds"
    assert (view.fix, offered(view)) == ("test again", ["Test again"])
    rig.arm.set_torque(False)
    clock.advance(0.1)
    assert not test.view.trouble
    test.ask("plan")
    assert test.report is None


def test_what_is_wrong_is_named_once_with_all_its_joints(rig):
    test = make(rig)
    joints = [JointAccuracy(joint=joint) for joint in ARM_JOINTS]
    joints[:2] = [replace(joint, error=1.0) for joint in joints[:2]]
    test.report = MoveReport(arm="a", joints=tuple(joints), began_at="2026-01-02", seconds=1.0)
    rows = test.view.rows
    assert [row.text[:41] for row in rows if row.text] == [
        "shoulder_pan, shoulder_lift: it stops sho"
    ]
    assert "how far each joint rests" in test.view.note
    untested = (JointAccuracy(joint="elbow_flex"),)
    test.report = replace(test.report, joints=untested, ended_by="a stop")
    assert (test.view.rows, test.view.note) == ((), "")
