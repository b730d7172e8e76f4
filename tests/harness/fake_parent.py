"""A stand-in for viam-server: it starts the module's real process and talks to it as a parent does.

Two sockets, as in life: the parent listens on one (the module asks it for resource names, sends its
log lines there, and reaches other resources through it), the module on the other.
"""

import asyncio
import os
import shutil
import signal
import socket as socket_module
import sys
import tempfile
import time
from contextlib import asynccontextmanager
from pathlib import Path

import viam.components.arm
import viam.components.gripper
import viam.components.sensor
import viam.services.motion
import viam.services.worldstatestore  # noqa: F401  # importing registers the clients
from google.protobuf.struct_pb2 import Struct
from grpclib import GRPCError, Status
from grpclib.client import Channel
from grpclib.server import Server
from viam.proto.app.robot import ComponentConfig
from viam.proto.common import Pose, PoseInFrame
from viam.proto.module import (
    AddResourceRequest,
    ModuleServiceStub,
    ReadyRequest,
    RemoveResourceRequest,
    ValidateConfigRequest,
)
from viam.proto.robot import (
    FrameSystemConfigResponse,
    GetMachineStatusResponse,
    GetPoseResponse,
    LogResponse,
    ResourceNamesResponse,
    TransformPoseResponse,
    UnimplementedRobotServiceBase,
)
from viam.resource.registry import Registry
from viam.resource.types import API
from viam.services.motion import Motion

from harness.clocks import PACED

ROOT = Path(__file__).parents[2]
MODULE = f"{PACED}from runpy import run_module; run_module('so101_motion', run_name='__main__')"

ARM = "rdk:component:arm"
GRIPPER = "rdk:component:gripper"
SENSOR = "rdk:component:sensor"
CALIBRATION = "devrel:so101:calibration"
DISCOVERY = "devrel:so101:discovery"
HARDWARE_ARM = "devrel:so101:arm"
HARDWARE_GRIPPER = "devrel:so101:gripper"
MOTION = "rdk:service:motion"
SIMULATED = "devrel:so101:simulated"
SIMULATED_GRIPPER = "devrel:so101:simulated-gripper"


class ParentService(UnimplementedRobotServiceBase):
    """What the module needs of viam-server.

    Attributes:
        resources: What it names.
        machine: Its frame system, a ``FakeMachine``; None for one arm above the world's origin
            that is in no frame system.
        lines: What the module has logged.
    """

    def __init__(self, resources):
        self.resources = resources
        self.machine = None
        self.lines = []

    async def ResourceNames(self, stream):
        await stream.recv_message()
        await stream.send_message(ResourceNamesResponse(resources=self.resources))

    async def TransformPose(self, stream):
        """The arm stands 100 mm above the world's origin; no other frame is known."""
        request = await stream.recv_message()
        if self.machine is not None:
            pose = await self.machine.transform_pose(request.source, request.destination)
            await stream.send_message(TransformPoseResponse(pose=pose))
            return
        if (request.source.reference_frame, request.destination) != ("world", "arm_origin"):
            raise GRPCError(Status.NOT_FOUND, "no such frame")
        pose = PoseInFrame(reference_frame="arm_origin", pose=Pose(z=-100.0, o_z=1.0))
        await stream.send_message(TransformPoseResponse(pose=pose))

    async def GetPose(self, stream):
        """Of the one arm, seen from the world; for everything else as viam-server says it."""
        request = await stream.recv_message()
        if (request.component_name, request.destination_frame) != ("arm", "world"):
            said = f'frame with name "{request.component_name}" not in frame system'
            raise GRPCError(Status.UNKNOWN, said)
        pose = PoseInFrame(reference_frame="world", pose=Pose(x=391.4, z=326.5, o_x=1.0))
        await stream.send_message(GetPoseResponse(pose=pose))

    async def FrameSystemConfig(self, stream):
        await stream.recv_message()
        configs = [] if self.machine is None else await self.machine.get_frame_system_config()
        await stream.send_message(FrameSystemConfigResponse(frame_system_configs=configs))

    async def GetMachineStatus(self, stream):
        await stream.recv_message()
        no_status = GetMachineStatusResponse()
        asked = None if self.machine is None else self.machine.get_machine_status()
        await stream.send_message(no_status if asked is None else await asked)

    async def Log(self, stream):
        request = await stream.recv_message()
        self.lines += [(entry.level, entry.message) for entry in request.logs]
        await stream.send_message(LogResponse())


