from dataclasses import replace

import pytest
from harness.fake_page import STILL
from so101_viewer.page.screen_state import Tone
from so101_viewer.panels.health_panel import (
    LATE_MANY,
    LateCycles,
    not_said_yet,
    servo_alarms,
    state_alarms,
)

from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.drivers.feetech.health import JointHealth

WELL = JointHealth(
    joint="elbow_flex", volts=12.1, amps=-0.12, servo_id=3, t=0.0, latched=(), temperature_c=34,
    load=-0.25, faults=(), answers=1000, lost=0, corrupt=0, retries=0, is_silent=False,
)  # fmt: skip


@pytest.mark.parametrize(
    ("trouble", "tone", "words"),
    [
        ({"temperature_c": 57}, Tone.WARM, "elbow_flex: its servo is hot (57 °C"),
        ({"temperature_c": 67}, Tone.BAD, "let it cool"),
        ({"volts": 5.8}, Tone.WARM, "use a stronger supply"),
        ({"volts": 4.9}, Tone.BAD, "switch the arm's power supply on"),
        ({"faults": ("overload",)}, Tone.BAD, "free the joint"),
        ({"is_silent": True}, Tone.BAD, "does not answer; check its plugs"),
    ],
)
def test_what_is_wrong_with_a_servo_is_said_with_what_to_do(trouble, tone, words):
    (alarm,) = servo_alarms([WELL, replace(WELL, joint="elbow_flex", **trouble)])
    assert alarm.joints == ("elbow_flex",)
    assert alarm.sentence.tone is tone
    assert words in alarm.sentence.text


def test_a_servo_that_is_well_raises_no_alarm():
    assert servo_alarms([WELL]) == ()


def test_one_supply_is_one_alarm_for_all_its_servos():
    joints = ("shoulder_pan", "shoulder_lift", "elbow_flex")
    (alarm,) = servo_alarms(replace(WELL, joint=joint, volts=5.1) for joint in joints)
    assert alarm.joints == joints
    assert "Also: shoulder_lift and elbow_flex" in alarm.sentence.text


def test_a_servo_that_falls_silent_is_said_once():
    alarms = servo_alarms(
        [replace(WELL, is_silent=True), replace(WELL, joint="gripper", temperature_c=67)]
    )
    assert not_said_yet(alarms, STILL) == alarms
    (hot,) = not_said_yet(alarms, replace(STILL, mode=Mode.FAULT, fault="no reply from servo 3"))
    assert hot.joints == ("gripper",)


def test_joints_without_calibration_or_outside_their_range_are_named():
    reading = replace(STILL.reading, out_of_range={"wrist_flex": 1.5})
    missing, outside = state_alarms(replace(STILL, reading=reading), ["elbow_flex"])
    assert missing.joints == ("elbow_flex",)
    assert "Calibrate" in missing.sentence.text
    assert outside.joints == ("wrist_flex",)
    assert "86°" in outside.sentence.text
    assert state_alarms(STILL, []) == ()


@pytest.mark.parametrize(
    ("off_deg", "then"),
    [(7.0, "The next motion brings it back slowly"), (25.0, "Move wrist_flex back by hand")],
)
def test_a_joint_outside_its_range_says_how_far_and_what_brings_it_back(off_deg, then):
    inside = float(STILL.reading.q[3]) - to_rad(off_deg)
    reading = replace(STILL.reading, out_of_range={"wrist_flex": inside})
    (alarm,) = state_alarms(replace(STILL, reading=reading), [])
    assert f"wrist_flex by {off_deg:.0f}°" in alarm.sentence.text
    assert then in alarm.sentence.text


def test_many_late_cycles_are_an_alarm_until_they_have_stopped():
    late = LateCycles("the machine's computer")
    assert late.alarm(0.0, 3) == ()
    (alarm,) = late.alarm(5.0, 3 + LATE_MANY)
    assert alarm.cause == "late"
    assert alarm.sentence.text.endswith("Close other programs on the machine's computer.")
    assert late.alarm(20.0, 3 + LATE_MANY) == ()
