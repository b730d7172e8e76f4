"""The command line on a running machine: the module's real process, over TCP."""

import contextlib
import json

import numpy as np
import pytest
from click.testing import CliRunner
from harness.viam_machine import running_machine, until_true

from so101_motion.cli.verbs import main
from so101_motion.common.errors import MachineRefused, So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS
from so101_motion.planning.goals import JointGoal
from so101_motion.viam.client import MachineRig


@pytest.fixture(autouse=True)
def nothing_from_the_environment(monkeypatch):
    for name in ("SO101_PORT", "SO101_MACHINE", "SO101_API_KEY", "SO101_API_KEY_ID"):
        monkeypatch.delenv(name, raising=False)


def run(*arguments):
    return CliRunner().invoke(main, list(arguments))


def test_a_machines_arm_is_moved_as_any_other(machine):
    at = ("--machine", machine.address)
    result = run("move", *at, "--joints", "10,-40,40,40,0", "--speed", "120", "--yes", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["arrived"]["off_deg"] < 0.1
    told = json.loads(run("status", *at, "--json").stdout)
    assert told["mode"] == "holding"
    assert told["q_deg"]["shoulder_pan"] == pytest.approx(10.0, abs=0.1)
    assert {each["name"] for each in told["resources"]} == {"arm", "gripper"}
    planned = json.loads(run("plan", *at, "--xyz", "250,0,100", "--json").stdout)
    assert planned["q_start_deg"] == pytest.approx([10, -40, 40, 40, 0], abs=0.1)
    result = run("status", *at)
    assert "shoulder_lift" in result.stdout
    how = ("--joints", "20,-40,40,40,0", "--speed", "120", "--at-end", "home", "--yes")
    assert run("move", *at, *how).exit_code == 0
    told = json.loads(run("status", *at, "--json").stdout)
    assert [*told["q_deg"].values()][:5] == pytest.approx([0.0] * 5, abs=0.1)


def test_a_machines_arm_is_stopped_whoever_moves_it(machine):
    with MachineRig.connect(machine.address) as rig:
        here = JointGoal(q=np.radians([0.0, -40.0, 40.0, 40.0, 0.0]))
        rig.arm.move(here, wait=False).result(60.0)
        rig.arm.set_speed(np.radians(5.0))  # the command has 18 s for its connection
        motion = rig.arm.move(JointGoal(q=np.radians([100.0, -40.0, 40.0, 40.0, 0.0])), wait=False)
        until_true(lambda: rig.arm.state.q[0] > np.radians(1.0) or motion.future.done())
        result = run("stop", "--machine", machine.address)
        assert result.exit_code == 0, result.output
        assert "holding" in result.stdout
        assert motion.future.exception(60.0) is not None
        assert np.degrees(rig.refresh().q[0]) < 95.0
        rig.arm.set_speed(np.radians(90.0))


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("status", "--machine", "127.0.0.1:9"), 3, "no program listens"),
        (("move", "--machine", "127.0.0.1:9", "--pose", "home"), 3, "try: check that"),
        (("stop",), 2, "give --machine"),
        (
            ("plan", "--machine", "m", "--from", "0,0,0,0,0", "--pose", "home"),
            2,
            "works only with --sim",
        ),
        (("status", "--machine", "m", "--api-key", "k"), 2, "belong together"),
        (("view", "--machine", "m", "--at-end", "park"), 2, '"at_end" of its arm does that'),
    ],
)
def test_a_machine_that_cannot_be_asked_is_a_sentence_and_an_exit_code(arguments, code, says):
    result = run(*arguments)
    assert result.exit_code == code, result.output
    assert says in result.stderr


def test_the_doctor_has_nothing_against_a_machine_whose_arm_has_no_servos(machine):
    result = run("doctor", "--machine", machine.address)
    assert result.exit_code == 0, result.output
    assert "no servos to check" in result.stderr


def test_a_machine_on_servos_tells_how_they_are_and_that_a_cable_came_out():
    with running_machine(emulated=True) as machine:
        told = json.loads(run("doctor", "--machine", machine.address, "--json").stdout)
        assert told["told"]["servos_found"] == [1, 2, 3, 4, 5, 6]
        with MachineRig.connect(machine.address) as rig:
            assert set(rig.status["health"]) == {*ARM_JOINTS, "gripper"}
            assert rig.readings("calibration")["calibration_state"] == "idle"
            until_true(lambda: is_held(rig))
            machine.fault("unplug")
            until_true(lambda: rig.arm.state.mode is Mode.FAULT)
            assert rig.connection.is_up
            assert rig.arm.state.fault
            for name, ask in (
                ("arm", lambda arm: arm.get_joint_positions()),
                ("arm", lambda arm: arm.get_end_position()),
                ("gripper", lambda gripper: gripper.do_command({"get": True})),
            ):
                with pytest.raises(
                    MachineRefused, match=r"plug it in again|check its cable"
                ) as caught:
                    rig._ask(name, "where it is", ask)
                assert caught.value.status == "UNAVAILABLE"
            machine.fault("end unplug")
            until_true(lambda: is_held(rig))


def is_held(rig):
    """Let the joints be held, as soon as the port is back."""
    with contextlib.suppress(So101Error):
        rig.arm.set_torque(True)
    return rig.arm.state.mode is Mode.HOLDING
