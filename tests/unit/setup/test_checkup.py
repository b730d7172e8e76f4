from dataclasses import asdict, replace
from pathlib import Path

import pytest
from harness.calibration_rig import LentArm

from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.calib.record.store import Stored
from so101_motion.calib.record.zero_report import ZeroReport
from so101_motion.common.errors import PortUnavailable
from so101_motion.common.units import to_rad
from so101_motion.drivers.bus import registers
from so101_motion.drivers.emulator import registers as emulated
from so101_motion.drivers.servo_types import STS3215_7V4
from so101_motion.setup.checkup import BusQuality, Findings, check_up, examine, is_healthy, software


def seen_on(arm, **changes):
    servos, bus_quality = examine(arm)
    return replace(
        Findings(
            port="/dev/x", servos=servos, bus_quality=bus_quality, speed=0.87, acceleration=1.7
        ),
        **changes,
    )


def stored_of(arm, **changes):
    """A calibration file that says what the servos hold, but for changes by joint."""
    calibration = {}
    for place, joint in enumerate(JOINTS, start=1):
        held = arm.held(joint)
        entry = JointCalibration(id=place, **asdict(held))
        calibration[joint] = replace(entry, **changes.get(joint, {}))
    return Stored(path=Path("/home/me/arm.json"), calibration=calibration, zeros={}, notes=())


def of(checks, name):
    return next(check for check in checks if check.name == name)


QUIET = BusQuality(
    asked=1200, late=0, lost=0, corrupt=0, lateness=0.001, median=0.002, p99=0.003, longest=0.004
)


@pytest.fixture
def arm():
    return LentArm()


def test_a_sound_arm_has_nothing_but_good_checks_and_an_unplugged_port_is_an_error(arm):
    checks = check_up(seen_on(arm, stored=stored_of(arm)))
    assert {check.verdict for check in checks} == {"ok"}
    names = [check.name for check in checks]
    assert names == [
        "port", "servos", "firmware", "supply", "temperature", "faults", "bus", "calibration",
        "speed",
    ]  # fmt: skip
    assert is_healthy(checks)
    arm.wire.unplugged = True
    with pytest.raises(PortUnavailable):
        examine(arm)


def holding(row, value, place=3):
    return lambda arm: arm.world.servo(place).memory.keep(row, value)


def restarted(arm):
    """The others hold, but a servo has lost its power for a moment."""
    for place in (1, 2, 4, 5, 6):
        arm.call(lambda bus, place=place: bus.write(place, registers.TORQUE_ENABLE, 1))


@pytest.mark.parametrize(
    ("trouble", "name", "verdict", "words"),
    [
        (lambda arm: arm.world.power(0.0), "servos", "fail", "power supply"),
        (lambda arm: arm.world.disconnect(6), "servo 6", "warn", "moves without its jaw"),
        (holding(emulated.MODEL, 2825), "servo 3", "warn", "sts3250: it works"),
        (holding(emulated.MODEL, 1029), "servo 3", "fail", "model 1029"),
        (lambda arm: arm.world.disconnect(2), "servo 2", "fail", "servos behind it do"),
        (holding(emulated.ID, 9), "servos", "warn", "not an arm's answer: 9"),
        (holding(emulated.MODE, 1), "servo 3", "warn", "mode 1"),
        (holding(emulated.FIRMWARE_MINOR, 9), "firmware", "warn", "elbow_flex 3.9"),
        (lambda arm: arm.world.power(16.0), "servos", "fail", "made for at most 14.0 V"),
        (lambda arm: arm.world.power(10.0), "speed", "warn", "must not be asked"),
        (restarted, "torque", "warn", "elbow_flex is limp, the others hold"),
        (lambda arm: arm.world.warm("gripper", 57.0), "temperature", "warn", "57 °C, gripper"),
        (lambda arm: arm.world.warm("gripper", 66.0), "temperature", "fail", "66 °C, gripper"),
    ],
)
def test_a_trouble_is_named_with_what_to_do(arm, trouble, name, verdict, words):
    trouble(arm)
    arm.clock.advance(0.5)
    arm.world.advance(arm.clock.now())
    checks = check_up(seen_on(arm, stored=None))
    found = of(checks, name)
    assert found.verdict == verdict
    assert words in found.sentence
    assert found.fix
    assert is_healthy(checks) == all(check.verdict != "fail" for check in checks)


def test_one_weak_supply_is_one_line_and_other_servos_keep_their_own(arm):
    arm.world.power(7.2)
    holding(emulated.MODE, 1)(arm)
    warned = [each for each in check_up(seen_on(arm, stored=stored_of(arm))) if each.fix]
    assert [each.name for each in warned] == ["servos", "servo 3", "speed"]
    assert warned[0].sentence == (
        "all servos: each gets only 7.2 V but is a 12 V servo, so it will be weak and slow"
    )


def test_servos_made_for_less_are_told_apart_and_slow_ones_are_not_overrun():
    arm = LentArm(kind=STS3215_7V4, volts=5.0)
    checks = check_up(seen_on(arm, speed=to_rad(150.0)))
    assert "7.4 V type" in of(checks, "supply").sentence
    speed = of(checks, "speed")
    assert speed.verdict == "fail"
    assert "148 deg/s at 5.0 V" in speed.sentence


@pytest.mark.parametrize(
    ("bus_quality", "verdict"),
    [
        (QUIET, "ok"),
        (replace(QUIET, lost=20), "warn"),
        (replace(QUIET, corrupt=200), "fail"),
        (replace(QUIET, late=600, lateness=0.008), "warn"),
        (replace(QUIET, lateness=0.016, median=0.017), "warn"),
        (replace(QUIET, lateness=0.15, median=0.151), "fail"),
    ],
)
def test_a_bus_is_judged_by_what_gets_lost_and_how_long_a_reading_takes(arm, bus_quality, verdict):
    assert of(check_up(seen_on(arm, bus_quality=bus_quality)), "bus").verdict == verdict


