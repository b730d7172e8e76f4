"""Stop comes through at once, whatever else a client keeps open on its one connection."""

import asyncio
import time
from datetime import timedelta

import pytest
import pytest_asyncio
from harness.fake_parent import (
    ARM,
    GRIPPER,
    MOTION,
    SIMULATED,
    SIMULATED_GRIPPER,
    running_module,
    until,
)
from viam.components.arm import Arm, JointPositions, Pose
from viam.gen.service.worldstatestore.v1.world_state_store_grpc import WorldStateStoreServiceStub
from viam.proto.common import PoseInFrame
from viam.proto.service.worldstatestore import StreamTransformChangesRequest

pytestmark = pytest.mark.asyncio(loop_scope="module")

CALLS = 400
ENDED = 80
"""Of kinds whose newest call ends the one before: no more than what is on its way is ever open."""

AT_ONCE = 1.0
"""[s], on a busy machine; a move of 100 deg at 10 deg/s takes ten seconds."""

STORE = "rdk:service:world_state_store"


def joints(first):
    return JointPositions(values=[first, 0.0, 0.0, 0.0, 0.0])


async def dribble():
    """A point now and then, for ever."""
    t = 0.0
    while True:
        point = Arm.TrajectoryPoint(time=timedelta(seconds=t), positions=[0.0] * 5)
        yield [point]
        t += 1.0
        await asyncio.sleep(5.0)


async def flood(sent):
    """Many more points than fit into what is buffered for a call; 5.5 kB each time."""
    while True:
        begin = 100 * len(sent)
        yield [
            Arm.TrajectoryPoint(time=timedelta(seconds=0.02 * k), positions=[0.0] * 5)
            for k in range(begin, begin + 100)
        ]
        sent.append(begin)


async def consume(stream):
    async for _ in stream:
        pass


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def machine():
    async with running_module() as (module, _, _):
        module.arm = await module.add(ARM, SIMULATED, {"speed_degs_per_sec": 10.0}, "arm")
        module.gripper = await module.add(GRIPPER, SIMULATED_GRIPPER, {"arm": "arm"}, "gripper")
        module.motion = await module.add(MOTION, "devrel:so101:motion", {"arm": "arm"}, "planner")
        await module.add(STORE, "devrel:so101:world-state", {"arm": "arm"}, "shown")
        yield module


async def watch(machine):
    stub = WorldStateStoreServiceStub(machine.channel)
    async with stub.StreamTransformChanges.open() as stream:
        await stream.send_message(StreamTransformChangesRequest(name="shown"), end=True)
        await consume(stream)


POSE = Pose(x=200.0, z=200.0, o_z=-1.0)

PAUSE = {
    "command": "run_program",
    "schema": "so101/program/1",
    "waypoints": [{"name": "here", "q_deg": [-100, 0, 0, 0, 0], "pause_s": 20}],
}

KINDS = {
    "watching": (CALLS, watch),
    "readings": (CALLS, lambda m: m.arm.get_geometries()),
    "manual mode": (CALLS, lambda m: m.arm.set_manual_mode(True, 60)),
    "joint moves": (ENDED, lambda m: m.arm.move_to_joint_positions(joints(100.0))),
    "poses": (ENDED, lambda m: m.arm.move_to_position(POSE)),
    "waypoints": (
        ENDED,
        lambda m: m.arm.move_through_joint_positions([joints(50.0), joints(100.0)]),
    ),
    "streams": (ENDED, lambda m: consume(m.arm.move_through_joint_positions_streamed(dribble()))),
    "services": (
        ENDED,
        lambda m: m.motion.move("arm", PoseInFrame(reference_frame="arm_origin", pose=POSE)),
    ),
    "waiting commands": (ENDED, lambda m: m.arm.do_command(PAUSE)),
    "jaw": (ENDED, lambda m: m.gripper.do_command({"command": "set_position", "percentage": 50.0})),
}


async def test_a_stop_passes_hundreds_of_open_calls(machine):
    for kind, (count, call) in KINDS.items():
        calls = [asyncio.ensure_future(call(machine)) for _ in range(count)]
        move = asyncio.ensure_future(machine.arm.move_to_joint_positions(joints(100.0)))

        async def has_begun(move=move):
            return move.done() or await machine.arm.is_moving()

        await until(has_begun)
        begin = time.monotonic()
        await machine.arm.stop()
        took = time.monotonic() - begin
        assert not move.done() or move.exception() is not None, "it has not arrived"
        for each in (*calls, move):
            each.cancel()
        await asyncio.gather(move, *calls, return_exceptions=True)
        assert took < AT_ONCE, kind
        assert not await machine.arm.get_manual_mode(), "it was asked for before the stop"


async def test_points_that_are_not_read_yet_leave_the_connection_to_others(machine):
    sent = []
    stream = machine.arm.move_through_joint_positions_streamed(flood(sent))
    flooding = asyncio.ensure_future(consume(stream))
    for _ in range(300):
        await machine.arm.get_joint_positions()
    assert len(sent) < 150, "0.8 MB of the 4 that a connection usually has"
    await machine.arm.stop()
    flooding.cancel()
    await asyncio.gather(flooding, return_exceptions=True)
