"""``devrel:so101:world-state``: shows an arm's scene and newest plan in Viam's 3D view.

Nothing is stored: a few times a second, a stream compares the arm's scene and plan with what it
sent before.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from google.protobuf.field_mask_pb2 import FieldMask
from google.protobuf.struct_pb2 import Struct
from grpclib import GRPCError, Status
from viam.proto.common import Geometry, PoseInFrame, Transform
from viam.proto.service.worldstatestore import StreamTransformChangesResponse, TransformChangeType
from viam.resource.types import Model
from viam.services.worldstatestore import WorldStateStore

from so101_motion.arm.arm import Arm
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import FLOOR, Box, Scene, Shape, ShapeFile, Sphere
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.convert import grpc_statuses
from so101_motion.viam.conversion.geometries import shown_id, to_geometry
from so101_motion.viam.models.for_an_arm import ServiceForAnArm, arm_here
from so101_motion.viam.requests.await_motion import TurnQueue, in_own_thread

_PERIOD = 0.25  # period of a stream [s]; chosen: fast enough for the eye, and nearly free
_POINTS = 32  # most points of the tool's path that are shown; chosen, 10 mm apart on a usual move

_FLOOR_SIZE = 1.2
_FLOOR_THICKNESS = 0.01
"""The slab that shows the floor [m]; chosen: as far as the arm reaches, and thin."""

_FLOOR, _OBSTACLE, _ZONE, _HELD, _PATH, _GOAL = (
    {"color": {"r": r, "g": g, "b": b}, "opacity": opacity}
    for r, g, b, opacity in (
        (200, 200, 200, 0.3), (150, 150, 150, 0.8), (220, 60, 60, 0.25),
        (240, 165, 0, 0.8), (60, 120, 220, 0.9), (60, 200, 90, 0.9),
    )
)  # fmt: skip

Shown = dict[bytes, Transform]  # the shown transforms, by UUID


class So101WorldState(ServiceForAnArm, WorldStateStore):
    """Shows the scene and the newest plan of one arm of this module."""

    MODEL: ClassVar = Model.from_string("devrel:so101:world-state")

    def __init__(self, name: str, arm: str | None) -> None:
        super().__init__(name, arm)
        self._turns = TurnQueue()
        self._looking: asyncio.Future[Shown] | None = None
        self._looked = 0.0

    async def list_uuids(self, **kwargs: Any) -> list[bytes]:
        """The floor is always among them: viam-server takes an empty list for a failure."""
        with grpc_statuses():
            return list(await asyncio.to_thread(self._now))

    async def get_transform(self, uuid: bytes, **kwargs: Any) -> Transform:
        with grpc_statuses():
            found = (await asyncio.to_thread(self._now)).get(uuid)
        if found is None:
            raise GRPCError(
                Status.NOT_FOUND, "no transform of this UUID is shown now; list the UUIDs again"
            )
        return found

    # The SDK declares its async generator as a coroutine that returns one.
    async def stream_transform_changes(  # type: ignore[override]
        self, **kwargs: Any
    ) -> AsyncGenerator[StreamTransformChangesResponse, None]:
        """Send all shown transforms, then the changes, until the client goes away.

        The first message is empty, because viam-server waits for one and drops it. While there is
        no such arm, as during a rebuild, nothing is shown.
        """
        yield StreamTransformChangesResponse()
        shown: Shown = {}
        while True:
            now = await self._seen()
            if now is not shown:
                await self._turns.passed()  # of many streams one sends in each turn of the loop
                for change in _changes(shown, now):
                    yield change
                shown = now
            await asyncio.sleep(_PERIOD)

    async def _seen(self) -> Shown:
        """What is shown now; all streams share one look in each period."""

        def look() -> Shown:
            with suppress(ConfigError):
                return self._now()
            return {}

        now = asyncio.get_running_loop().time()
        if self._looking is None or (self._looking.done() and now >= self._looked + _PERIOD / 2.0):
            self._looked = now
            self._looking = in_own_thread(look)
        return await asyncio.shield(self._looking)

    async def do_command(self, command: Mapping[str, Any], **kwargs: Any) -> Mapping[str, Any]:
        raise GRPCError(
            Status.UNIMPLEMENTED,
            "this store has no commands; use ListUUIDs, GetTransform and StreamTransformChanges,"
            " or plan and preview of devrel:so101:motion",
        )

    def _now(self) -> Shown:
        resource = arm_here(self._arm_name)
        return {t.uuid: t for t in shown_of(resource.short_name, resource.rig.arm)}


def shown_of(name: str, arm: Arm) -> Iterator[Transform]:
    """The transforms that show an arm's scene and newest plan."""
    scene, plan = (arm.scene, None) if arm.newest is None else (arm.newest[0].scene, arm.newest[1])
    yield from _things(name, scene)
    if plan is None or len(plan.trajectory) < 2:
        return
    points = plan.tool_path
    chosen = np.unique(np.linspace(0, len(points) - 1, _POINTS).astype(int))
    for k, i in enumerate(chosen):
        at = SE3.from_translation(points[i])
        is_last = k == len(chosen) - 1
        shape = Sphere(radius=0.008 if is_last else 0.002)
        label = f"{name} goal" if is_last else f"{name} path {k}"
        yield _transform(label, f"{name}_origin", shape, at, _GOAL if is_last else _PATH)


