from dataclasses import replace
from pathlib import Path

import pytest

from so101_motion.calib.procedure import journal
from so101_motion.calib.procedure.eeprom import HeldCalibration
from so101_motion.calib.procedure.journal import Journal
from so101_motion.calib.record import record, store
from so101_motion.common.errors import ConfigError
from so101_motion.rig.servo_driver import ServoSettings

PORT = ServoSettings(port="/dev/ttyACM0")
ARM = PORT.with_arm((1, 2, 3, 4, 5))
GRIPPER = PORT.with_gripper(6)


def test_an_arm_and_a_gripper_together_ask_for_six_servos():
    joined = ARM.joined_with(GRIPPER)

    assert joined == GRIPPER.joined_with(ARM)
    assert list(joined.ids().values()) == [1, 2, 3, 4, 5, 6]
    assert len(joined.required()) == 6
    assert (len(ARM.required()), GRIPPER.required(), PORT.required()) == (5, ("gripper",), ())


def test_what_only_one_says_holds_for_both():
    file = Path("/data/arm.json")
    filed = ServoSettings(port="/dev/ttyACM0", calibration_file=file)

    assert ARM.joined_with(filed).calibration_file == file
    assert filed.joined_with(GRIPPER).calibration_file == file


def test_every_contradiction_is_named():
    other = ServoSettings(
        port="/dev/ttyACM0", baudrate=500_000, timeout=5.0, calibration_file=Path("/b")
    )
    mine = ServoSettings(port="/dev/ttyACM0", calibration_file=Path("/a"))
    with pytest.raises(ConfigError) as caught:
        mine.joined_with(other)

    for words in ("baudrate 1000000 and 500000", "timeout 1.0 and 5.0", "/a and /b"):
        assert words in str(caught.value)


def test_a_jaw_may_be_another_servo_but_not_one_of_the_arm_s():
    alone = PORT.with_gripper(3)

    assert alone.ids()["gripper"] == 3
    assert "elbow_flex" not in alone.ids()
    with pytest.raises(ConfigError, match="belongs to the arm"):
        ARM.joined_with(alone)


SENSOR = replace(PORT, timeout=None, fallback_file=Path("/data/so101_calibration.json"))


def test_a_component_without_a_timeout_takes_that_of_the_others():
    hurried = replace(ARM, timeout=5.0)

    assert hurried.joined_with(SENSOR).timeout == 5.0
    assert SENSOR.joined_with(hurried).timeout == 5.0


@pytest.fixture
def data(tmp_path, monkeypatch):
    monkeypatch.setenv("VIAM_MODULE_DATA", str(tmp_path))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    return tmp_path


def test_a_file_that_nobody_names_counts_once_an_arm_was_calibrated_to_it(data):
    own = data / "so101_calibration.json"
    joined = ARM.joined_with(replace(SENSOR, fallback_file=own))
    assert joined.file is None
    store.save(own, {"elbow_flex": record.default("elbow_flex")})
    assert joined.file == own
    own.unlink()
    assert joined.file == own, "viam-server deleted it; there is a copy"


def test_a_calibration_that_was_interrupted_is_found_by_the_file_that_nobody_names(data):
    own = data / "so101_calibration.json"
    held = {"elbow_flex": HeldCalibration(homing_offset=3)}
    journal.write(own, Journal(before=held, meanwhile=held))

    assert replace(SENSOR, fallback_file=own).file == own


def test_a_file_that_is_named_counts_whatever_there_is(data):
    own = data / "so101_calibration.json"
    store.save(own, {"elbow_flex": record.default("elbow_flex")})
    named = replace(ARM, calibration_file=Path("/data/arm.json"))

    assert named.joined_with(replace(SENSOR, fallback_file=own)).file == Path("/data/arm.json")


def test_a_file_that_the_sensor_saves_to_may_be_missing_and_no_other():
    file = Path("/data/mine.json")
    names_it = replace(PORT, calibration_file=file)
    saves_to_it = replace(names_it, timeout=None, fallback_file=file)
    assert saves_to_it.may_file_be_missing
    assert names_it.with_arm((1, 2, 3, 4, 5)).joined_with(saves_to_it).may_file_be_missing
    assert not names_it.may_file_be_missing
    assert not names_it.joined_with(SENSOR).may_file_be_missing