class FakeMotion(Motion):
    """A motion service of the machine that remembers what it was asked."""

    def __init__(self, answer=True):
        super().__init__("mine")
        self.answer, self.calls = answer, []

    async def move(self, component_name, destination, world_state=None, constraints=None, **kwargs):
        self.calls.append((component_name, destination, kwargs["extra"]))
        return self.answer

    move_on_globe = move_on_map = get_pose = None
    stop_plan = get_plan = list_plan_statuses = None


class RunningModule:
    """The module's process, its sockets, and what a parent asks it."""

    def __init__(self, process, channel, parent, socket):
        self.process, self.channel, self.parent, self.socket = process, channel, parent, socket
        self.service = ModuleServiceStub(channel)

    async def ready(self, parent_address):
        answer = await self.service.Ready(ReadyRequest(parent_address=parent_address))
        return {
            f"{handler.subtype.subtype.subtype}": sorted(handler.models)
            for handler in answer.handlermap.handlers
        }

    async def validate(self, api, model, attributes=None, name="it"):
        config = config_of(api, model, attributes, name)
        return await self.service.ValidateConfig(ValidateConfigRequest(config=config))

    async def add(self, api, model, attributes=None, name="it", dependencies=()):
        config = config_of(api, model, attributes, name)
        await self.service.AddResource(
            AddResourceRequest(config=config, dependencies=list(dependencies))
        )
        create = Registry.lookup_api(API.from_string(api)).create_rpc_client
        return create(name, self.channel)

    async def remove(self, api, name="it"):
        await self.service.RemoveResource(RemoveResourceRequest(name=f"{api}/{name}"))

    async def ended(self):
        """The process's exit code, once it has ended."""
        return await asyncio.wait_for(self.process.wait(), 60.0)


def is_listening(path):
    """Whether somebody takes connections; the file alone is there a little earlier."""
    with socket_module.socket(socket_module.AF_UNIX) as probe:
        return probe.connect_ex(str(path)) == 0


async def until(check, seconds=60.0):
    """Wait until ``check()``, plain or awaited, is true; not for ever."""
    async with asyncio.timeout(seconds):
        while True:
            answer = check()
            if await answer if asyncio.iscoroutine(answer) else answer:
                return
            await asyncio.sleep(0.005)


def config_of(api, model, attributes=None, name="it"):
    struct = Struct()
    struct.update(attributes or {})
    return ComponentConfig(name=name, api=api, model=model, attributes=struct)


@asynccontextmanager
async def running_module(
    *,
    command=(sys.executable, "-c", MODULE),
    arguments=(),
    services=(),
    resources=(),
    cwd=ROOT,
    patience=60.0,
):
    """Start the module and be its parent until the block ends.

    Yields the module, its models by API subtype, and how long it took to be ready, at most
    ``patience`` [s].
    """
    folder = Path(tempfile.mkdtemp(prefix="so101-"))  # short: a socket's path has 107 bytes
    parent_service = ParentService(list(resources))
    parent = Server([parent_service, *services])
    await parent.start(path=str(folder / "parent.sock"))
    socket = folder / "m.sock"
    begin = time.monotonic()
    process = await asyncio.create_subprocess_exec(
        *command,
        str(socket),
        *arguments,
        cwd=cwd,
        env={**os.environ, "VIAM_MODULE_NAME": "so101-motion", "VIAM_MODULE_ROOT": str(ROOT)},
        stdout=asyncio.subprocess.DEVNULL,
    )
    channel = None
    try:
        await until(lambda: is_listening(socket) or process.returncode is not None, patience)
        if process.returncode is not None:
            raise RuntimeError(f"the module ended at once, code {process.returncode}")
        channel = Channel(path=str(socket))
        module = RunningModule(process, channel, parent_service, socket)
        models = await module.ready(str(folder / "parent.sock"))
        yield module, models, time.monotonic() - begin
    finally:
        if channel is not None:
            channel.close()
        if process.returncode is None:
            process.send_signal(signal.SIGTERM)
            await asyncio.wait_for(process.wait(), 60.0)
        parent.close()
        await parent.wait_closed()
        shutil.rmtree(folder, ignore_errors=True)
