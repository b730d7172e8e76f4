"""Moves, stops and streams of the simulated arm, over gRPC."""

import asyncio
import math
from contextlib import suppress

import numpy as np
import pytest
from grpclib import GRPCError, Status
from harness.fake_parent import until
from harness.in_process_module import (
    advance,
    duration_of,
    guarded_arm,
    in_time,
    joints,
    positions,
    refused,
)
from viam.components.arm import Pose

HOME = [0.0, -45.0, 45.0, 60.0, 0.0]
ELSEWHERE = [30.0, -30.0, 30.0, 40.0, 20.0]
ATTRIBUTES = {"acceleration_degs_per_sec_per_sec": 500.0}


async def start(client, call):
    """``call`` under way: planned, and visibly moving."""
    task = asyncio.ensure_future(call)
    begin = await positions(client)
    while np.max(np.abs(np.subtract(await positions(client), begin))) < 0.5:
        assert not task.done(), await task
        await advance(client, 0.02)
    return task


async def test_a_joint_move_takes_as_long_as_its_speed_says(client):
    await in_time(client, client.move_to_joint_positions(joints(*HOME)))
    fast = await duration_of(client, client.move_to_joint_positions(joints(60, *HOME[1:])))
    await client.do_command({"set_speed": 30.0})
    slow = await duration_of(client, client.move_to_joint_positions(joints(*HOME)))

    assert 60.0 / 90.0 < fast < 60.0 / 90.0 + 1.0
    assert 60.0 / 30.0 < slow < 60.0 / 30.0 + 1.0


async def test_a_full_pose_that_was_reached_before_is_reached_again(client):
    await in_time(client, client.move_to_joint_positions(joints(*ELSEWHERE)))
    goal = await client.get_end_position()
    await in_time(client, client.move_to_joint_positions(joints(*HOME)))
    extra = {"goal_metric_type": "full_pose"}
    await in_time(client, client.move_to_position(goal, extra=extra))
    pose = await client.get_end_position()

    assert (pose.x, pose.y, pose.z) == pytest.approx((goal.x, goal.y, goal.z), abs=0.2)
    assert pose.theta == pytest.approx(goal.theta, abs=1.0)


async def test_what_cannot_be_is_refused_and_moves_nothing(client):
    above = Pose(x=250, y=0, z=150, o_z=1)

    def to(**extra):
        return client.move_to_joint_positions(joints(*HOME), extra=extra)

    def through(**extra):
        return client.move_through_joint_positions([joints(*HOME)], extra=extra)

    for call, says in (
        (
            client.move_to_position(above, extra={"goal_metric_type": "position_onli"}),
            'did you mean "position_only"',
        ),
        (to(wait="no"), "wait"),
        (to(streamed="no"), "streamed"),
        (through(interpolate="no"), "interpolate"),
        (through(waitAtEnd="no"), "waitAtEnd"),
        (to(replan="yes"), "replan"),
        (to(replan=True, wait=False), "replan"),
        (through(replan=True), "replan"),
    ):
        await refused(call, Status.INVALID_ARGUMENT, says)
    await client.move_through_joint_positions([])
    assert not await client.is_moving()


async def test_a_point_out_of_reach_is_refused_with_how_far_and_where_to_go_instead(client):
    with pytest.raises(GRPCError) as caught:
        await in_time(client, client.move_to_position(Pose(x=600, y=0, z=200, o_z=1)))

    assert caught.value.status is Status.FAILED_PRECONDITION
    assert "mm" in caught.value.message
    assert "nearest" in caught.value.message.lower()


@pytest.mark.parametrize(
    ("values", "status", "says"),
    [
        ([0, 0, 95, 0, 0], Status.OUT_OF_RANGE, ("elbow_flex", "95", "90.8")),
        ([-111, 0, 0, 0, 0], Status.OUT_OF_RANGE, ("shoulder_pan", "-111", "-109.99")),
        ([], Status.INVALID_ARGUMENT, ("got 0 joint values", "elbow_flex")),
        ([0, 0, 0, 0], Status.INVALID_ARGUMENT, ("got 4 joint values", "elbow_flex")),
        ([0, 0, 0, 0, 0, 0], Status.INVALID_ARGUMENT, ("got 6 joint values",)),
        ([0, math.nan, 0, 0, 0], Status.INVALID_ARGUMENT, ("shoulder_lift", "finite")),
    ],
)
async def test_joint_values_that_cannot_be_are_refused_by_name(client, values, status, says):
    for call in (
        client.move_to_joint_positions(joints(*values)),
        client.move_to_joint_positions(joints(*values), extra={"wait": False}),
        client.move_through_joint_positions([joints(*HOME), joints(*values)]),
    ):
        await refused(call, status, *says)


