import pytest

from so101_motion.calib.motors.arm_identification import ServoFacts, ServosOnBus
from so101_motion.drivers.bus.reply_counters import ReplyCounter
from so101_motion.setup.checkup import explain

JOINTS = {
    1: "shoulder_pan", 2: "shoulder_lift", 3: "elbow_flex", 4: "wrist_flex", 5: "wrist_roll",
    6: "gripper",
}  # fmt: skip
HEALTHY = {
    "firmware_major": 3, "firmware_minor": 10, "model_number": 777, "min_position": 700,
    "max_position": 3400, "max_temperature": 70, "max_voltage": 140, "min_voltage": 40,
    "phase": 12, "homing_offset": 5, "operating_mode": 0, "torque_enable": 1,
    "torque_limit": 1000, "present_position": 2000, "present_load": 50, "present_voltage": 121,
    "present_temperature": 30, "status": 0, "present_current": 10, "status_level": 1,
    "max_torque": 1000, "unloading_condition": 44,
}  # fmt: skip


def seen(*, missing=(), unexpected_ids=(), counters=None, **changes):
    """Six healthy servos, but for ``elbow_flex = {register: value}`` and the like."""
    servos = {
        i: ServoFacts(servo_id=i, held=HEALTHY | changes.get(joint, {}))
        for i, joint in JOINTS.items()
        if i not in missing
    }
    servos |= {i: ServoFacts(servo_id=i, held=HEALTHY) for i in unexpected_ids}
    ids = {joint: i for i, joint in JOINTS.items()}
    return ServosOnBus(baud=1_000_000, servos=servos), ids, counters or {}


def test_nothing_is_wrong_with_a_healthy_arm():
    assert explain(*seen(counters={3: ReplyCounter(answers=1000, lost=3)})) == ()
    assert explain(*seen(unexpected_ids=(7, 8, 9))) == (), "the wheels of a LeKiwi"


@pytest.mark.parametrize(
    ("examination", "words"),
    [
        (seen(missing=JOINTS), ["no servo answers", "power supply"]),
        (seen(missing=JOINTS, unexpected_ids=(9,)), ["and 5 more", "first cable", "answers as 9"]),
        (seen(missing=(4, 5, 6)), ["servos 4, 5 and 6 do not answer", "between servos 3 and 4"]),
        (seen(missing=(3,)), ["servo 3 (elbow_flex)", "its id is wrong"]),
        (seen(missing=(6,), unexpected_ids=(7,)), ["without its jaw", "if it answers as 7"]),
        (
            seen(elbow_flex={"present_voltage": 121, "max_voltage": 80}),
            ["servo 3 (elbow_flex)", "12.1 V", "8.0 V", "switch the power off"],
        ),
        (seen(elbow_flex={"present_voltage": 50}), ["only 5.0 V", "power supply"]),
        (seen(elbow_flex={"status": 1}), ["supply", "drops under load"]),
        (seen(gripper={"status": 32, "present_load": 900}), ["gripper", "overloaded (90 %"]),
        (seen(gripper={"present_temperature": 61}), ["gripper is the warmest", "61 °C"]),
        (seen(elbow_flex={"status": 2}), ["broken encoder"]),
        (seen(elbow_flex={"model_number": 2825}), ["sts3250", "STS3215"]),
        (seen(elbow_flex={"operating_mode": 1}), ["mode 1"]),
        (seen(elbow_flex={"torque_limit": 0}), ["ignores its goal"]),
        (seen(elbow_flex={"phase": 28}), ["more than one turn"]),
        (seen(elbow_flex={"phase": 13}), ["backwards", "phase register 13; a new servo has 12"]),
        (seen(elbow_flex={"phase": 140}), ["backwards", "140"]),
        (seen(elbow_flex={"homing_offset": 2114}), ["2114", "calibrate"]),
        (seen(elbow_flex={"present_position": -20}), ["-20", "0 to 4095"]),
        (seen(elbow_flex={"firmware_minor": 9}), ["different versions", "elbow_flex 3.9"]),
        (seen(gripper={"present_voltage": 112}), ["12.1 V at the base", "11.2 V at the end"]),
        (
            seen(counters={3: ReplyCounter(answers=900, corrupt=100)}),
            ["elbow_flex", "10.0 %", "same id"],
        ),
        (
            seen(counters={3: ReplyCounter(answers=900, lost=100)}),
            ["elbow_flex", "10.0 %", "no answer", "cable"],
        ),
        (
            seen(counters={i: ReplyCounter(answers=900, late=100) for i in JOINTS}),
            ["10.0 %", "came late", "latency timer"],
        ),
        (
            seen(counters={i: ReplyCounter(answers=900, lost=100 + i) for i in JOINTS}),
            ["10.1 %", "every servo", "too busy"],
        ),
    ],
)  # fmt: skip
def test_each_symptom_is_named_with_its_figure_and_what_to_do(examination, words):
    findings = explain(*examination)

    assert len(findings) == 1, findings
    assert all(word in findings[0] for word in words), findings
