"""Asking the machine for its frame system delays no Stop and no cancelled call."""

import asyncio

import pytest
from grpclib import GRPCError, Status
from harness.fake_machine import FakeMachine, hanging
from harness.fake_parent import until
from harness.in_process_module import arm_client, new_arm
from viam.components.arm import Pose

from so101_motion.viam.conversion.frames import set_machine

THERE = Pose(x=250, y=60, z=150, o_z=1)


@pytest.fixture
async def asked():
    """An arm that asks a machine which never answers, and that machine."""
    machine = FakeMachine(hanging("arm", joints=5))
    machine.silent = True
    set_machine(lambda: machine)
    arm = new_arm(simulate_time=False)
    async with arm_client(arm) as client:
        yield client, machine, arm
    await arm.close()
    set_machine(lambda: None)


async def test_a_stop_does_not_wait_for_what_the_machine_says(asked):
    client, machine, arm = asked
    move = asyncio.ensure_future(client.move_to_position(THERE))
    await until(lambda: machine.asked > 0)
    await client.stop()
    with pytest.raises(GRPCError) as stopped:
        await move
    assert stopped.value.status is Status.CANCELLED
    assert "stop" in stopped.value.message
    assert not arm.rig.arm.is_moving


async def test_a_cancelled_call_ends_at_once_and_the_next_one_is_answered(asked):
    client, machine, arm = asked
    move = asyncio.ensure_future(client.move_to_position(THERE))
    await until(lambda: machine.asked > 0)
    move.cancel()
    with pytest.raises(asyncio.CancelledError):
        await move
    await until(lambda: arm.rig.arm.newest_motion.future.done())
    newer = asyncio.ensure_future(client.move_to_position(THERE))
    await until(lambda: machine.asked > 1)
    machine.configs, machine.silent = GRPCError(Status.UNKNOWN, "broken"), False
    machine.answer.set()
    with pytest.raises(GRPCError, match="broken"):
        await newer