@lru_cache(maxsize=8)
def _things(name: str, scene: Scene) -> tuple[Transform, ...]:
    """The obstacles and held objects of a scene; cached, because they may be many."""
    return tuple(_each_thing(name, scene))


def _each_thing(name: str, scene: Scene) -> Iterator[Transform]:
    if scene.floor_z is not None:
        slab = Box(size=np.array((_FLOOR_SIZE, _FLOOR_SIZE, _FLOOR_THICKNESS)))
        at = SE3.from_translation((0.0, 0.0, scene.floor_z - _FLOOR_THICKNESS / 2.0))
        yield _transform(f"{name} {FLOOR}", f"{name}_origin", slab, at, _FLOOR)
    for thing in scene.obstacles:
        look = _ZONE if thing.keep_out else _OBSTACLE
        yield _transform(thing.name, f"{name}_origin", thing.shape, thing.T_base_obstacle, look)
    for held in scene.attached:
        yield _transform(held.name, name, held.shape, held.T_tool_object, _HELD)


def _transform(
    label: str, frame: str, shape: Shape | ShapeFile, pose: SE3, look: Mapping[str, Any]
) -> Transform:
    metadata = Struct()
    metadata.update(look)
    geometry: Geometry = to_geometry(shape, label)
    return Transform(
        reference_frame=label,
        pose_in_observer_frame=PoseInFrame(reference_frame=frame, pose=convert.to_pose(pose)),
        physical_object=geometry,
        uuid=shown_id(frame, label),
        metadata=metadata,
    )


def _changes(before: Shown, now: Shown) -> Iterator[StreamTransformChangesResponse]:
    kind = TransformChangeType
    for key in before.keys() - now.keys():
        yield StreamTransformChangesResponse(
            change_type=kind.TRANSFORM_CHANGE_TYPE_REMOVED, transform=Transform(uuid=key)
        )
    for key, transform in now.items():
        if key not in before:
            yield StreamTransformChangesResponse(
                change_type=kind.TRANSFORM_CHANGE_TYPE_ADDED, transform=transform
            )
        elif before[key] is not transform and before[key] != transform:
            fields = [
                field.name
                for field in Transform.DESCRIPTOR.fields
                if getattr(before[key], field.name) != getattr(transform, field.name)
            ]
            yield StreamTransformChangesResponse(
                change_type=kind.TRANSFORM_CHANGE_TYPE_UPDATED,
                transform=transform,
                updated_fields=FieldMask(paths=fields),
            )
