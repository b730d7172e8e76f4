"""A machine's calibration sensor, read back into the state a calibrator shows."""

import json
from contextlib import closing
from pathlib import Path

import pytest
from harness.calibration_rig import LentArm
from so101_viewer.setup.machine import MachineCalibrator

from so101_motion.calib.motors.setup_view import SetupView
from so101_motion.calib.procedure.session import Session
from so101_motion.calib.procedure.steps import Command, State
from so101_motion.common.errors import CalibrationError, MachineUnavailable
from so101_motion.setup.calibrator import Situation
from so101_motion.setup.situation_json import from_readings, readings


def over_the_wire(situation):
    """Its readings as they arrive: numbers are floats, and nothing is null."""
    told = {key: value for key, value in readings(situation).items() if value is not None}

    def cleaned(value):
        if isinstance(value, dict):
            return {k: cleaned(v) for k, v in value.items() if v is not None}
        return [cleaned(v) for v in value] if isinstance(value, list) else value

    return json.loads(json.dumps(cleaned(told)), parse_int=float)


@pytest.fixture
def session(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    return Session(tmp_path / "arm.json")


def situation(session):
    view = session.view
    return Situation(
        view=view,
        setup=SetupView(),
        joints=view.joints,
        angles=dict.fromkeys(view.joints, 0.25),
        calibration_file=Path("/home/me/arm.json"),
        is_connected=True,
        holds=False,
        notes=("a note",),
    )


def steps(session, arm):
    """Every state of a calibration."""
    session.start(arm)
    arm.tick(3)
    yield State.STARTED
    session.set_homing()
    arm.tick(3)
    yield State.HOMED
    session.start_recording()
    arm.tick(5)
    yield State.RECORDING
    arm.sweep("elbow_flex", *arm.stops("elbow_flex"))
    yield State.RECORDING
    arm.sweep_all()
    session.stop_recording()
    yield State.COMPLETED


def test_readings_come_back_as_they_were_in_every_state(session):
    for state in steps(session, LentArm(calibrated=False)):
        sent = situation(session)
        got = from_readings(over_the_wire(sent), sent.angles)
        assert got.view.state is state
        assert got.joints.keys() == sent.joints.keys()
        for joint, view in sent.joints.items():
            there = got.joints[joint]
            assert there.expected_deg == pytest.approx(view.expected_deg, abs=0.05)
            for name in view.__slots__:
                if name != "expected_deg":
                    assert getattr(there, name) == getattr(view, name), (joint, name)
        assert got.view.commands == sent.view.commands
        assert got.view.instruction == sent.view.instruction
        assert got.setup == sent.setup
        assert (got.angles, got.notes, got.holds) == (sent.angles, sent.notes, sent.holds)
        assert got.calibration_file == sent.calibration_file


@pytest.mark.parametrize("told", [{}, {"calibration_state": "napping"}, {"a": 1}])
def test_another_sensors_readings_are_refused_with_a_hint(told):
    with pytest.raises(CalibrationError, match="devrel:so101:calibration"):
        from_readings(told, {})


class Machine:
    """A sensor that answers, until it does not."""

    def __init__(self, session):
        self.session = session
        self.is_gone = False
        self.asked = []

    def read(self):
        if self.is_gone:
            raise MachineUnavailable("10.0.0.7:8080", "does not answer")
        return over_the_wire(situation(self.session))

    def ask(self, command):
        if self.is_gone:
            raise MachineUnavailable("10.0.0.7:8080", "does not answer")
        if command["command"] == "get_current_positions":
            return {"positions": {}}
        self.asked.append(dict(command))
        return {"success": True, "torque_enabled": True, "calibration_file": "/data/arm.json"}


@pytest.fixture
def machine(session):
    return Machine(session)


@pytest.fixture
def calibrator(machine):
    made = MachineCalibrator(machine.ask, machine.read)
    yield made
    made.close()


def test_steps_are_the_sensors_commands(calibrator, machine):
    calibrator.step(Command.START)
    calibrator.step(Command.STOP_RECORDING, accept=("gripper",))
    assert calibrator.step(Command.SAVE).stored.path == Path("/data/arm.json")
    assert calibrator.step(Command.ABORT).holds
    assert calibrator.restore().stored.path == Path("/data/arm.json")
    calibrator.motor_setup.discover("gripper")
    assert machine.asked == [
        {"command": "start"},
        {"command": "stop_range_recording", "accept": ["gripper"]},
        {"command": "save_calibration"},
        {"command": "abort"},
        {"command": "restore_calibration"},
        {"command": "motor_setup_discover", "motor_name": "gripper"},
    ]


def test_holding_and_letting_go_is_the_arms_and_refused_where_there_is_none(calibrator, machine):
    asked = []
    with closing(MachineCalibrator(machine.ask, machine.read, set_torque=asked.append)) as of_arm:
        of_arm.hold()
        of_arm.let_go()
    assert asked == [True, False]
    for call in (calibrator.hold, calibrator.let_go):
        with pytest.raises(CalibrationError, match="add the arm to the machine's configuration"):
            call()


def test_a_machine_that_is_gone_leaves_what_was_seen_and_says_so(calibrator, machine):
    machine.is_gone = True
    with pytest.raises(MachineUnavailable):
        calibrator.step(Command.START)
    now = calibrator.situation
    assert not now.is_connected
    assert "does not answer" in now.view.error
    machine.is_gone = False
    calibrator.step(Command.START)
    assert calibrator.situation.is_connected
