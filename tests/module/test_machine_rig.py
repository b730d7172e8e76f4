"""The arm of a running machine as a rig of this program: the module's real process, over TCP."""

import logging

import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.fake_parent import ARM, GRIPPER, SIMULATED, SIMULATED_GRIPPER
from harness.viam_machine import pause, until_true
from viam.components.arm import ArmClient
from viam.logging import LOGGERS

from so101_motion.common.errors import (
    ChoiceNeeded,
    ConfigError,
    Interrupted,
    MachineRefused,
    MachineUnavailable,
    MotionError,
    OutsideLimits,
    PlanningError,
)
from so101_motion.common.modes import Mode
from so101_motion.planning.goals import JointGoal, PathGoal, PoseGoal
from so101_motion.viam.client import MachineRig

READY = np.radians([0.0, -45.0, 45.0, 60.0, 0.0])
LEFT = np.radians([30.0, -45.0, 45.0, 60.0, 0.0])
FAR = np.radians([100.0, -45.0, 45.0, 60.0, 0.0])
RIGHT = np.radians([-30.0, -45.0, 45.0, 60.0, 0.0])


@pytest.fixture
def rig(machine):
    with MachineRig.connect(machine.address) as rig:
        rig.arm.set_speed(np.radians(180.0))
        rig.arm.set_acceleration(np.radians(500.0))
        yield rig


def test_a_camera_that_the_machine_has_not_is_refused_by_its_name(rig):
    with pytest.raises(ConfigError, match=r"'top'.*is not on the machine"):
        rig.picture("top")
    with pytest.raises(ConfigError, match=r"'gripper'.*is not a camera"):
        rig.picture("gripper")


def test_connecting_leaves_the_log_as_it_was(machine, monkeypatch):
    log = logging.getLogger("so101_motion")
    # As in a module's process, where the SDK sets the levels of our logger as well.
    monkeypatch.setitem(LOGGERS, "so101_motion", log)
    with MachineRig.connect(machine.address):
        assert log.isEnabledFor(logging.WARNING)
        assert not logging.getLogger("viam.rpc.dial").isEnabledFor(logging.CRITICAL)


def move_to(rig, q):
    rig.arm.move(JointGoal(q=q), wait=False).result(60.0)


def under_way(rig):
    """A long, slow motion that is visibly moving."""
    rig.arm.set_speed(np.radians(15.0))
    begin = rig.arm.state.q
    motion = rig.arm.move(JointGoal(q=FAR), wait=False)
    until_true(lambda: has_gone(rig, begin) or motion.future.done())
    return motion


def has_gone(rig, begin):
    return np.max(np.abs(rig.arm.state.q - begin)) > np.radians(3.0)


def test_a_request_that_moves_the_arm_is_a_motion_as_any_other(rig):
    move_to(rig, RIGHT)
    rig.arm.set_speed(np.radians(15.0))
    program = [{"name": "far", "q_deg": np.degrees(FAR).tolist()}]
    command = {"command": "run_program", "waypoints": program}
    for ends, by in ((rig.arm.stop, "stop"), (lambda: move_to(rig, RIGHT), "newer")):
        motion = rig.start_request(command)
        until_true(lambda: rig.arm.state.arm_moving and rig.arm.state.q[0] > RIGHT[0] + 0.05)
        assert rig.arm.state.arm_moving
        ends()
        with pytest.raises(Interrupted, match=by):
            motion.result(60.0)
    np.testing.assert_allclose(rig.arm.state.q, RIGHT, atol=np.radians(0.05))
    with pytest.raises(MachineRefused, match="no_such"):
        rig.start_request({"command": "no_such"}).result(60.0)


def test_a_jaw_that_is_stopped_stays(rig):
    for _ in range(20):  # once, unless the jaw is open before a busy machine has stopped it
        rig.gripper.grab(wait=False).result(60.0)
        motion = rig.gripper.move(1.0, wait=False)
        until_true(lambda: rig.gripper.aperture > 0.1)
        rig.gripper.stop()
        if motion.future.exception(60.0) is not None and rig.gripper.aperture < 0.95:
            break
    with pytest.raises(Interrupted):
        motion.result(60.0)
    assert rig.gripper.aperture < 0.95


