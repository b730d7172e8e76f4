from dataclasses import replace

import pytest
from harness.calibration_rig import LentArm, calibrate

from so101_motion.calib.procedure.verification import AT_MOST, NOTHING_NEW, Verification
from so101_motion.calib.record.record import JOINTS, default
from so101_motion.common.errors import NotPossibleNow

AS_NEW = {joint: default(joint) for joint in JOINTS}


@pytest.fixture
def arm():
    return LentArm()


@pytest.fixture
def calibration(arm, tmp_path):
    return calibrate(tmp_path / "arm.json", arm).calibration


def flash(arm):
    return [servo.memory.flash for servo in arm.world.servos]


def verified(calibration, arm, joints=None):
    before, verification = flash(arm), Verification(calibration, arm)
    verification.ask("release")
    arm.sweep_all(joints)
    due = verification.view.offer("end").due_in
    assert due is None or due <= NOTHING_NEW
    verification.ask("end")
    assert verification.view.is_over
    assert flash(arm) == before
    return {each.joint: each for each in verification.joints}


def test_a_right_calibration_agrees_with_all_stops(arm, calibration):
    told = verified(calibration, arm)
    assert [each.agrees for each in told.values()] == [True] * 5
    assert "wrist_roll" not in told, "it has no stops"


@pytest.mark.parametrize("drive_mode", [0, 1])
def test_a_horn_that_was_mounted_anew_is_told_in_degrees(arm, calibration, drive_mode):
    off = replace(calibration["elbow_flex"], drive_mode=drive_mode)
    off = replace(off, homing_offset=off.homing_offset - 164)  # one tooth
    told = verified({**calibration, "elbow_flex": off}, arm)
    assert told["elbow_flex"].agrees is False
    reads = -14.4 if drive_mode else 14.4
    assert told["elbow_flex"].reads_deg == pytest.approx(reads, abs=0.3)
    assert f"{reads:+.1f}"[:4] in told["elbow_flex"].sentence
    assert "so101 calibrate --joint elbow_flex" in told["elbow_flex"].sentence


def test_servos_that_hold_another_offset_are_compared_by_their_encoders(arm, calibration):
    pan = calibration["shoulder_pan"]
    same = replace(
        pan, homing_offset=pan.homing_offset + 300,
        range_min=pan.range_min - 300, range_max=pan.range_max - 300,
    )  # fmt: skip
    assert verified({"shoulder_pan": same}, arm)["shoulder_pan"].agrees


def test_a_joint_not_at_both_stops_is_not_judged_and_a_travel_too_short_is_named(arm, calibration):
    told = verified(calibration, arm, ("shoulder_pan",))
    assert told["shoulder_pan"].agrees
    assert told["elbow_flex"].agrees is None
    assert "lead it to both stops" in told["elbow_flex"].sentence
    lift = calibration["shoulder_lift"]
    short = replace(lift, range_min=lift.range_min + 100)
    told = verified({"shoulder_lift": short}, arm)["shoulder_lift"]
    assert told.agrees is False
    assert "farther than it was calibrated" in told.sentence


def test_without_a_person_it_begins_at_once_and_ends_in_time(arm):
    verification = Verification(AS_NEW, arm, is_attended=False)
    with pytest.raises(NotPossibleNow, match="the verification is ready"):
        verification.ask("end")
    assert verification.view.offer("release").due_in == 0.0
    verification.ask("release")
    arm.tick(200)
    assert verification.view.offer("end").due_in == pytest.approx(AT_MOST - 2.0, abs=0.1)
