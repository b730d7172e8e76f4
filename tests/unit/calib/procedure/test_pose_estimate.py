"""Where the joints of an arm probably are while it is calibrated."""

import math

import pytest
from harness.calibration_rig import LentArm

from so101_motion.calib.procedure.session import Session
from so101_motion.calib.procedure.summary import HOMING_POSE, estimate_pose
from so101_motion.calib.procedure.travel import ROLL
from so101_motion.calib.record.record import JOINTS

POSE_DEG = {joint: math.degrees(angle) for joint, angle in HOMING_POSE.items()}


@pytest.fixture
def arm():
    """As new: no offsets, no limits."""
    return LentArm(calibrated=False)


@pytest.fixture
def session(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    return Session(tmp_path / "arm.json")


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


def test_a_former_calibration_tells_where_its_joints_are(session):
    arm = LentArm()
    session.start(arm)
    arm.tick(3)
    found = seen(session, former={"elbow_flex": 0.3})
    assert found.angles["elbow_flex"] == 0.3
    assert "elbow_flex" not in found.guessed
    assert "wrist_flex" in found.guessed


def test_new_servos_are_guessed_whatever_somebody_makes_of_their_ticks(session, arm):
    session.start(arm)
    arm.tick(3)
    found = seen(session, former=dict.fromkeys(JOINTS, 1.0))
    assert found.guessed == set(JOINTS)


def test_from_homing_on_the_picture_stands_as_the_arm_was_held_and_moves_with_it(session, arm):
    arm.put_deg(**POSE_DEG)
    session.start(arm)
    session.set_homing()
    session.start_recording()
    arm.tick(3)
    found = seen(session)
    assert found.angles == pytest.approx(HOMING_POSE, abs=0.01)
    assert found.guessed == set(JOINTS) - {ROLL}
    arm.put_deg(**{**POSE_DEG, "elbow_flex": 40.0, ROLL: -60.0})
    arm.tick(3)
    found = seen(session)
    assert found.angles["elbow_flex"] == pytest.approx(math.radians(40.0), abs=0.01)
    assert found.angles[ROLL] == pytest.approx(math.radians(-60.0), abs=0.01)


def test_joints_that_were_held_askew_are_right_once_they_have_been_at_both_stops(session, arm):
    arm.put_deg(**{**POSE_DEG, "elbow_flex": 25.0, "gripper": 20.0})
    session.start(arm)
    session.set_homing()
    session.start_recording()
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
