"""The guided verbs on a terminal, with an emulated arm in the other hand."""

import json
import signal

import numpy as np
import pytest
from click.testing import CliRunner
from harness.held_calibration import lead
from harness.terminal_user import Typist

from so101_motion.calib.procedure import journal
from so101_motion.calib.record import store
from so101_motion.calib.record.record import JOINTS
from so101_motion.cli.verbs import main
from so101_motion.drivers.bus.defaults import SERVO_IDS
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.faults import parse_fault
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.port_settings import ServoSettings


@pytest.fixture
def make_kit(tmp_path):
    made = []

    def make(**options):
        made.append(Emulator(EmulatorOptions(link=tmp_path / "arm", **options)))
        return made[-1]

    yield make
    for kit in made:
        kit.close()


@pytest.fixture
def arm(make_kit):
    """A finished arm without weight, limp at its zeros."""
    return make_kit()


def eeprom(kit):
    return [bytes(servo.memory.bytes[:40]) for servo in kit.world.servos]


def until_recording(person):
    person.sees("put one hand on the arm")
    person.presses("\n")
    person.sees("in the middle of its travel")
    person.sees("opens straight upwards")
    person.presses("\n")
    person.sees("homing pose is taken")
    person.sees("Move every joint slowly")


def until_asked_to_save(person, arm):
    until_recording(person)
    person.presses("\n")
    person.sees("Finish the recording: move every joint")
    lead(arm, (*np.linspace(0.5, 0, 15), 0, 0, *np.linspace(0, 1, 30), 1, 1, 0.5))
    person.sees("Finish the recording in")
    person.sees("Look at what was recorded")


# Calibrating


def test_a_calibration_by_hand_is_saved_once_the_person_says_so(arm, tmp_path):
    file = tmp_path / "mine.json"
    asked = ("calibrate", "--port", arm.port, "--file", str(file), "--joint", "elbow_flex")
    with Typist(*asked) as person:
        until_asked_to_save(person, arm)
        assert not file.exists()
        person.presses("\n")
        person.sees(f"Saved: {file}")
        person.sees("the arm is held")
        assert person.code() == 0
    ((joint, entry),) = store.read(file).calibration.items()
    assert joint == "elbow_flex"
    shaft = arm.world.servo("elbow_flex").drive.shaft
    ends = (entry.range_min + entry.homing_offset, entry.range_max + entry.homing_offset)
    assert ends == pytest.approx((shaft.lower, shaft.upper), abs=2)
    torque = [servo.memory.raw(reg.TORQUE_ENABLE) for servo in arm.world.servos]
    assert torque == [1] * 6


def test_ctrl_c_puts_everything_back_and_says_how_the_arm_is(arm, tmp_path):
    before = eeprom(arm)
    with Typist("calibrate", "--port", arm.port, "--file", str(tmp_path / "x.json")) as person:
        until_recording(person)
        assert eeprom(arm) != before
        person.interrupts()
        person.sees("the motors have their previous settings again; the joints are")
        person.sees("limp")  # on the next line of a narrow terminal
        assert person.code() == 130
    assert eeprom(arm) == before
    assert list(tmp_path.glob("x.json*")) == []


def test_a_calibration_that_is_killed_while_it_saves_is_completed_by_the_next_start(arm, tmp_path):
    """At every other step: tests/unit/calib/procedure/test_session_crashes.py."""

    file, first = tmp_path / "mine.json", arm.world.servos[0].memory
    with Typist("calibrate", "--port", arm.port, "--file", str(file)) as person:
        until_asked_to_save(person, arm)
        write, homed = first.write, first.flash

        def written(address, data):
            rows = write(address, data)
            if first.flash != homed:  # then five servos are left, and the file
                person.command.kill()
            return rows

        first.write = written
        person.presses("\n")
        assert person.code() == -signal.SIGKILL
    settings = ServoSettings(port=arm.port, timeout=0.0, calibration_file=file)
    with open_hardware(settings.with_arm(SERVO_IDS), reply_timeout=0.2) as rig:
        in_use = rig.servos.calibration
    assert not journal.path_for(file).exists()
    assert store.read(file).calibration == in_use
    for servo in arm.world.servos:
        entry = in_use[servo.joint.name]
        rows = [servo.memory.raw(row) for row in (reg.OFFSET, reg.MIN_POSITION, reg.MAX_POSITION)]
        assert rows == [reg.encode_offset(entry.homing_offset), entry.range_min, entry.range_max]


# Setting motors up


def test_a_motor_that_is_not_as_it_must_be_is_named_with_what_to_do(arm):
    arm.world.servo("elbow_flex").memory.keep(reg.MODE, 1)
    result = CliRunner().invoke(main, ["setup", "--port", arm.port, "--yes"])
    assert result.exit_code == 6
    assert "servo 3 (elbow_flex)" in result.stderr
    assert "try:" in result.stderr


@pytest.mark.long  # half a minute of real time
def test_a_kit_as_new_is_set_up_motor_by_motor(make_kit):
    kit = make_kit(ids=dict.fromkeys(range(1, 7), 1), loose=True, calibrated=False)
    with Typist("setup", "--port", kit.port, "--yes") as person:
        for joint in reversed(JOINTS):
            person.sees(f"only the motor of {joint}")
            kit.begin(parse_fault(f"only:{joint}"))
        person.sees("Put all six")
        kit.begin(parse_fault("chain"))
        assert person.code() == 0
    assert [servo.memory.raw(reg.ID) for servo in kit.world.servos] == [1, 2, 3, 4, 5, 6]


def test_a_motor_that_was_replaced_is_set_up_alone(make_kit):
    kit = make_kit(ids={4: 1}, calibrated=False)
    arguments = ["setup", "--port", kit.port, "--joint", "wrist_flex", "--yes", "--json"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    assert kit.world.servo("wrist_flex").memory.raw(reg.ID) == 4
    assert json.loads(result.stdout)["ok"] is None


def test_a_setup_that_is_stopped_says_that_it_goes_on_later(make_kit):
    kit = make_kit(ids={place: place for place in range(1, 7)}, loose=True, calibrated=False)
    kit.begin(parse_fault("only:gripper"))
    with Typist("setup", "--port", kit.port) as person:
        person.sees("✓ gripper")
        person.sees("nplug the motor of gripper and write 6 on it")
        person.presses("q")
        person.sees("so101 setup continues here")
        assert person.code() == 7
