"""Simulated components behind a gRPC channel in this process, on a clock that the test moves."""

import asyncio
from contextlib import asynccontextmanager

import pytest
from grpclib import GRPCError
from grpclib.testing import ChannelFor
from viam.components.arm import ArmClient, JointPositions
from viam.components.arm.service import ArmRPCService
from viam.resource.manager import ResourceManager
from viam.resource.registry import Registry
from viam.rpc.server import _patch_mappings

from harness.fake_parent import ARM, GRIPPER, SIMULATED, SIMULATED_GRIPPER, config_of, until
from so101_motion.viam.models.simulated import SimulatedArm
from so101_motion.viam.models.simulated_gripper import SimulatedGripper
from so101_motion.viam.requests.request_guard import guard


def new_arm(dependencies=None, name="arm", **attributes):
    return SimulatedArm.new(config_of(ARM, SIMULATED, attributes, name), dependencies or {})


def new_gripper(name="gripper", **attributes):
    return SimulatedGripper.new(config_of(GRIPPER, SIMULATED_GRIPPER, attributes, name), {})


@asynccontextmanager
async def client_of(resource):
    """A client of any component or service, over gRPC."""
    api = Registry.lookup_api(resource.API)
    async with ChannelFor([api.rpc_service(ResourceManager([resource]))]) as channel:
        yield api.create_rpc_client(resource.name, channel)


arm_client = gripper_client = client_of


class _GuardedServer:
    """The part of the SDK's server that the guard looks at."""

    def __init__(self, server):
        self._server = server


class _GuardedChannel(ChannelFor):
    async def __aenter__(self):
        channel = await super().__aenter__()
        guard(_GuardedServer(self._server))
        return channel


@asynccontextmanager
async def guarded_arm(**attributes):
    """A simulated arm, as of ``new_arm``, behind a channel that checks requests as the module's
    server does."""
    arm = new_arm(**attributes)
    try:
        services = _patch_mappings([ArmRPCService(ResourceManager([arm]))])
        async with _GuardedChannel(services) as channel:
            client = ArmClient(arm.name, channel)
            client.resource = arm
            yield client
    finally:
        await arm.close()


def joints(*degrees):
    return JointPositions(values=list(map(float, degrees)))


async def do(resource, command, **arguments):
    """What a component or service answers to a command."""
    return await resource.do_command({"command": command, **arguments})


async def positions(client):
    """Where the joints of an arm are [deg]."""
    return list((await client.get_joint_positions()).values)


async def advance(client, seconds):
    """Let simulated time pass."""
    answer = await client.do_command({"command": "advance_time", "seconds": seconds})
    return answer["time"]


async def in_time(client, call, step=0.1):
    """The outcome of ``call`` while simulated time passes."""
    task = asyncio.ensure_future(call)
    while not task.done():
        await advance(client, step)
    return await task


async def refused(call, status=None, *says):
    """The error that a call is refused with; it must have this status, and these words."""
    with pytest.raises(GRPCError) as caught:
        await call
    assert status is None or caught.value.status is status
    for words in says:
        assert words in caught.value.message, caught.value.message
    return caught.value


async def duration_of(client, call):
    """How much simulated time a move takes [s], its planning not counted."""
    task = asyncio.ensure_future(call)

    async def has_begun():
        return task.done() or (await client.get_status())["state"] == "moving"

    await until(has_begun)
    begin = await advance(client, 0.0)
    await in_time(client, task, 0.01)
    return await advance(client, 0.0) - begin