async def ended(client):
    """Nothing moves any more; the time for that passes by itself."""

    async def rests():
        return not await client.is_moving()

    await until(rests)


async def at_rest(client):
    assert not await client.is_moving()
    before = await positions(client)
    await advance(client, 0.5)
    assert await positions(client) == pytest.approx(before, abs=0.01)


@pytest.mark.parametrize("by", ["its client", "its deadline"])
async def test_a_call_that_is_ended_brings_the_arm_to_rest(client, by):
    await in_time(client, client.move_to_joint_positions(joints(*HOME)))
    if by == "its client":
        move = await start(client, client.move_to_joint_positions(joints(*ELSEWHERE)))
        move.cancel()
    else:
        move = await start_before_the_deadline(client, ELSEWHERE)
    with pytest.raises((GRPCError, TimeoutError, asyncio.CancelledError)):
        await move
    await ended(client)

    await at_rest(client)
    assert np.max(np.abs(np.subtract(await positions(client), ELSEWHERE))) > 1.0


async def start_before_the_deadline(client, goal):
    """A move with a deadline, under way; a busy machine needs more time to plan it."""
    for seconds in (0.3, 1.0, 3.0, 10.0):
        with suppress(GRPCError, asyncio.TimeoutError):
            call = client.move_to_joint_positions(joints(*goal), timeout=seconds)
            return await start(client, call)
        await ended(client)
    raise AssertionError("it is never under way before its deadline")


async def test_a_motion_that_is_planned_again_goes_on_to_a_new_goal(client):
    replan = {"replan": True}
    await in_time(client, client.move_to_joint_positions(joints(*HOME), extra=replan))
    old = await start(client, client.move_to_joint_positions(joints(*ELSEWHERE), extra=replan))
    above = Pose(x=250, y=0, z=150, o_z=-1)
    await in_time(client, client.move_to_position(above, extra=replan))
    with pytest.raises(GRPCError, match="a newer motion"):
        await old
    reached = await client.get_end_position()
    assert (reached.x, reached.y, reached.z) == pytest.approx((250, 0, 150), abs=1.0)


async def test_without_waiting_the_call_returns_at_once_and_the_arm_goes_on(client):
    await in_time(client, client.move_to_joint_positions(joints(*HOME)))
    await client.move_to_joint_positions(joints(*ELSEWHERE), extra={"wait": False})
    await come_to_rest(client)
    assert await positions(client) == pytest.approx(ELSEWHERE, abs=0.01)


async def come_to_rest(client):
    assert await client.is_moving()
    while await client.is_moving():
        await advance(client, 0.05)


INTO_THE_TABLE = (0, 60, 0, 40, 0)


async def test_a_target_in_the_table_is_not_reached(client):
    await in_time(client, client.move_to_joint_positions(joints(*HOME)))
    await client.move_to_joint_positions(joints(*INTO_THE_TABLE), extra={"wait": False})
    await come_to_rest(client)
    assert (await client.get_end_position()).z > 0.0

    extra = {"interpolate": False}
    into = client.move_through_joint_positions([joints(*INTO_THE_TABLE)], extra=extra)
    with pytest.raises(GRPCError, match="close to the floor"):
        await in_time(client, into)
    assert (await client.get_end_position()).z > 0.0


async def test_without_the_guard_a_target_in_the_table_is_reached():
    async with guarded_arm(simulate_time=False, collision_guard=False) as client:
        await client.move_to_joint_positions(joints(*INTO_THE_TABLE), extra={"wait": False})
        await come_to_rest(client)
        assert (await client.get_end_position()).z < 0.0


async def test_a_stream_of_teleoperated_targets_is_followed_without_stopping(client):
    await in_time(client, client.move_to_joint_positions(joints(*HOME)))
    extra = {"interpolate": False, "waitAtEnd": False}
    path = []
    for i in range(60):
        goal = joints(0.5 * i, *HOME[1:])
        await client.move_through_joint_positions([goal], extra=extra)
        await advance(client, 0.03)
        path.append((await positions(client))[0])
    await advance(client, 2.0)
    steps = np.diff(path)[15:]

    assert (await positions(client))[0] == pytest.approx(29.5, abs=0.01)
    assert steps.min() > 0.2, "never stops on the way"


async def test_an_arm_that_is_being_removed_begins_no_other_move():
    async with guarded_arm() as client:
        sweep = asyncio.ensure_future(client.move_to_joint_positions(joints(60, 0, 0, 0, 0)))
        await until(client.is_moving)
        await client.resource.removed()
        again = client.move_to_joint_positions(joints(*HOME))
        retarget = client.move_to_joint_positions(joints(*HOME), extra={"wait": False})
        for move in (sweep, again, retarget):
            await refused(move, Status.CANCELLED, "removal of its arm")
        assert not await client.is_moving()
