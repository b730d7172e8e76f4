"""A machine around an arm: a frame system, and components with geometries."""

import asyncio

import numpy as np
from grpclib import GRPCError, Status
from viam.components.generic import Generic
from viam.proto.common import (
    Geometry,
    Pose,
    PoseInFrame,
    RectangularPrism,
    ResourceName,
    Transform,
    Vector3,
)
from viam.proto.robot import FrameSystemConfig, GetMachineStatusResponse, ResourceStatus
from viam.proto.service.worldstatestore import StreamTransformChangesResponse, TransformChangeType
from viam.services.worldstatestore import WorldStateStore

from so101_motion.common.geometry import SE3
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.viam.conversion import convert


def a_box(x, y, z, label="", /, **center):
    """A box of these edges [mm]; ``center`` as in a pose."""
    dims = Vector3(x=x, y=y, z=z)
    center = Pose(**({"o_z": 1} | center))
    return Geometry(box=RectangularPrism(dims_mm=dims), label=label, center=center)


def hanging(name, parent="world", *, geometry=None, joints=0, **pose):
    """A component of a frame system; ``pose`` [mm] in its parent."""
    seen = PoseInFrame(reference_frame=parent, pose=Pose(**({"o_z": 1} | pose)))
    frame = Transform(reference_frame=name, pose_in_observer_frame=seen, physical_object=geometry)
    config = FrameSystemConfig(frame=frame)
    for i in range(joints):
        config.model.joints.add(id=str(i))
    return config


def status(kind, name, state, error=""):
    """Whether a component runs, as viam-server says it; ``state`` such as ``"READY"``."""
    named = ResourceName(namespace="rdk", type="component", subtype=kind, name=name)
    return ResourceStatus(name=named, state=f"STATE_{state}", error=error)


class StandingArm:
    """An arm of this process at joint angles [rad]."""

    model = RobotModel.load()

    def __init__(self, q=(0.0, 0.0, 0.0, 0.0, 0.0)):
        self.q, self.trouble = np.array(q), None

    async def found(self):
        if self.trouble is not None:
            raise self.trouble

    def T_end(self):
        return self.model.frame(self.q, "tool")

    def T_links(self):
        return self.model.link_placements(self.q, 0.0)


class Thing(Generic):
    """A component that does nothing but have geometries; ``None``: it has not heard of them."""

    def __init__(self, name, geometries=None):
        super().__init__(name)
        self.geometries, self.asked = geometries, 0

    async def do_command(self, command, **kwargs):
        return {}

    async def get_geometries(self, **kwargs):
        self.asked += 1
        if isinstance(self.geometries, Exception):
            raise self.geometries
        if self.geometries is None:
            raise GRPCError(Status.UNIMPLEMENTED, "no geometries")
        return self.geometries


KINDS = {
    "added": TransformChangeType.TRANSFORM_CHANGE_TYPE_ADDED,
    "updated": TransformChangeType.TRANSFORM_CHANGE_TYPE_UPDATED,
    "removed": TransformChangeType.TRANSFORM_CHANGE_TYPE_REMOVED,
}


class FakeStore(WorldStateStore):
    """A store whose streams a test writes to, behind viam-server.

    That opens its own stream, waits for the first message and drops it, and sends an empty one.
    ``trouble`` is raised when its list is read.
    """

    def __init__(self, *things):
        super().__init__("seen")
        self.things = {each.uuid: each for each in things}
        self.streams, self.trouble, self.asked = [], None, 0

    async def list_uuids(self, **kwargs):
        self.asked += 1
        if self.trouble is not None:
            raise self.trouble
        if not self.things:
            raise GRPCError(Status.UNKNOWN, "nil response")  # viam-server's, for none
        return list(self.things)

    async def get_transform(self, uuid, **kwargs):
        self.asked += 1
        if uuid not in self.things:
            raise GRPCError(Status.NOT_FOUND, "gone")
        return self.things[uuid]

    async def stream_transform_changes(self, **kwargs):
        queue = asyncio.Queue()
        self.streams.append(queue)
        if await queue.get() is not None:
            yield StreamTransformChangesResponse()
            while (change := await queue.get()) is not None:
                yield change

    async def do_command(self, command, **kwargs):
        return {}

    def say(self, kind, thing):
        for queue in self.streams:
            queue.put_nowait(
                StreamTransformChangesResponse(change_type=KINDS[kind], transform=thing)
            )

    def has(self, thing):
        kind = "updated" if thing.uuid in self.things else "added"
        self.things[thing.uuid] = thing
        self.say(kind, thing)

    def forget(self, name):
        del self.things[name.encode()]
        self.say("removed", Transform(uuid=name.encode()))


def seen_thing(name, x=300.0, z=0.0, parent="world", uuid=b""):
    """A small box in a store [mm]."""
    pose = PoseInFrame(reference_frame=parent, pose=Pose(x=x, z=z, o_z=1))
    return Transform(
        reference_frame=name,
        pose_in_observer_frame=pose,
        physical_object=a_box(10, 10, 10),
        uuid=uuid or name.encode(),
    )


class FakeMachine:
    """What the module's connection to its parent can be asked.

    Attributes:
        configs: The frame system; an exception is raised.
        ends: Where the ends of components with joints are in their origins.
        silent: Whether it does not answer before ``answer`` is set.
        asked: How often it was asked for the frame system.
    """

    def __init__(self, *configs, things=()):
        self.configs = list(configs)
        self.things = {each.name: each for each in things}
        self.ends, self.statuses = {}, []
        self.silent, self.asked, self.answer = False, 0, asyncio.Event()

    @property
    def resource_names(self):
        return [
            ResourceName(namespace="rdk", type="component", subtype="generic", name=name)
            for name in self.things
        ]

    async def refresh(self):
        pass

    def get_component(self, name):
        return self.things[name.name]

    async def get_frame_system_config(self):
        self.asked += 1
        if self.silent:
            await self.answer.wait()
        if isinstance(self.configs, Exception):
            raise self.configs
        # What comes over a wire is never the same object, and viam-server lists in any order.
        first = self.asked % max(len(self.configs), 1)
        listed = [*self.configs[first:], *self.configs[:first]]
        return [FrameSystemConfig.FromString(each.SerializeToString()) for each in listed]

    async def get_machine_status(self):
        return GetMachineStatusResponse(resources=self.statuses)

    async def transform_pose(self, query, destination):
        T = self._world(destination).inverse @ self._world(query.reference_frame)
        T = T @ convert.from_pose(query.pose)
        return PoseInFrame(reference_frame=destination, pose=convert.to_pose(T))

    def _world(self, frame):
        T = SE3.identity()
        while frame != "world":
            frames = {each.frame.reference_frame: each for each in self.configs}
            if frame in frames:
                if len(frames[frame].model.joints) and frame not in self.ends:
                    raise GRPCError(Status.UNKNOWN, f"{frame} does not tell its joints")
                T = self.ends.get(frame, SE3.identity()) @ T
            name = frame if frame in frames else frame.removesuffix("_origin")
            if name not in frames:
                raise GRPCError(Status.NOT_FOUND, f"frame {frame} not found")
            seen = frames[name].frame.pose_in_observer_frame
            T = convert.from_pose(seen.pose) @ T
            frame = seen.reference_frame
        return T
