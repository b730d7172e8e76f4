"""What every arm promises those who call it through Viam: simulated, and on emulated servos."""

import asyncio
from contextlib import AsyncExitStack, suppress
from datetime import timedelta

import numpy as np
import pytest
from grpclib import GRPCError, Status
from grpclib.exceptions import StreamTerminatedError
from harness.emulated_rig import ModelBench
from harness.in_process_module import advance, arm_client, joints, new_arm, positions, refused
from viam.components.arm import Arm, MoveOptions

from so101_motion.viam.models.simulated import SimulatedArm

QUICK = {"acceleration_degs_per_sec_per_sec": 300.0}


class Served:
    """An arm behind a channel; its time passes when the test lets it."""

    def __init__(self, arm, client, pass_time):
        self.arm, self.client, self.pass_time = arm, client, pass_time

    async def place(self):
        return np.array(await positions(self.client))

    async def near(self, *by_deg):
        return await self.place() + by_deg

    def move(self, q_deg, client=None, **how):
        return (client or self.client).move_to_joint_positions(joints(*q_deg), **how)

    async def in_time(self, call):
        """The outcome of ``call`` while time passes."""
        task = asyncio.ensure_future(call)
        while not task.done():
            await self.pass_time(0.05)
            await asyncio.wait([task], timeout=0.002)
        return await task

    async def under_way(self, call):
        """``call`` as a task, once the arm is seen to move."""
        task, begin = asyncio.ensure_future(call), await self.place()
        while np.abs(await self.place() - begin).max() < 2.0:
            assert not task.done(), await task
            await self.pass_time(0.02)
            await asyncio.wait([task], timeout=0.002)
        return task

    async def rests(self):
        """The arm comes to rest without anybody's doing, and stays there; where that is [deg]."""
        async with asyncio.timeout(60):
            while await self.client.is_moving():
                await self.pass_time(0.01)
                await asyncio.sleep(0.001)
        await self.pass_time(0.5)  # real joints are up to a degree past the end of their ramp
        before = await self.place()
        await self.pass_time(1.0)
        assert not await self.client.is_moving()
        assert await self.place() == pytest.approx(before, abs=0.3)
        return before


@pytest.fixture(params=["simulated", "on servos"])
async def served(request, tmp_path, planning_process):
    if request.param == "simulated":
        SimulatedArm.left_at.clear()  # or it would stand where the last one of its name was left
        arm = new_arm(simulate_time=False, **QUICK)
        async with arm_client(arm) as client:
            yield Served(arm, client, lambda seconds: advance(client, seconds))
        await arm.close()
        return
    models = ModelBench(tmp_path)
    arm = models.new_arm(**QUICK)
    await models.pass_time(1.0)  # the weight is taken up
    async with arm_client(arm) as client:
        yield Served(arm, client, models.pass_time)
        await models.pass_time(5.0)  # a move that a failed test left ends
    await models.end()


async def test_a_move_blocks_until_the_arm_has_settled_there(served):
    goal = await served.near(20, -10, 10, 10, 20)
    await served.in_time(served.move(goal))
    assert not await served.client.is_moving()
    assert await served.place() == pytest.approx(goal, abs=0.5)


@pytest.mark.parametrize(
    ("by", "status"), [("a stop", Status.CANCELLED), ("a newer move", Status.ABORTED)]
)
async def test_a_stop_cancels_a_move_and_a_newer_move_aborts_it(served, by, status):
    start = await served.place()
    move = await served.under_way(served.move(start + 60.0 * np.eye(5)[0]))
    if by == "a stop":
        await served.in_time(served.client.stop())
    else:
        await served.in_time(served.move(start))
        assert await served.place() == pytest.approx(start, abs=0.5)
    await refused(move, status)
    assert (await served.rests())[0] < start[0] + 50.0


@pytest.mark.parametrize("by", ["its client", "its deadline", "its connection"])
async def test_a_move_whose_call_ends_comes_to_rest(served, by):
    goal = await served.near(80, 0, 0, 0, 0)
    if by == "its connection":
        connection = AsyncExitStack()
        other = await connection.enter_async_context(arm_client(served.arm))
        move = await served.under_way(served.move(goal, other))
        await served.in_time(connection.aclose())
    elif by == "its client":
        move = await served.under_way(served.move(goal))
        move.cancel()
    else:
        move = await under_way_before_its_deadline(served, goal)
    with pytest.raises((GRPCError, TimeoutError, asyncio.CancelledError, StreamTerminatedError)):
        await asyncio.wait_for(move, 30.0)
    assert (await served.rests())[0] < goal[0] - 5.0


async def under_way_before_its_deadline(served, goal):
    """A move with a deadline, under way; a busy machine needs more time to plan it."""
    for seconds in (0.3, 1.0, 3.0, 10.0):
        with suppress(GRPCError, asyncio.TimeoutError):
            return await served.under_way(served.move(goal, timeout=seconds))
        await served.in_time(served.client.stop())  # else it may begin before the arm hears
    raise AssertionError("it is never under way before its deadline")


async def test_waypoints_are_passed_in_one_go_no_faster_than_asked(served):
    """GoToInputs arrives as this call, for viam-server makes one of it."""
    start = await served.place()
    way = [start + by for by in ([20, 0, 0, 0, 0], [20, 0, 0, 0, 20], [0, 0, 0, 0, 0])]
    options = MoveOptions(max_vel_degs_per_sec=20.0, max_acc_degs_per_sec2=100.0)
    tape = []
    end = served.arm.rig.executor.listen(lambda state: tape.append(np.degrees(state.q_ref)))
    call = served.client.move_through_joint_positions([joints(*q) for q in way], options)
    await served.in_time(call)
    end()
    for point in way:
        assert np.abs(np.array(tape) - point).max(axis=1).min() < 3.0
    qd = np.diff(tape, axis=0) / served.arm.rig.executor.dt
    assert 15.0 < np.abs(qd).max() <= 20.1
    assert await served.place() == pytest.approx(start, abs=0.5)


async def test_points_that_are_streamed_are_played_to_the_end(served):
    start = await served.place()
    share = 0.5 - 0.5 * np.cos(np.pi * np.arange(41) / 40)
    points = [
        Arm.TrajectoryPoint(timedelta(seconds=0.05 * k), list(start + each * np.eye(5)[0] * 20.0))
        for k, each in enumerate(share)
    ]

    async def batches():
        yield points

    async def play():
        return [u async for u in served.client.move_through_joint_positions_streamed(batches())]

    assert await served.in_time(play())
    assert (await served.place())[0] == pytest.approx(start[0] + 20.0, abs=0.6)


async def test_without_waiting_the_call_returns_at_once_and_the_arm_goes_on(served):
    goal = await served.near(30, -10, 10, 0, 20)
    await served.move(goal, extra={"wait": False})
    assert await served.client.is_moving()
    assert await served.rests() == pytest.approx(goal, abs=0.5)


async def test_a_goal_that_cannot_be_is_refused_and_nothing_moves(served):
    for values, status, says in [
        ([0, 0, 0, 0], Status.INVALID_ARGUMENT, "got 4 joint values"),
        ([0, 0, 0, 0, 0, 0], Status.INVALID_ARGUMENT, "got 6 joint values"),
        ([0, float("nan"), 0, 0, 0], Status.INVALID_ARGUMENT, "shoulder_lift"),
        ([0, 0, 120, 0, 0], Status.OUT_OF_RANGE, "elbow_flex"),
    ]:
        before = await served.place()
        for extra in ({}, {"wait": False}):
            await refused(served.move(values, extra=extra), status, says)
        assert await served.rests() == pytest.approx(before, abs=0.3)
