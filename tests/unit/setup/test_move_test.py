"""The test motions on simulated joints, planned by the real planner, on a clock the test drives."""

import json
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from harness.facing_arms import in_time
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.common.errors import NotPossibleNow
from so101_motion.common.geometry import SE3
from so101_motion.common.modes import Mode
from so101_motion.common.state import (
    ANSWERS_AGAIN,
    ARM_JOINTS,
    GRIPPER_JOINT,
    JointReading,
    JointState,
)
from so101_motion.common.units import to_rad
from so101_motion.planning.collision.scene import Box, Obstacle, Scene
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.setup.move_test import (
    JAW_SWING,
    LIMITS,
    SWING,
    JointAccuracy,
    Measurements,
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
    report = in_time(
        clock,
        lambda: test.move_and_measure(outline, lambda joint, _share: joints.append(joint)),
        lambda: seen.append(rig.arm.state),
    )
    assert report.passed, report.to_json()
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

    report = in_time(clock, lambda: test.move_and_measure(outline), stop_once)
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
    report = in_time(clock, lambda: test.move_and_measure(outline))
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
    pass_until(clock, lambda: rig.arm.state.arm_moving)
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


@pytest.mark.parametrize(
    ("fault", "first"),
    [("no reply from servo 4", "once that is fixed, press Hold"), (ANSWERS_AGAIN, "press Hold")],
)
def test_nothing_is_to_be_fixed_of_a_fault_that_has_gone(rig, fault, first):
    test = make(rig)
    test._arm = SimpleNamespace(state=replace(rig.arm.state, mode=Mode.FAULT, fault=fault))
    assert test.view.trouble == fault
    assert test.view.fix.startswith(first)


def test_nothing_is_moved_while_a_servo_has_an_alarm(rig):
    test = make(rig)
    test.ask("plan")
    assert test.view.offer("move").why_not is None
    state = rig.arm.state
    hot = replace(state.reading, alarms={"gripper": "its servo is too hot; let it cool"})
    test._arm = SimpleNamespace(state=replace(state, reading=hot))
    assert test.view.offer("move").why_not == "a servo has an alarm"


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


# What is computed from invented states of test motions


def state(t, *, q, q_ref, qd_ref, moving=True):
    """The arm with its first joint somewhere."""
    first = np.array([1.0, 0, 0, 0, 0])
    return JointState(
        t=t,
        mode=Mode.MOVING,
        reading=JointReading(q=q * first, qd=np.zeros(5), q_jaw=0.0, qd_jaw=0.0),
        q_ref=q_ref * first,
        qd_ref=qd_ref * first,
        q_jaw_ref=0.0,
        arm_moving=moving,
        jaw_moving=False,
        late_ticks=0,
    )


def ramp(lag, *, speed=0.2, duration=1.0, settles=0.0):
    """A joint that runs at ``speed`` and is late by ``lag``, then takes a while to settle."""
    times = np.arange(0.0, duration, 0.01)
    states = [state(t, q=speed * (t - lag), q_ref=speed * t, qd_ref=speed) for t in times]
    end = speed * duration
    rest = np.arange(duration, duration + settles, 0.01)
    return states + [state(t, q=end, q_ref=end, qd_ref=0.0) for t in rest]


@given(st.floats(0.001, 0.5), st.floats(0.01, 2.0), st.booleans())
def test_the_lag_is_that_of_the_joint_whichever_way_it_runs(lag, speed, backwards):
    measured = Measurements("shoulder_pan")
    measured.note_motion(0, ramp(lag, speed=-speed if backwards else speed))
    measured.note_stop(0.0, 0.0, is_from_below=True)
    assert measured.accuracy().lag == pytest.approx(lag, rel=1e-6)


def test_an_arm_that_does_not_tell_setpoints_apart_has_no_lag_and_no_settling():
    measured = Measurements("shoulder_pan")
    measured.note_motion(0, ramp(0.0))
    measured.note_stop(0.1, 0.1, is_from_below=True)
    found = measured.accuracy()
    assert (found.lag, found.settle, found.error) == (None, None, 0.0)


def test_stops_are_compared_by_the_side_and_settling_counted_from_the_end_of_the_reference():
    measured = Measurements("shoulder_pan")
    measured.note_motion(0, ramp(0.05, settles=0.3))
    for wanted, here, is_from_below in (
        (0.1, 0.103, True), (0.0, 0.002, False), (-0.1, -0.1, False), (0.0, -0.003, True),
    ):  # fmt: skip
        measured.note_stop(wanted, here, is_from_below=is_from_below)
    found = measured.accuracy()
    assert found.settle == pytest.approx(0.3, abs=0.011)
    assert found.hysteresis == pytest.approx(0.005)
    assert found.error == pytest.approx(0.003)


@pytest.mark.parametrize(
    ("found", "verdict", "words"),
    [
        (JointAccuracy(joint="elbow_flex", error=0.001), "ok", ""),
        (JointAccuracy(joint="elbow_flex", error=to_rad(1.0)), "warn", "stops short"),
        (JointAccuracy(joint="elbow_flex", error=to_rad(2.0)), "fail", "stops short"),
        (JointAccuracy(joint="gripper", error=to_rad(2.0)), "ok", ""),
        (JointAccuracy(joint="elbow_flex", error=0.0, lag=0.2), "warn", "it lags"),
        (JointAccuracy(joint="elbow_flex", error=0.0, settle=3.0), "fail", "settles slowly"),
        (JointAccuracy(joint="elbow_flex", error=0.0, hysteresis=0.02), "warn", "play"),
        (JointAccuracy(joint="elbow_flex", error=0.0, trouble="hot"), "fail", "hot"),
        (JointAccuracy(joint="elbow_flex"), "not tested", ""),
    ],
)
def test_a_joint_is_judged_by_its_worst_figure(found, verdict, words):
    assert found.verdict == verdict
    assert words in found.sentence


WELL = MoveReport(
    arm="arm on /dev/a",
    joints=tuple(JointAccuracy(joint=joint, error=0.001, tool=0.001) for joint in ARM_JOINTS),
    began_at="2026-01-02T03:04:05+00:00",
    seconds=20.0,
)


def test_a_report_passes_when_all_joints_obey_and_nobody_saw_otherwise_and_is_a_file():
    assert WELL.passed
    assert replace(WELL, as_shown=True).passed
    assert not replace(WELL, as_shown=False).passed
    assert "may be swapped" in replace(WELL, as_shown=False).sentence
    assert not replace(WELL, ended_by="stop").passed
    untested = (*WELL.joints[:4], JointAccuracy(joint="wrist_roll"))
    assert replace(WELL, joints=untested).sentence == "Failed: wrist_roll"
    told = json.loads(WELL.file({"version": "1"}))
    assert told["schema"] == "so101/move-test/1"
    assert told["passed"] is True
    assert told["tool_mm"] == 1.0
    assert [joint["joint"] for joint in told["joints"]] == list(ARM_JOINTS)
