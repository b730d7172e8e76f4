import math
from dataclasses import replace
from pathlib import Path

import pytest

from so101_motion.calib.procedure import journal
from so101_motion.calib.procedure.journal import Journal
from so101_motion.calib.record import record, store
from so101_motion.calib.record.record import HeldCalibration
from so101_motion.common.errors import ConfigError
from so101_motion.rig.port_settings import ServoSettings, about_unused_file, combined

PORT = ServoSettings(port="/dev/ttyACM0")
ARM = PORT.with_arm((1, 2, 3, 4, 5))
GRIPPER = PORT.with_gripper(6)


def test_an_arm_and_a_gripper_together_ask_for_six_servos():
    joined = combined([ARM, GRIPPER])

    assert joined == combined([GRIPPER, ARM])
    assert list(joined.ids().values()) == [1, 2, 3, 4, 5, 6]
    assert len(joined.required()) == 6
    assert (len(ARM.required()), GRIPPER.required(), PORT.required()) == (5, ("gripper",), ())


def test_what_only_one_says_holds_for_both():
    file = Path("/data/arm.json")
    filed = ServoSettings(port="/dev/ttyACM0", calibration_file=file)

    assert combined([ARM, filed]).calibration_file == file
    assert combined([filed, GRIPPER]).calibration_file == file


def test_every_contradiction_is_named():
    other = ServoSettings(
        port="/dev/ttyACM0", baudrate=500_000, servo_ids=(2, 1, 3, 4, 5), gripper_id=7, rate=200.0,
        zero_offsets={"elbow_flex": math.radians(2.0)}, at_end="release", compensates=True,
    )  # fmt: skip
    mine = ServoSettings(
        port="/dev/ttyACM0", servo_ids=(1, 2, 3, 4, 5), gripper_id=6, rate=100.0,
        zero_offsets={"elbow_flex": math.radians(1.0)}, at_end="hold", compensates=False,
    )  # fmt: skip
    with pytest.raises(ConfigError) as caught:
        combined([mine, other])

    for words in (
        "baudrate 1000000 and 500000",
        "servo_ids [1, 2, 3, 4, 5] and [2, 1, 3, 4, 5]",
        "servo_id 6 and 7",
        "control_rate_hz 100 and 200",
        "joint_zero_offsets_deg elbow_flex 1 deg and elbow_flex 2 deg",
        "at_end hold and release",
        "compensates False and True",
    ):
        assert words in str(caught.value)


def test_a_jaw_may_be_another_servo_but_not_one_of_the_arm_s():
    alone = PORT.with_gripper(3)

    assert alone.ids()["gripper"] == 3
    assert "elbow_flex" not in alone.ids()
    with pytest.raises(ConfigError, match="belongs to the arm"):
        combined([ARM, alone])


def named(share, file):
    return replace(share, calibration_file=Path(file))


@pytest.mark.parametrize(
    ("shares", "file", "because"),
    [
        ([named(ARM, "/a"), named(GRIPPER, "/b")], "/a", "because the arm names it, and /b is not"),
        ([named(GRIPPER, "/b"), named(ARM, "/a")], "/a", "because the arm names it, and /b is not"),
        ([named(GRIPPER, "/b"), ARM, named(PORT, "/a")], "/b", "it was named first, and /a is not"),
        ([named(ARM, "/a"), named(GRIPPER, "/a")], "/a", None),
        ([named(ARM, "/a"), named(GRIPPER, "/b"), PORT], "/a", None),
        ([named(ARM, "/a"), GRIPPER], "/a", None),
        ([ARM, GRIPPER], None, None),
    ],
)
def test_one_of_different_files_counts_and_the_newest_component_is_told(shares, file, because):
    assert combined(shares).calibration_file == (file and Path(file))
    told = about_unused_file(shares)
    assert (told is None) if because is None else (because in told)


def test_the_longest_timeout_counts_and_a_component_without_one_takes_that_of_the_others():
    assert combined([replace(ARM, timeout=2.0), replace(GRIPPER, timeout=5.0)]).timeout == 5.0
    hurried = replace(ARM, timeout=5.0)

    assert combined([hurried, SENSOR]).timeout == 5.0
    assert combined([SENSOR, hurried]).timeout == 5.0


def test_a_gripper_that_names_its_arm_has_the_arms_baudrate():
    gripper = replace(GRIPPER, goes_with_arm=True)
    slow = replace(ARM, baudrate=500_000)
    assert combined([gripper, slow]).baudrate == combined([slow, gripper]).baudrate == 500_000
    assert combined([gripper]).baudrate == combined([gripper, ARM]).baudrate == 1_000_000
    assert combined([gripper, replace(gripper, baudrate=500_000)]).baudrate == 1_000_000
    with pytest.raises(ConfigError, match="baudrate 500000 and 1000000"):
        combined([slow, gripper, PORT])


SENSOR = replace(PORT, timeout=None, fallback_file=Path("/data/so101_calibration.json"))


@pytest.fixture
def data(data, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    return tmp_path


def test_a_file_that_nobody_names_counts_once_an_arm_was_calibrated_to_it(data):
    own = data / "so101_calibration.json"
    joined = combined([ARM, replace(SENSOR, fallback_file=own)])
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

    assert combined([named, replace(SENSOR, fallback_file=own)]).file == Path("/data/arm.json")


def test_what_a_sensor_saves_to_is_the_file_in_force_if_it_is_one_of_them():
    saves_to = {file: replace(SENSOR, fallback_file=Path(file)) for file in ("/a", "/b")}
    both = list(saves_to.values())
    assert combined(both).fallback_file == Path("/a")
    assert combined([*both, named(ARM, "/b")]).fallback_file == Path("/b")
    assert combined([*both, named(ARM, "/c")]).fallback_file == Path("/a")


def test_a_file_that_the_sensor_saves_to_may_be_missing_and_no_other():
    file = Path("/data/mine.json")
    names_it = replace(PORT, calibration_file=file)
    saves_to_it = replace(names_it, timeout=None, fallback_file=file)
    assert saves_to_it.may_file_be_missing
    assert combined([names_it.with_arm((1, 2, 3, 4, 5)), saves_to_it]).may_file_be_missing
    assert not names_it.may_file_be_missing
    assert not combined([names_it, SENSOR]).may_file_be_missing
