"""What a person is told of a calibration, and where the arm is drawn meanwhile."""

import math
from dataclasses import replace

import pytest
from harness.calibration_rig import LentArm, recording

from so101_motion.calib.procedure import summary
from so101_motion.calib.procedure.session import Session
from so101_motion.calib.procedure.summary import HOMING_POSE, estimate_pose
from so101_motion.calib.procedure.travel import ROLL
from so101_motion.calib.record.record import JOINTS

POSE_DEG = {joint: math.degrees(angle) for joint, angle in HOMING_POSE.items()}


@pytest.fixture
def session(file):
    return Session(file)


@pytest.fixture
def recorded(file, arm):
    """Held in the pose, and recording."""
    arm.put_deg(**POSE_DEG)
    session = recording(file, arm)
    arm.tick(3)
    return session


# Where the joints probably are


def seen(session, former=None):
    view = session.view
    return estimate_pose(view.state, view.joints, former or {})


def truth(arm, joint):
    """The angle of an emulated joint [rad]."""
    drive = arm.drive(joint)
    return (drive.shaft.output - drive.to_ticks(0.0)) * 2 * math.pi / 4096


def test_before_anything_is_known_the_arm_is_drawn_in_the_pose_that_is_asked_for(session):
    found = seen(session)
    assert dict(found.angles) == dict(HOMING_POSE)
    assert found.guessed == set(JOINTS)


def test_a_former_calibration_tells_where_its_joints_are_but_not_those_of_new_servos(file):
    arm, session = LentArm(), Session(file)
    session.start(arm)
    arm.tick(3)
    found = seen(session, former={"elbow_flex": 0.3})
    assert found.angles["elbow_flex"] == 0.3
    assert "elbow_flex" not in found.guessed
    assert "wrist_flex" in found.guessed
    arm, session = LentArm(calibrated=False), Session(file)
    session.start(arm)
    arm.tick(3)
    found = seen(session, former=dict.fromkeys(JOINTS, 1.0))
    assert found.guessed == set(JOINTS)


def test_from_homing_on_the_picture_stands_as_the_arm_was_held_and_moves_with_it(recorded, arm):
    found = seen(recorded)
    assert found.angles == pytest.approx(HOMING_POSE, abs=0.01)
    assert found.guessed == set(JOINTS) - {ROLL}
    arm.put_deg(**{**POSE_DEG, "elbow_flex": 40.0, ROLL: -60.0})
    arm.tick(3)
    found = seen(recorded)
    assert found.angles["elbow_flex"] == pytest.approx(math.radians(40.0), abs=0.01)
    assert found.angles[ROLL] == pytest.approx(math.radians(-60.0), abs=0.01)


def test_joints_that_were_held_askew_are_right_once_they_have_been_at_both_stops(file, arm):
    arm.put_deg(**{**POSE_DEG, "elbow_flex": 25.0, "gripper": 20.0})
    session = recording(file, arm)
    arm.tick(3)
    assert abs(seen(session).angles["elbow_flex"] - truth(arm, "elbow_flex")) > math.radians(20.0)
    arm.sweep_all()
    found = seen(session)
    assert not found.guessed
    for joint in JOINTS:
        limit = math.radians(3.0 if joint == ROLL else 1.0)
        assert found.angles[joint] == pytest.approx(truth(arm, joint), abs=limit), joint
    session.stop_recording()
    arm.tick(3)
    for joint in ("elbow_flex", "gripper", "shoulder_pan"):
        told = seen(session).angles[joint]
        assert told == pytest.approx(truth(arm, joint), abs=math.radians(1.0)), joint


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


def test_joints_that_were_never_calibrated_are_matched_by_eye_and_silent_ones_named(session, arm):
    session.start(arm)
    assert told(session, {})["gripper"] == ("does not answer: check its cable", "bad")
    arm.tick(3)
    assert {tone for _, tone in told(session, {}).values()} == {"dim"}
    view = session.view
    seen = estimate_pose(view.state, view.joints, {})
    assert "Trust the arm" in summary.picture_note(seen, view.joints)


# The travels


def test_bars_turn_complete_by_themselves(recorded, arm):
    joints = recorded.view.joints
    assert summary.left(joints) == tuple(j for j in JOINTS if j != "wrist_roll")
    roll = {row.label: (row.mark, row.tone) for row in summary.travels(joints)}["wrist_roll"]
    assert roll == ("–", "dim"), "it can be saved, but was not moved"
    arm.sweep_all()
    bars = summary.travels(recorded.view.joints)
    assert summary.left(recorded.view.joints) == ()
    assert all(row.mark and row.tone == "good" and not row.text for row in bars)
    assert all(row.bar[1] - row.bar[0] > 0.97 for row in bars)


def test_a_few_joints_that_stop_short_can_be_accepted_many_cannot(recorded, arm):
    lower, upper = arm.stops("elbow_flex")
    arm.sweep_all(joints=[joint for joint in JOINTS if joint != "elbow_flex"])
    assert summary.acceptable(recorded.view.joints) == ()  # not moved at all
    arm.sweep("elbow_flex", lower, lower + (upper - lower) // 2)
    assert summary.acceptable(recorded.view.joints) == ("elbow_flex",)
    arm.put_deg(**POSE_DEG)
    fresh = {joint: replace(view, is_done=False) for joint, view in recorded.view.joints.items()}
    assert summary.acceptable(fresh) == ()


# The summary


def test_the_first_calibration_is_new_and_the_same_one_again_is_the_same(recorded, arm):
    arm.sweep_all()
    recorded.stop_recording()
    joints = recorded.view.joints
    lines = summary.lines(joints, {})
    assert [line.cells[2] for line in lines] == ["new"] * 6
    assert [line.cells[0] for line in lines] == ["good"] * 6
    again = summary.lines(joints, summary.calibration_of(joints))
    assert [line.cells[2] for line in again] == ["the same"] * 6
    # Ends that have moved are reported in degrees, whatever the offset.
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
