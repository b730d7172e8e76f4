from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from harness.fake_page import STILL
from so101_viewer.page.bar import Bar
from so101_viewer.page.events import EventLog
from so101_viewer.page.screen_state import Tone
from so101_viewer.panels import health_panel
from so101_viewer.panels.health_panel import (
    LATE_MANY,
    Health,
    HealthPart,
    LateCycles,
    figures,
    not_said_yet,
    read_health,
    servo_alarms,
    state_alarms,
    tones,
)

from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.drivers.feetech.health import JointHealth
from so101_motion.rig.protocols import ArmConnection
from so101_motion.rig.simulated_rig import open_simulated

WELL = JointHealth(
    joint="elbow_flex", volts=12.1, amps=-0.123456, servo_id=3, t=0.0, latched=(), temperature_c=34,
    load=-0.25, faults=(), answers=1000, lost=0, corrupt=0, retries=0, is_silent=False,
)  # fmt: skip
TOLD = {
    "servo_id": 3.0, "silent": False, "volts": 12.1, "amps": 0.12, "temperature_c": 34.0,
    "load_percent": 25.0, "faults": [], "faults_since_start": [], "answers": 10.0, "lost": 1.0,
    "corrupt": 2.0, "retries": 3.0,  # as they come over gRPC
}  # fmt: skip


ONES = np.ones(5)


def machine(status):
    arm = SimpleNamespace(state=SimpleNamespace(late_ticks=4), range=(-7 * ONES, 7 * ONES))
    return SimpleNamespace(arm=arm, status=status)


FILED = Health(silence=None, late_ticks=0)


def shown(*servos):
    return figures(Health(servos=servos, silence=None, period=0.01, late_ticks=0, port_losses=0))


def test_a_simulated_arm_says_that_nothing_is_measured_instead_of_zeros():
    with open_simulated() as rig:
        health = read_health(rig)
    assert health.servos == ()
    assert health.silence == "Simulated: there are no servos to measure."
    page = figures(health)
    assert "°C" not in page
    assert "10 ms" in page


def test_a_machine_tells_the_figures_of_its_servos_base_to_jaw_and_which_are_not_calibrated():
    told = {"wrist_flex": {**TOLD, "servo_id": 4}, "elbow_flex": TOLD}
    health = read_health(machine({"health": told}))
    assert [servo.joint for servo in health.servos] == ["elbow_flex", "wrist_flex"]
    assert health.servos[0].load == pytest.approx(0.25)
    assert health.servos[0].lost + health.servos[0].corrupt == 3
    assert health.late_ticks == 4
    assert health.period is None
    assert read_health(machine({"uncalibrated": ["elbow_flex"]})).uncalibrated == ("elbow_flex",)
    assert "The file is gone." in figures(read_health(machine({"notes": ["the file is gone"]})))
    told["gripper"] = {**TOLD, "temperature_c": 34.5}
    assert "figures of gripper cannot be read" in figures(read_health(machine({"health": told})))


@pytest.mark.parametrize(
    "told",
    [
        {},
        {"health": {}},
        {"health": "fine", "uncalibrated": "all"},
        {"health": {"elbow_flex": 3}, "uncalibrated": None},
        {"health": {"elbow_flex": {"volts": "x"}}},
    ],
)
def test_a_machine_that_tells_nothing_useful_is_said_to(told):
    health = read_health(machine(told))
    assert health.servos == health.uncalibrated == ()
    assert health.silence == "This arm does not report the health of its servos."


@pytest.mark.parametrize(
    ("changes", "figure", "tone"),
    [
        ({}, "volts", Tone.PLAIN),
        ({"volts": 5.9}, "volts", Tone.WARM),
        ({"volts": 5.4}, "volts", Tone.BAD),
        ({"faults": ("voltage",)}, "volts", Tone.BAD),
        ({"temperature_c": 55.0}, "celsius", Tone.WARM),
        ({"temperature_c": 65.0}, "celsius", Tone.BAD),
        ({"load": -0.9}, "load", Tone.WARM),
        ({"faults": ("overload",)}, "load", Tone.BAD),
    ],
)
def test_figures_out_of_the_ordinary_are_coloured(changes, figure, tone):
    assert tones(replace(WELL, **changes))[figure] is tone


def test_figures_are_rounded_names_escaped_and_a_silent_servo_has_none():
    page = shown(WELL)
    for figure in (">12.1<", ">0.12<", ">34<", ">25<"):
        assert figure in page
    assert "0.123" not in page
    page = shown(replace(WELL, is_silent=True))
    assert "does not answer" in page
    assert "12.1" not in page
    page = shown(replace(WELL, joint="<b>x</b>", faults=("<u>",)))
    assert "<u>" not in page
    assert "&lt;b&gt;x&lt;/b&gt;" in page


@pytest.mark.parametrize(
    ("trouble", "tone", "words"),
    [
        ({"temperature_c": 57}, Tone.WARM, "elbow_flex: its servo is hot (57 °C"),
        ({"temperature_c": 67}, Tone.BAD, "let it cool"),
        ({"temperature_c": 67, "faults": ("overheated",)}, Tone.BAD, "has let go (now 67 °C)"),
        ({"volts": 5.8}, Tone.WARM, "use a stronger supply"),
        ({"volts": 4.9}, Tone.BAD, "switch the arm's power supply on"),
        ({"faults": ("overload",)}, Tone.BAD, "free the joint"),
        ({"is_silent": True}, Tone.BAD, "does not answer; check its plugs"),
    ],
)
def test_what_is_wrong_with_a_servo_is_said_with_what_to_do(trouble, tone, words):
    (alarm,) = servo_alarms([WELL, replace(WELL, **trouble)])
    assert alarm.joints == ("elbow_flex",)
    assert alarm.sentence.tone is tone
    assert words in alarm.sentence.text


