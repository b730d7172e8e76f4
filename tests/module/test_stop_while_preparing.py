"""A stop also ends requests that have not begun their motion yet."""

import asyncio

import numpy as np
import pytest
from grpclib import Status
from harness.fake_machine import FakeMachine, hanging
from harness.fake_parent import until
from harness.in_process_module import guarded_arm, refused
from viam.components.arm import JointPositions
from viam.proto.common import Pose

from so101_motion.viam.conversion.frames import set_machine

GOAL = JointPositions(values=[30.0, -45.0, 45.0, 60.0, 0.0])

MOVES = {
    "to joint positions": lambda arm: arm.move_to_joint_positions(GOAL),
    "to a position": lambda arm: arm.move_to_position(Pose(x=200, y=100, z=150, o_z=1)),
    "through joint positions": lambda arm: arm.move_through_joint_positions([GOAL]),
    "out of contact": lambda arm: arm.do_command({"command": "leave_contact"}),
}


@pytest.fixture
async def arm():
    async with guarded_arm(simulate_time=False) as arm:
        yield arm


@pytest.fixture
def machine(arm):
    """A machine that is asked for its frame system and does not answer yet."""
    machine = FakeMachine(hanging("arm", joints=5))
    machine.silent = True
    set_machine(lambda: machine)
    yield machine
    set_machine(lambda: None)


@pytest.mark.parametrize("move", MOVES.values(), ids=MOVES)
async def test_a_stop_while_a_move_is_prepared_ends_it(arm, move, machine, monkeypatch):
    asked = machine.get_frame_system_config
    if move is MOVES["through joint positions"]:  # it waits for other arms alone
        monkeypatch.setattr(arm.resource.surroundings, "update_other_arms", asked)
    before = arm.resource.rig.arm.state.q_ref
    moving = asyncio.ensure_future(move(arm))
    await until(lambda: machine.asked > 0)
    await arm.stop()
    if move is MOVES["through joint positions"]:
        machine.answer.set()
    await refused(moving, Status.CANCELLED, "ended early by stop")
    assert not arm.resource.rig.arm.is_moving
    np.testing.assert_array_equal(arm.resource.rig.arm.state.q_ref, before)
