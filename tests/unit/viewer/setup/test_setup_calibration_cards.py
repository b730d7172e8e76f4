"""The calibration's pages, from calibrations of an emulated arm."""

import math
from dataclasses import replace

import pytest
from harness.calibration_rig import LentArm
from so101_viewer.page import cards

from so101_motion.calib.procedure import summary
from so101_motion.calib.procedure.session import Session
from so101_motion.calib.procedure.summary import HOMING_POSE, estimate_pose
from so101_motion.calib.procedure.view import JointView
from so101_motion.calib.record.record import JOINTS
from so101_motion.common.operation import Row

POSE_DEG = {joint: math.degrees(angle) for joint, angle in HOMING_POSE.items()}


@pytest.fixture
def arm() -> LentArm:
    return LentArm(calibrated=False)


@pytest.fixture
def session(tmp_path, monkeypatch) -> Session:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    return Session(tmp_path / "arm.json")


@pytest.fixture
def recording(session, arm) -> dict[str, JointView]:
    """Held in the pose, and recording."""
    arm.put_deg(**POSE_DEG)
    session.start(arm)
    session.set_homing()
    session.start_recording()
    arm.tick(3)
    return session.view.joints


# The pose


def told(session, former):
    view = session.view
    found = summary.hints(view.joints, estimate_pose(view.state, view.joints, former))
    return {hint.label: (hint.cells[0], hint.tone) for hint in found}


def test_a_joint_far_from_the_pose_is_reported_by_how_much(session):
    arm = LentArm()
    session.start(arm)
    arm.tick(3)
    former = {**HOMING_POSE, "elbow_flex": math.radians(43.0), "wrist_roll": math.radians(20.0)}
    found = told(session, former)
    assert found["elbow_flex"] == ("43° off", "warm")
    assert found["wrist_roll"] == ("17° off", "warm")  # its zero is where it is held
    assert found["shoulder_pan"] == ("there", "good")


def test_joints_that_were_never_calibrated_are_matched_by_eye(session, arm):
    session.start(arm)
    arm.tick(3)
    assert {tone for _, tone in told(session, {}).values()} == {"dim"}
    view = session.view
    seen = estimate_pose(view.state, view.joints, {})
    assert "Trust the arm" in summary.picture_note(seen, view.joints)


def test_a_silent_servo_is_named(session, arm):
    session.start(arm)
    found = told(session, {})  # nothing was read yet
    assert found["gripper"] == ("does not answer: check its cable", "bad")


# The travels


def test_bars_begin_in_the_middle_and_stay_on_the_bar(session, arm, recording):
    for steps in (0, 200, 900, 2000):
        lower, _ = arm.stops("shoulder_pan")
        arm.sweep("shoulder_pan", max(lower, arm.drive("shoulder_pan").shaft.output - steps))
        for travel in summary.travels(session.view.joints):
            begin, end = travel.bar
            assert 0.0 <= begin <= end <= 1.0
            assert begin - 0.01 <= travel.at <= end + 0.01
    pan = summary.travels(session.view.joints)[0]
    assert pan.bar == (pytest.approx(0.0, abs=0.02), pytest.approx(0.5, abs=0.03))
    assert not pan.mark


def test_bars_turn_complete_by_themselves(session, arm, recording):
    assert summary.left(session.view.joints) == tuple(j for j in JOINTS if j != "wrist_roll")
    arm.sweep_all()
    bars = summary.travels(session.view.joints)
    assert summary.left(session.view.joints) == ()
    assert all(row.mark and row.tone == "good" and not row.text for row in bars)
    assert all(row.bar[1] - row.bar[0] > 0.97 for row in bars)


def test_a_few_joints_that_stop_short_can_be_accepted_many_cannot(session, arm, recording):
    lower, upper = arm.stops("elbow_flex")
    arm.sweep_all(joints=[joint for joint in JOINTS if joint != "elbow_flex"])
    assert summary.acceptable(session.view.joints) == ()  # not moved at all
    arm.sweep("elbow_flex", lower, lower + (upper - lower) // 2)
    assert summary.acceptable(session.view.joints) == ("elbow_flex",)
    arm.put_deg(**POSE_DEG)
    fresh = {joint: replace(view, is_done=False) for joint, view in session.view.joints.items()}
    assert summary.acceptable(fresh) == ()


# The summary


def test_the_first_calibration_is_new_and_the_same_one_again_is_the_same(session, arm, recording):
    arm.sweep_all()
    session.stop_recording()
    joints = session.view.joints
    lines = summary.lines(joints, {})
    assert [line.cells[2] for line in lines] == ["new"] * 6
    assert [line.cells[0] for line in lines] == ["good"] * 6
    again = summary.lines(joints, summary.calibration_of(joints))
    assert [line.cells[2] for line in again] == ["the same"] * 6


def test_ends_that_have_moved_are_reported_in_degrees_whatever_the_offset(session, arm, recording):
    arm.sweep_all()
    session.stop_recording()
    joints = session.view.joints
    before = summary.calibration_of(joints)
    was = before["elbow_flex"]
    shifted = replace(
        was,
        homing_offset=was.homing_offset - 100,
        range_min=was.range_min + 100,
        range_max=was.range_max + 100 - 114,  # ten degrees less
    )
    lines = summary.lines(joints, {**before, "elbow_flex": shifted})
    assert [line.cells[2] for line in lines if line.label == "elbow_flex"] == ["+0.0° / +10.0°"]


def test_markup_escapes_what_comes_from_outside() -> None:
    evil = "<script>alert(1)</script>"
    row = Row(label=evil, cells=(evil,), text=evil, tone="warm", mark=evil, bar=(0.2, 0.4), at=0.3)
    pieces = (cards.rows((evil,), (row,)), cards.instruction(evil, evil), cards.failed(evil))
    assert all("<script>" not in piece for piece in pieces)