def test_one_supply_is_one_alarm_for_all_its_servos_and_a_silent_servo_is_said_once():
    joints = ("shoulder_pan", "shoulder_lift", "elbow_flex")
    weak = [replace(WELL, joint=joint, volts=5.1) for joint in joints]
    (alarm,) = servo_alarms([*weak, replace(WELL, joint="gripper")])
    assert alarm.joints == joints
    assert (
        "shoulder_pan (also shoulder_lift and elbow_flex): it gets only 5.1 V; "
        in alarm.sentence.text
    )
    heat = [
        replace(WELL, joint=joint, temperature_c=c)
        for joint, c in zip(joints, (57, 67, 30), strict=True)
    ]
    (hot,) = servo_alarms(heat)
    assert hot.sentence.text.startswith("shoulder_lift (also shoulder_pan at 57 °C): ")
    (of_all,) = servo_alarms(weak)
    assert of_all.sentence.text.startswith("Every joint: it gets only 5.1 V; ")
    assert "Also" not in of_all.sentence.text
    alarms = servo_alarms(
        [replace(WELL, is_silent=True), replace(WELL, joint="gripper", temperature_c=67)]
    )
    assert not_said_yet(alarms, STILL) == alarms
    (hot,) = not_said_yet(alarms, replace(STILL, mode=Mode.FAULT, fault="no reply from servo 3"))
    assert hot.joints == ("gripper",)


@pytest.mark.parametrize(
    ("off_deg", "then"),
    [(7.0, "The next motion brings it back slowly"), (25.0, "Move wrist_flex back by hand")],
)
def test_a_joint_outside_its_range_says_how_far_and_what_brings_it_back(off_deg, then):
    inside = float(STILL.reading.q[3]) - to_rad(off_deg)
    reading = replace(STILL.reading, out_of_range={"wrist_flex": inside})
    upper = 7 * ONES
    upper[3] = inside
    for told, limits in ((reading, None), (STILL.reading, (-7 * ONES, upper))):
        (alarm,) = state_alarms(replace(STILL, reading=told), FILED, limits)
        assert f"wrist_flex by {off_deg:.0f}°" in alarm.sentence.text
        assert then in alarm.sentence.text
        assert alarm.joints == ("wrist_flex",)
    upper[3] = STILL.reading.q[3] - to_rad(0.5)  # as far as a joint at its limit may droop
    assert state_alarms(STILL, FILED, (-7 * ONES, upper)) == ()


def test_that_there_is_no_calibration_file_is_said_before_the_arm_holds_then_in_the_tab():
    health = replace(FILED, has_file=False)
    (alarm,) = state_alarms(replace(STILL, mode=Mode.LIMP), health)
    assert "40 mm off" in alarm.sentence.text
    assert "Calibration Only on the Setup tab" in alarm.sentence.text
    assert state_alarms(STILL, health) == ()
    assert "40 mm off" in figures(health)
    assert "40 mm off" not in figures(FILED)


def test_many_late_cycles_are_an_alarm_until_they_have_stopped():
    late = LateCycles("the machine's computer")
    assert late.alarm(0.0, 3) == ()
    (alarm,) = late.alarm(5.0, 3 + LATE_MANY)
    assert alarm.cause == "late"
    assert alarm.sentence.text.endswith("Close other programs on the machine's computer.")
    assert late.alarm(20.0, 3 + LATE_MANY) == ()


@pytest.mark.parametrize(
    ("status", "words", "tone", "joints"),
    [
        ({"health": {"elbow_flex": {**TOLD, "temperature_c": 68}}}, "too hot (68 °C", Tone.BAD,
         {"elbow_flex": Tone.BAD}),
        ({"uncalibrated": ["wrist_roll"]}, "No calibration: wrist_roll", Tone.WARM,
         {"wrist_roll": Tone.WARM}),
        ({"not_ready": "its servos hold another file"}, "Its servos hold", Tone.WARM, {}),
    ],
)  # fmt: skip
def test_an_alarm_is_in_the_bar_at_the_tab_and_the_joint_and_once_in_the_log(
    monkeypatch, status, words, tone, joints
):
    monkeypatch.setattr(health_panel, "_EVERY", 0.0)
    rig, tab, marked = machine(status), nullcontext(), []
    rig.arm.state, rig.connection = STILL, ArmConnection(to="machine")
    gui = SimpleNamespace(add_html=lambda html: SimpleNamespace(content=html))
    context = SimpleNamespace(bar=Bar(), events=EventLog(), gui=gui)
    panel = SimpleNamespace(add_tab=lambda *_: tab)
    part = HealthPart(context, rig, panel, mark=marked.append, name="left")
    for _ in range(3):
        part.refresh()
    (said,) = context.bar._alerts["alarms left"]
    assert said.text.startswith("left: ")
    assert words in said.text
    assert said.tone is tone
    assert (tab.icon, marked) == ("alert-triangle", [joints])
    assert [words in event.text for event in context.events.newest()] == [True]
    rig.status = {}
    part.refresh()
    assert context.bar._alerts["alarms left"] == ()
    assert (tab.icon, marked[1:]) == ("heartbeat", [{}])
    rig.status, rig.connection = status, ArmConnection(to="machine", problem="lost")
    part.refresh()
    assert context.bar._alerts["alarms left"] == ()  # what a lost arm last said is old
    assert tab.icon == "alert-triangle"
