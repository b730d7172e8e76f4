"""The journal of a calibration: what the next process finds after one was interrupted."""

import json
from dataclasses import replace

import pytest
from harness.calibration_rig import LentArm, all_held

from so101_motion.calib.procedure import journal
from so101_motion.calib.procedure.eeprom import write_held
from so101_motion.calib.procedure.journal import Journal, Saving
from so101_motion.calib.record.record import JOINTS, SERVO_IDS, HeldCalibration, default
from so101_motion.calib.record.zero import Zero
from so101_motion.common.errors import CalibrationError
from so101_motion.rig.joint_setup import find_joints
from so101_motion.rig.port_settings import ServoSettings

BEFORE = {
    joint: HeldCalibration(homing_offset=-i, range_min=600 + i) for i, joint in enumerate(JOINTS)
}
MEANWHILE = {joint: HeldCalibration(homing_offset=100 + i) for i, joint in enumerate(JOINTS)}
CALIBRATION = {
    joint: replace(default(joint), homing_offset=500 + i, range_min=1000 + i, range_max=2400 + i)
    for i, joint in enumerate(JOINTS)
}
AFTER = {joint: entry.held for joint, entry in CALIBRATION.items()}
SAVING = Saving(calibration=CALIBRATION, zeros={"elbow_flex": Zero(by="stops", angle=-0.1)})
OPEN = Journal(before=BEFORE, meanwhile=MEANWHILE)
DECIDED = Journal(before=BEFORE, meanwhile=MEANWHILE, saving=SAVING, is_decided=True)
CALLED_OFF = replace(DECIDED, is_decided=False)


@pytest.fixture
def arm():
    return LentArm()


def hold(arm, *sides):
    """Let the servos hold these in turn, the last for all that are left."""
    for i, joint in enumerate(JOINTS):
        write_held(arm.bus, SERVO_IDS[joint], sides[min(i, len(sides) - 1)][joint])


@pytest.mark.parametrize("noted", [OPEN, DECIDED, CALLED_OFF])
def test_a_journal_is_read_as_it_was_written_and_without_one_nothing_is_done(arm, file, noted):
    assert journal.read(file) is None
    assert journal.recover(arm.bus, file) is None
    journal.write(file, noted)
    assert journal.read(file) == noted


@pytest.mark.parametrize("sides", [(MEANWHILE,), (AFTER, MEANWHILE), (BEFORE, AFTER)])
def test_a_save_that_was_called_off_is_rolled_back(arm, file, sides):
    hold(arm, *sides)
    journal.write(file, CALLED_OFF)
    assert "were restored" in journal.recover(arm.bus, file)
    assert all_held(arm) == BEFORE
    assert not file.exists()
    assert journal.read(file) is None


@pytest.mark.parametrize("noted", [OPEN, DECIDED])
def test_servos_that_were_calibrated_by_other_means_since_are_left_alone(arm, file, noted):
    hold(arm, MEANWHILE)
    write_held(arm.bus, 4, HeldCalibration(homing_offset=7, range_min=800, range_max=3100))
    before = all_held(arm)
    journal.write(file, noted)
    assert "by other means" in journal.recover(arm.bus, file)
    assert all_held(arm) == before
    assert journal.read(file) is None


def test_while_a_servo_is_silent_nothing_is_touched(arm, file):
    hold(arm, MEANWHILE)
    journal.write(file, OPEN)
    arm.world.disconnect("gripper")
    with pytest.raises(CalibrationError, match=r"servo 6.*remove .*arm\.json\.unfinished"):
        journal.recover(arm.bus, file)
    assert arm.held("shoulder_pan") == MEANWHILE["shoulder_pan"]
    assert journal.read(file) == OPEN


def test_the_next_look_at_the_servos_ends_an_interrupted_calibration(arm, file):
    hold(arm, MEANWHILE)
    journal.write(file, DECIDED)
    found = find_joints(arm.bus, ServoSettings(port="/dev/x", calibration_file=file), JOINTS)
    assert "A calibration was interrupted while it was saved; it is complete now." in found.notes
    assert {joint: setup.calibration for joint, setup in found.setups.items()} == CALIBRATION
    assert all_held(arm) == AFTER


def broken(change):
    """The text of a journal after ``change`` was made to what it says."""
    content = {
        "before": {"gripper": [0, 0, 4095]},
        "meanwhile": {"gripper": [5, 0, 4095]},
        "is_decided": True,
        "saving": {"calibration": {"gripper": default("gripper").to_json()}, "zeros": {}},
    }
    change(content)
    return json.dumps(content)


HOSTILE = [
    "",
    "[]",
    "{}",
    "nonsense",
    broken(lambda c: c.pop("meanwhile")),
    broken(lambda c: c["before"].update(gripper=[0, 0])),
    broken(lambda c: c["before"].update(gripper=[9999, 0, 4095])),
    broken(lambda c: c["before"].update(gripper=["0", "0", "4095"])),
    broken(lambda c: c["before"].update(gripper=[0, 0, 70000])),
    broken(lambda c: c["before"].update(elbow=[0, 0, 4095])),
    broken(lambda c: c["meanwhile"].update(elbow_flex=[0, 0, 4095])),
    broken(lambda c: c["saving"].update(calibration={})),
    broken(lambda c: c["saving"].update(zeros={"gripper": "by hand"})),
    broken(lambda c: c["saving"].update(zeros={"gripper": ["by hand", "left"]})),
    broken(lambda c: c["saving"].update(zeros={"gripper": ["stops", 10**400]})),
    broken(lambda c: c.update(saving=3)),
]


@pytest.mark.parametrize("text", HOSTILE)
def test_a_journal_that_makes_no_sense_is_a_sentence_and_changes_nothing(arm, file, text):
    before = all_held(arm)
    journal.path_for(file).write_text(text)
    with pytest.raises(CalibrationError, match=r"arm\.json\.unfinished"):
        journal.recover(arm.bus, file)
    assert all_held(arm) == before
