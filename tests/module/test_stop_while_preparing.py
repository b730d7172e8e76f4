"""A stop also ends requests that have not begun their motion yet."""

import asyncio

import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.fake_parent import until
from harness.in_process_module import guarded_arm, in_time, refused
from viam.components.arm import JointPositions
from viam.proto.common import Pose

GOAL = JointPositions(values=[30.0, -45.0, 45.0, 60.0, 0.0])

MOVES = {
    "to joint positions": lambda arm: arm.move_to_joint_positions(GOAL),
    "to a position": lambda arm: arm.move_to_position(Pose(x=200, y=100, z=150, o_z=1)),
    "through joint positions": lambda arm: arm.move_through_joint_positions([GOAL]),
    "out of contact": lambda arm: arm.do_command({"command": "leave_contact"}),
}


class Slow:
    """What a request has to wait for first, such as the other arms of the machine."""

    def __init__(self, resource, monkeypatch):
        self.waiting, self.go_on = 0, asyncio.Event()
        monkeypatch.setattr(resource.surroundings, "update_other_arms", self.wait)

    async def wait(self):
        self.waiting += 1
        await self.go_on.wait()


@pytest.fixture
async def arm():
    async with guarded_arm(simulate_time=False) as arm:
        yield arm


@pytest.mark.parametrize("move", MOVES.values(), ids=MOVES)
async def test_a_stop_while_a_move_is_prepared_ends_it(arm, move, monkeypatch):
    slow, before = Slow(arm.resource, monkeypatch), arm.resource.rig.arm.state.q_ref
    moving = asyncio.ensure_future(move(arm))
    await until(lambda: slow.waiting)
    await arm.stop()
    slow.go_on.set()

    await refused(in_time(arm, moving), Status.CANCELLED, "ended early by stop")
    np.testing.assert_array_equal(arm.resource.rig.arm.state.q_ref, before)


async def test_a_move_that_is_asked_for_after_the_stop_is_carried_out(arm):
    await arm.stop()
    await in_time(arm, arm.move_to_joint_positions(GOAL))
    assert np.degrees(arm.resource.rig.arm.state.q)[0] == pytest.approx(30.0, abs=0.1)


async def test_a_newer_move_does_not_end_itself_when_it_makes_way(arm):
    older = asyncio.ensure_future(arm.move_to_joint_positions(GOAL))
    await until(lambda: arm.resource.rig.arm.is_moving or older.done())
    await in_time(arm, arm.move_to_position(Pose(x=200, y=100, z=150, o_z=1)))
    with pytest.raises(GRPCError):
        await older
