"""Stop while plans, streams, jogs and recordings run, and clients that leave, on a test clock."""

import asyncio
import math
import os
import signal
from contextlib import asynccontextmanager, contextmanager, suppress
from datetime import timedelta

import numpy as np
import pytest
from grpclib import Status
from harness.fake_machine import FakeMachine, hanging
from harness.fake_parent import MOTION, config_of, until
from harness.in_process_module import (
    advance,
    client_of,
    guarded_arm,
    in_time,
    joints,
    refused,
)
from viam.components.arm import Arm
from viam.proto.common import Pose, PoseInFrame

from so101_motion.common.modes import Mode
from so101_motion.rig.rig import TICK
from so101_motion.viam.conversion.frames import set_machine
from so101_motion.viam.models.motion_service import So101Motion

HOME = [0.0, -45.0, 45.0, 60.0, 0.0]
FAR = [80.0, -45.0, 45.0, 60.0, 0.0]
ATTRIBUTES = {"speed_degs_per_sec": 20.0, "acceleration_degs_per_sec_per_sec": 500.0}

ABANDONED = 50
STOPS = 200


@pytest.fixture
async def motion(arm):
    service = So101Motion.new(config_of(MOTION, "devrel:so101:motion", {}, "planner"), {})
    async with client_of(service) as client:
        client.resource = service
        yield client


def point(x, y, z):
    pose = Pose(x=x, y=y, z=z, o_z=1.0)
    return PoseInFrame(reference_frame="arm_origin", pose=pose)


@contextmanager
def hung_planner(arm):
    """The planning process does nothing, as one that computes for long."""
    pids = arm.rig.planner.pids
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)


@asynccontextmanager
async def under_way(arm, client):
    """A move that is well under way; over when the block is."""
    call = asyncio.ensure_future(client.move_to_joint_positions(joints(*FAR)))
    while np.degrees(arm.rig.arm.state.q[0]) < 5.0:
        assert not call.done(), await call
        await advance(client, 0.05)
    yield call
    await client.stop()
    await asyncio.wait([call])
    call.cancelled() or call.exception()


async def at_rest(arm, client):
    """The arm rests, nothing is under way, and time changes nothing about it."""
    async with asyncio.timeout(30):
        while await client.is_moving():
            await advance(client, 0.01)
            await asyncio.sleep(0.001)
    here = arm.rig.arm.state.q_ref
    await advance(client, 1.0)
    assert not await client.is_moving()
    np.testing.assert_allclose(arm.rig.arm.state.q_ref, here, atol=1e-6)


@asynccontextmanager
async def registered(arm):
    """What is asked for in the block is the arm's newest motion when the block ends."""
    before = arm.rig.arm.newest_motion
    yield
    await until(lambda: arm.rig.arm.newest_motion is not before)


async def test_the_first_cycle_after_a_stop_is_slower_whatever_is_being_planned(arm, motion):
    executor, clock = arm.rig.executor, arm.rig.clock
    there = {"reference_frame": "arm_origin", "pose": {"x": 250, "y": 60, "z": 150, "o_z": 1}}
    request = {"component_name": "arm", "destination": there}
    await motion.do_command({"preview": request})  # the planning process runs
    slower = 0
    with hung_planner(arm):
        plans = [
            asyncio.ensure_future(motion.do_command({"preview": request})) for _ in range(ABANDONED)
        ]
        await asyncio.sleep(0.05)
        for plan in plans:
            plan.cancel()
        await asyncio.wait(plans)
        arm.rig.arm.set_speed(math.radians(5.0))  # at cruise after 0.07 s
        for k in range(STOPS):
            arm.rig.arm.retarget(np.radians([60.0 if k % 2 else -60.0, 0, 0, 0, 0]), guard=None)
            clock.advance(0.08 + 1e-4 * (k % 100))
            before = abs(executor.state.qd_ref[0])
            stop = asyncio.ensure_future(arm.stop())
            await asyncio.sleep(0)  # the request is there
            clock.advance(TICK)
            slower += bool(abs(executor.state.qd_ref[0]) < before)
            assert before > math.radians(4.9)
            clock.advance(0.2)
            await stop
    assert slower == STOPS


async def points():
    """A slow swing of the first joint from where the arm is when it is new."""
    for k in range(100):
        times = k + 0.05 * np.arange(20)  # far enough ahead, however busy the machine is
        yield [
            Arm.TrajectoryPoint(
                timedelta(seconds=t), [10.0 * (1.0 - math.cos(0.5 * t)), 0, 0, 0, 0]
            )
            for t in times
        ]


def stream(client):
    async def play():
        async for _ in client.move_through_joint_positions_streamed(points()):
            pass

    return asyncio.ensure_future(play())


async def test_a_client_that_leaves_while_its_stream_is_opened_leaves_nothing(arm, client):
    async with under_way(arm, client) as move:
        async with registered(arm):
            opening = stream(client)  # waits until the arm rests, which time must pass for
        opening.cancel()
        await asyncio.wait([opening])
        await refused(move, Status.ABORTED)
    await at_rest(arm, client)


async def test_manual_mode_that_was_asked_for_has_its_time_limit_although_nobody_waits(arm, client):
    async with under_way(arm, client):
        request = {"command": "enter_manual_mode", "enabled_for": 0.2}
        seen = set()  # the time limit is one of real time, and may pass between two looks
        end = arm.rig.executor.listen(lambda state: seen.add(state.mode))
        asking = asyncio.ensure_future(client.do_command(request))
        while arm.rig.arm.state.mode is Mode.MOVING:
            await advance(client, 0.01)
        asking.cancel()
        async with asyncio.timeout(60):
            while Mode.GUIDING not in seen:
                await advance(client, 0.01)
            while await client.get_manual_mode():
                await advance(client, 0.01)
        end()
        with suppress(asyncio.CancelledError):
            await asking