def test_a_lost_machine_is_reported_and_found_again_and_nothing_moves(machine, rig):
    move_to(rig, RIGHT)
    motion = under_way(rig)
    machine.cut()
    try:
        with pytest.raises(MachineUnavailable, match="check that the machine runs"):
            motion.result(60.0)
        until_true(lambda: not rig.connection.is_up)
        assert rig.arm.state.mode is Mode.FAULT
        assert "lost" in rig.connection.words(rig.clock.now())
        with pytest.raises(MachineUnavailable):
            rig.arm.stop()
        with pytest.raises(MachineUnavailable):
            rig.arm.move(JointGoal(q=READY), wait=False).result(60.0)
    finally:
        machine.mend()
    until_true(lambda: rig.connection.is_up)
    assert rig.connection.words(rig.clock.now()) == "connected"
    until_true(lambda: rig.arm.state.mode is Mode.HOLDING)
    rests = rig.arm.state.q
    for _ in range(30):
        pause()
    np.testing.assert_allclose(rig.arm.state.q, rests, atol=1e-3)
    move_to(rig, READY)


def test_a_client_that_goes_away_takes_its_motion_with_it(machine, rig):
    move_to(rig, RIGHT)
    other = MachineRig.connect(machine.address)
    under_way(other)
    other.close()
    other.close()
    until_true(lambda: not rig.arm.state.arm_moving)
    assert rig.arm.state.q[0] < FAR[0] - np.radians(5.0)

    rig.arm.set_speed(np.radians(180.0))
    move_to(rig, RIGHT)
    with MachineRig.connect(machine.address) as other:  # also one that only sent a goal
        other.arm.set_speed(np.radians(15.0))
        other.arm.retarget(FAR)
        until_true(lambda: rig.arm.state.q[0] > RIGHT[0] + np.radians(5.0))
    until_true(lambda: not rig.arm.state.arm_moving)
    assert rig.arm.state.q[0] < FAR[0] - np.radians(5.0)


def test_caps_manual_mode_and_commands_are_the_machines_and_refusals_come_back_in_its_words(rig):
    assert rig.do_command("gripper", {"get": True})["position"] == pytest.approx(0.0, abs=100.0)
    assert rig.do_command("arm", {"get_motion_params": True}) == {
        "current_speed_degs_per_sec": pytest.approx(180.0),
        "current_acceleration_degs_per_sec_per_sec": pytest.approx(500.0),
    }
    rig.arm.set_manual(True)
    assert rig.arm.is_movable_by_hand
    rig.arm.set_manual(False)
    assert rig.arm.state.mode is Mode.HOLDING
    with pytest.raises(MachineRefused, match="set_speeed") as caught:
        rig.do_command("arm", {"set_speeed": 1.0})
    assert caught.value.status == "INVALID_ARGUMENT"
    with pytest.raises(ConfigError, match="did you mean"):
        rig.do_command("grippr", {"get": True})
    with pytest.raises(ConfigError, match="not a sensor"):
        rig.readings("arm")


def test_what_cannot_be_done_over_the_network_is_refused(rig):
    for call in (rig.arm.stream, rig.arm.jog):
        with pytest.raises(MotionError, match="machine"):
            call()
    with pytest.raises(OutsideLimits):
        rig.arm.retarget(np.radians([0.0, -45.0, 45.0, 60.0, 200.0]))


WALLED = {
    "obstacles": [{"name": "mug", "box_mm": [60, 60, 90], "position_mm": [250, 0, 45]}],
    "floor_z_mm": -10.0,
    "speed_degs_per_sec": 40.0,
    "max_speed_degs_per_sec": 60.0,
}