LATE = replace(QUIET, lateness=0.016, median=0.017)
FILE = Path("/x.json")
LEROBOT = Path("/lerobot/mine.json")


@pytest.mark.parametrize(
    ("found", "name", "verdict", "sentence", "fix"),
    [
        ({"baudrate": 500_000}, "baud rate", "fail", "500000 baud", "so101 setup --repair"),
        ({"bus_quality": replace(QUIET, late=56)}, "bus", "warn", "56 were late", "latency timer"),
        ({"bus_quality": LATE, "latency_timer": 0.016}, "bus", "warn", "answers come 16 ms late",
         "latency_timer"),
        ({"file": FILE, "file_trouble": "elbow_flex: id missing"}, "calibration", "fail",
         "elbow_flex: id missing", "so101 calibration restore /x.json"),
        ({"file": FILE, "is_unfinished": True}, "calibration", "warn", "interrupted",
         "so101 calibrate"),
        ({"agreeing_file": LEROBOT}, "calibration", "warn", "not in use here",
         "so101 calibration import /lerobot/mine.json"),
    ],
)  # fmt: skip
def test_what_is_known_of_port_and_file_is_told(arm, found, name, verdict, sentence, fix):
    check = of(check_up(seen_on(arm, **found)), name)
    assert (check.verdict, check.fix.count(fix)) == (verdict, 1)
    assert sentence in check.sentence
    assert ("ms late" in check.sentence) is (found.get("bus_quality") is LATE)


def test_a_file_is_held_against_the_servos(arm):
    def told(stored):
        return of(check_up(seen_on(arm, stored=stored)), "calibration")

    one = {"elbow_flex": {"range_min": 700}}
    assert told(stored_of(arm, **one)).verdict == "warn"
    assert "elbow_flex: range_min is 700" in told(stored_of(arm, **one)).sentence
    two = told(stored_of(arm, **one, gripper={"range_min": 700}))
    assert two.sentence.endswith("; 1 more number differs")
    assert "if this is the file of another arm" in two.fix
    jawless = {j: entry for j, entry in stored_of(arm).calibration.items() if j != "gripper"}
    lacking = told(replace(stored_of(arm), calibration=jawless))
    assert (lacking.verdict, "gripper" in lacking.sentence) == ("fail", True)
    new = of(check_up(seen_on(LentArm(calibrated=False))), "calibration")
    assert (new.verdict, new.fix) == ("fail", "so101 calibrate")


def test_the_wheels_of_a_robot_on_the_arms_cable_are_no_trouble(arm):
    """LeKiwi has 7, 8 and 9 there, XLeRobot a head or wheels."""
    seen = seen_on(arm)
    seen = replace(seen, servos=replace(seen.servos, unexpected_ids=(7, 8, 9)))
    assert is_healthy(check_up(seen))
    assert "left alone" in of(check_up(seen), "servos").sentence
    assert seen.servos.ok


def meaning(joint, by, jaws_mm=0.0):
    return ZeroReport(joint=joint, by=by, angle_deg=0.0, jaws_mm=jaws_mm, sentence=f"{joint} {by}")


def test_zeros_that_are_guesses_are_one_warning_and_known_ones_are_reported_one_by_one():
    guesses = (meaning("shoulder_pan", "middle"), meaning("", "middle"))
    (check,) = check_up(Findings(zero_reports=guesses))
    assert (check.name, check.verdict) == ("zeros", "warn")
    mixed = (
        meaning("shoulder_pan", "stops"),
        meaning("elbow_flex", "middle"),
        meaning("wrist_roll", "middle"),
        meaning("", "middle, stops"),
    )
    verdicts = {check.name: check.verdict for check in check_up(Findings(zero_reports=mixed))}
    assert verdicts == {
        "zero of shoulder_pan": "ok", "zero of elbow_flex": "warn", "zero of wrist_roll": "ok",
        "zeros": "ok",
    }  # fmt: skip


def test_what_is_wrong_with_the_computer_comes_first_and_all_it_needs_is_listed():
    seen = Findings(
        software={"so101-motion": "1.0", "toppra": ""},
        planning_trouble="the planning process died",
        lost_adapters=("a CH340 adapter (1a86:7523) is plugged in: brltty has taken it",),
        port="/dev/x",
        interfering_programs={"ModemManager": "it meddles"},
    )
    checks = check_up(seen)
    assert [(check.name, check.verdict) for check in checks] == [
        ("software", "fail"), ("planner", "fail"), ("adapter", "fail"), ("port", "ok"),
        ("ModemManager", "warn"),
    ]  # fmt: skip
    assert "toppra" in checks[0].sentence
    refused = check_up(Findings(port="/dev/x", port_trouble="in use by python3"))
    assert not is_healthy(refused)
    assert not is_healthy(check_up(Findings(port_trouble="no adapter")))
    found = software()
    assert {"so101-motion", "numpy", "pin", "Python", "platform"} <= found.keys()
    assert all(found.values())


def test_ids_that_begin_at_2_are_recognised_and_no_servo_is_called_a_stranger(arm):
    for servo in arm.world.servos:
        servo.memory.keep(emulated.ID, servo.servo_id + 1)
    failed = [check for check in check_up(seen_on(arm)) if check.verdict == "fail"]
    assert [check.sentence[:22] for check in failed] == ["the ids run from 2 to "]
