from pathlib import Path

import pytest

from so101_motion.errors import ConfigError
from so101_motion.servos import ServoSettings

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