def test_of_several_arms_one_is_named_and_plans_use_its_obstacles_floor_and_caps(machine):
    for name, attributes in (("walled", WALLED), ("second", {})):
        machine.add(ARM, SIMULATED, name, attributes)
    machine.remove(GRIPPER, "gripper")
    try:
        of_several_arms_one_must_be_named(machine)
        with MachineRig.connect(machine.address, arm="walled") as rig:
            plans_use_what_the_module_has(rig)
    finally:
        for name in ("walled", "second"):
            machine.remove(ARM, name)
        machine.add(GRIPPER, SIMULATED_GRIPPER, "gripper")


def plans_use_what_the_module_has(rig):
    assert [obstacle.name for obstacle in rig.arm.scene.obstacles] == ["mug"]
    assert rig.arm.scene.floor_z == pytest.approx(-0.01)
    assert rig.arm.speed == pytest.approx(np.radians(40.0))
    with pytest.raises(ConfigError, match="60 deg/s"):
        rig.arm.set_speed(np.radians(61.0))
    rig.do_command("walled", {"set_speed": 50.0})  # as another client does
    until_true(lambda: rig.arm.speed == pytest.approx(np.radians(50.0)))
    lower, upper = rig.arm.range
    np.testing.assert_allclose(lower, rig.arm.model.lower)
    np.testing.assert_allclose(upper, rig.arm.model.upper)
    with pytest.raises(PlanningError, match="mug"):
        rig.arm.plan(PoseGoal.at_point(np.array([0.25, 0.0, 0.05])))
    assert not rig.has_gripper
    with pytest.raises(ConfigError, match="the machine has none"):
        rig.gripper.move(0.5, wait=False).result(60.0)
    rig.gripper.stop()  # as the page's Stop does: nothing to stop is no error


def test_a_key_whose_id_is_none_is_refused_and_not_shown():
    with pytest.raises(ConfigError, match="UUID") as caught:
        MachineRig.connect("127.0.0.1:9", api_key_id="me", api_key="secret")
    assert "secret" not in str(caught.value)


def of_several_arms_one_must_be_named(machine):
    with pytest.raises(ConfigError, match=r'one of arm, second, walled .*connect\(.*, arm="'):
        MachineRig.connect(machine.address)
    with pytest.raises(ChoiceNeeded, match=r"is not on the machine.*arm, second, walled"):
        MachineRig.connect(machine.address, arm="third")
    with MachineRig.connect(machine.address, arm="second") as rig:
        assert repr(rig) == f"<MachineRig: machine {machine.address}, holding>"
        assert repr(rig.gripper) == "<MachineGripper 0% open>"
        machine.remove(ARM, "second")
        until_true(lambda: rig.arm.state.mode is Mode.FAULT)
        assert rig.connection.is_up
        machine.add(ARM, SIMULATED, "second")
        until_true(lambda: rig.arm.state.mode is Mode.HOLDING)


def test_a_module_that_takes_no_trajectory_gets_the_corners_of_the_path(rig, monkeypatch):
    sent = []

    async def refuse(*_, **__):
        raise GRPCError(Status.UNIMPLEMENTED, "not known here")
        yield

    through = ArmClient.move_through_joint_positions

    async def note(self, positions, options=None, **kwargs):
        sent.append([list(each.values) for each in positions])
        await through(self, positions, options, **kwargs)

    move_to(rig, READY)
    monkeypatch.setattr(ArmClient, "move_through_joint_positions_streamed", refuse)
    monkeypatch.setattr(ArmClient, "move_through_joint_positions", note)
    corner = READY + np.radians([25.0, 0.0, -20.0, 0.0, 0.0])
    plan = rig.arm.plan(PathGoal(waypoints=np.array([corner, LEFT])))
    rig.arm.move(plan, wait=False).result(60.0)
    assert all(len(each) == 1 for each in sent)
    assert 2 <= len(sent) <= 8
    assert sent[-1][0] == pytest.approx(np.degrees(LEFT), abs=0.01)
    np.testing.assert_allclose(rig.arm.state.q, LEFT, atol=np.radians(0.1))