# Status codes: one truth for whatever moves the arm


SOURCES = {
    "a move": lambda client, motion: client.move_to_joint_positions(joints(*FAR)),
    "a pose": lambda client, motion: client.move_to_position(Pose(x=100, y=250, z=150, o_z=1)),
    "a retarget": lambda client, motion: client.move_through_joint_positions(
        [joints(*FAR)], extra={"interpolate": False}
    ),
    "a stream": lambda client, motion: stream(client),
    "the motion service": lambda client, motion: motion.move("arm", point(100, 250, 150)),
}


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("ending", ["stop", "newer", "jog"])
async def test_superseded_is_aborted_and_stopped_is_cancelled(arm, client, motion, source, ending):
    call = asyncio.ensure_future(SOURCES[source](client, motion))
    await until(lambda: arm.rig.arm.state.arm_moving or call.done())
    await advance(client, 0.3)
    assert not call.done()
    if ending == "newer":
        await in_time(client, client.move_to_joint_positions(joints(*HOME)))
    elif ending == "jog":
        jog = await in_time(client, asyncio.to_thread(arm.rig.arm.jog))
    if ending != "newer":
        await client.stop()
    await refused(call, Status.CANCELLED if ending == "stop" else Status.ABORTED)
    await at_rest(arm, client)
    if ending == "jog":
        assert jog.future.exception().by == "stop"


@pytest.mark.parametrize("source", SOURCES)
async def test_a_stop_ends_what_waits_for_the_arm_to_rest(arm, client, motion, source):
    async with under_way(arm, client):
        async with registered(arm):
            call = asyncio.ensure_future(SOURCES[source](client, motion))
        await client.stop()
        await refused(call, Status.CANCELLED)
    await at_rest(arm, client)


# The motion service


async def test_a_move_that_is_looked_at_first_ends_when_its_successor_comes_or_a_stop(
    arm, client, motion
):
    async with under_way(arm, client):
        with hung_planner(arm):
            calls = []
            for x in (100, 110, 120):
                calls.append(asyncio.ensure_future(motion.move("arm", point(x, 250, 150))))
                await asyncio.sleep(0.1)
            for call in calls[:-1]:
                await refused(call, Status.ABORTED)
            stopping = asyncio.ensure_future(client.stop())
            await refused(calls[-1], Status.CANCELLED)
        await in_time(client, stopping)


@pytest.mark.parametrize(
    ("destination", "extra"),
    [
        (point(250, 60, 150), {"goal_metric_type": "best"}),
        (point(900, 0, 100), {}),
        (PoseInFrame(reference_frame="moon", pose=Pose(x=250, o_z=1)), {}),
    ],
)
async def test_a_move_that_is_refused_leaves_the_motion_under_way_alone(
    arm, client, motion, destination, extra
):
    async with under_way(arm, client) as move:
        await refused(motion.move("arm", destination, extra=extra))
        assert not move.done()
        await in_time(client, move)
    assert np.degrees(arm.rig.arm.state.q) == pytest.approx(FAR, abs=0.1)


async def test_a_motion_service_that_is_removed_ends_what_it_moves(arm, client, motion):
    call = asyncio.ensure_future(motion.move("arm", point(100, 250, 150)))
    await until(lambda: arm.rig.arm.state.arm_moving)
    await advance(client, 0.3)
    await motion.resource.close()
    await refused(call, Status.CANCELLED, "the removal of its motion service")
    await at_rest(arm, client)


# Requests that have not begun their motion yet


MOVES = {
    "to joint positions": lambda arm: arm.move_to_joint_positions(joints(*FAR)),
    "to a position": lambda arm: arm.move_to_position(Pose(x=200, y=100, z=150, o_z=1)),
    "through joint positions": lambda arm: arm.move_through_joint_positions([joints(*FAR)]),
    "out of contact": lambda arm: arm.do_command({"command": "leave_contact"}),
}


@pytest.fixture
async def prepared():
    """An arm whose machine is asked for its frame system and does not answer yet, and that."""
    machine = FakeMachine(hanging("arm", joints=5))
    machine.silent = True
    async with guarded_arm(simulate_time=False) as arm:
        set_machine(lambda: machine)
        yield arm, machine
        set_machine(lambda: None)


@pytest.mark.parametrize("move", MOVES.values(), ids=MOVES)
async def test_a_stop_while_a_move_is_prepared_ends_it(prepared, move, monkeypatch):
    arm, machine = prepared
    if move is MOVES["through joint positions"]:  # it waits for other arms alone
        asked = machine.get_frame_system_config
        monkeypatch.setattr(arm.resource.surroundings, "update_other_arms", asked)
    before = arm.resource.rig.arm.state.q_ref
    moving = asyncio.ensure_future(move(arm))
    await until(lambda: machine.asked > 0)
    await arm.stop()
    if move is MOVES["through joint positions"]:
        machine.answer.set()
    await refused(moving, Status.CANCELLED, "ended early by stop")
    assert not arm.resource.rig.arm.state.arm_moving
    np.testing.assert_array_equal(arm.resource.rig.arm.state.q_ref, before)
