from dataclasses import replace
from types import SimpleNamespace

import pytest
from so101_viewer.page.screen_state import Tone
from so101_viewer.panels.health_panel import Health, figures, read_health, tones

from so101_motion.drivers.feetech.health import JointHealth
from so101_motion.rig.simulated_rig import open_simulated

WELL = JointHealth(
    joint="elbow_flex",
    volts=12.1,
    amps=-0.123456,
    servo_id=3,
    t=0.0,
    latched=(),
    temperature_c=34,
    load=-0.25,
    faults=(),
    answers=1000,
    lost=0,
    corrupt=0,
    retries=0,
    is_silent=False,
)
TOLD = {
    "servo_id": 3,
    "silent": False,
    "volts": 12.1,
    "amps": 0.12,
    "temperature_c": 34,
    "load_percent": 25.0,
    "faults": [],
    "faults_since_start": [],
    "answers": 10,
    "lost": 1,
    "corrupt": 2,
    "retries": 3,
}


def machine(status):
    arm = SimpleNamespace(state=SimpleNamespace(late_ticks=4))
    return SimpleNamespace(arm=arm, status=status)


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


def test_a_machine_tells_the_figures_of_its_servos_base_to_jaw():
    told = {"wrist_flex": {**TOLD, "servo_id": 4}, "elbow_flex": TOLD}
    health = read_health(machine({"health": told}))
    assert [servo.joint for servo in health.servos] == ["elbow_flex", "wrist_flex"]
    assert health.servos[0].load == pytest.approx(0.25)
    assert health.servos[0].lost + health.servos[0].corrupt == 3
    assert health.late_ticks == 4
    assert health.period is None


def test_a_machine_tells_which_joints_were_never_calibrated():
    assert read_health(machine({"uncalibrated": ["elbow_flex"]})).uncalibrated == ("elbow_flex",)
    for told in ({}, {"uncalibrated": None}, {"uncalibrated": "all"}):
        assert read_health(machine(told)).uncalibrated == ()


@pytest.mark.parametrize(
    "told", [{}, {"health": {}}, {"health": "fine"}, {"health": {"elbow_flex": {"volts": "x"}}}]
)
def test_a_machine_that_tells_nothing_useful_is_said_to(told):
    health = read_health(machine(told))
    assert health.servos == ()
    assert health.silence == "The machine's arm reports no servo health."


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


def test_figures_are_rounded_for_people():
    page = shown(WELL)
    for figure in (">12.1<", ">0.12<", ">34<", ">25<"):
        assert figure in page
    assert "0.123" not in page


def test_a_silent_servo_shows_no_old_figures():
    page = shown(replace(WELL, is_silent=True))
    assert "does not answer" in page
    assert "12.1" not in page


def test_names_from_a_machine_are_escaped():
    page = shown(replace(WELL, joint="<b>x</b>", faults=("<i>",)))
    assert "<b>x" not in page
    assert "<i>" not in page
    assert "&lt;b&gt;x" in page
