"""Trajectories that a client sends while they are played, over gRPC: too fast, too late, broken."""

import asyncio
import math
from datetime import timedelta

import numpy as np
import pytest
from grpclib import GRPCError, Status
from grpclib.exceptions import StreamTerminatedError
from harness.in_process_module import advance, arm_client, refused
from viam.components.arm import Arm

ATTRIBUTES = {"speed_degs_per_sec": 60.0, "acceleration_degs_per_sec_per_sec": 200.0}


def point(t, pan, *rest):
    return Arm.TrajectoryPoint(time=timedelta(seconds=t), positions=[pan, *(rest or [0.0] * 4)])


def swaying(begin, end, dt=0.05):
    """Points of a slow swing of the first joint."""
    times = np.arange(begin, end, dt)
    return [point(float(t), 20.0 * (1.0 - math.cos(0.8 * t))) for t in times]


async def passing(client, task, seconds=60.0):
    """What ``task`` ends with while simulated time passes."""
    for _ in range(round(seconds / 0.05)):
        if task.done():
            break
        await advance(client, 0.05)
        await asyncio.sleep(0.001)
    return await task


def play(client, batches, updates=None):
    async def playing():
        async for _ in client.move_through_joint_positions_streamed(batches):
            if updates is not None:
                updates.append(await advance(client, 0.0))

    return asyncio.ensure_future(playing())


async def pan(client):
    return (await client.get_joint_positions()).values[0]


async def at_rest(client):
    async with asyncio.timeout(30):
        while await client.is_moving():
            await advance(client, 0.01)


async def test_what_is_sent_too_early_waits_until_the_arm_comes_nearer(arm, client):
    taken, points = [], 0

    async def long_before_it_is_due():
        nonlocal points
        for k in range(60):
            batch = swaying(0.5 * k, 0.5 * (k + 1))
            points += len(batch)
            yield batch

    task = play(client, long_before_it_is_due(), taken)
    await asyncio.sleep(0)
    await passing(client, task)
    ahead = 0.5 * np.arange(1, 61) - (np.array(taken) - taken[0])
    assert len(taken) == 60, "an acknowledgement for each batch"
    assert ahead.max() < 4.0, "points of at most some seconds are taken in advance"
    assert taken[-1] - taken[0] > 26.0
    assert await pan(client) == pytest.approx(20.0 * (1.0 - math.cos(0.8 * 29.95)), abs=0.1)


@pytest.mark.parametrize(
    ("batch", "says"),
    [
        ([point(0.45, 5.0)], "increase"),
        ([point(0.6, math.nan)], "finite"),
        ([point(0.6, 3.0, 0.0)], "5"),
        ([point(0.6, 40.0)], "give the points more time"),
        ([point(3.0, 170.0)], "shoulder_pan"),
    ],
)
async def test_a_broken_point_is_refused_with_a_sentence_and_the_arm_rests(client, batch, says):
    async def broken():
        yield swaying(0.0, 0.5)
        yield batch
        await asyncio.Event().wait()

    error = await refused(passing(client, play(client, broken())), None, says)
    assert error.status in (Status.INVALID_ARGUMENT, Status.OUT_OF_RANGE)
    await at_rest(client)


@pytest.mark.parametrize("loss", ["cancelled", "connection"])
async def test_a_client_that_is_lost_leaves_an_arm_at_rest(arm, client, loss):
    async with arm_client(arm) as other:

        async def endless():
            for k in range(1000):
                yield swaying(0.5 * k, 0.5 * (k + 1))

        task = play(other, endless())
        async with asyncio.timeout(30):
            while await pan(client) < 4.0:
                await advance(client, 0.05)
                await asyncio.sleep(0.001)
        if loss == "cancelled":
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
    if loss == "connection":
        with pytest.raises((GRPCError, StreamTerminatedError)):
            await asyncio.wait_for(task, 30.0)
    await at_rest(client)
    here = await pan(client)
    await advance(client, 2.0)
    assert await pan(client) == pytest.approx(here, abs=0.01)
