"""``devrel:so101:world-state``: what an arm plans with, for Viam's 3D view.

Obstacles and keep-out zones, what the gripper holds, the goal of the newest plan and the way of the
tool to it, as transforms beside the arm. Nothing is stored here: each look compares what the arm
knows now with what was shown before. Streams look a few times a second; an arm whose plans come
faster than that is shown with the newest.
"""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import AsyncGenerator, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from google.protobuf.field_mask_pb2 import FieldMask
from google.protobuf.struct_pb2 import Struct
from grpclib import GRPCError, Status
from viam.proto.app.robot import ComponentConfig
from viam.proto.common import (
    Geometry,
    PoseInFrame,
    ResourceName,
    Transform,
)
from viam.proto.service.worldstatestore import StreamTransformChangesResponse, TransformChangeType
from viam.resource.base import ResourceBase
from viam.resource.types import Model
from viam.services.worldstatestore import WorldStateStore

from so101_motion.arm import Arm
from so101_motion.geometry import SE3
from so101_motion.models import convert
from so101_motion.models.convert import grpc_statuses
from so101_motion.models.for_an_arm import arm_here, arm_named
from so101_motion.models.geometries import to_geometry
from so101_motion.planning.scene import Scene, Shape, Sphere

_PERIOD = 0.25
"""How often a stream looks [s]; chosen: soon enough for the eye, near no load."""

_POINTS = 32
"""How many points of the tool's way are shown; chosen, 10 mm apart on a usual move."""

_NAMESPACE = uuid.UUID("8f3b1b5e-6a0c-4d8e-9d38-5a0f1f1c9a51")

_OBSTACLE, _ZONE, _HELD, _WAY, _GOAL = (
    {"color": {"r": r, "g": g, "b": b}, "opacity": opacity}
    for r, g, b, opacity in (
        (150, 150, 150, 0.8),
        (220, 60, 60, 0.25),
        (240, 165, 0, 0.8),
        (60, 120, 220, 0.9),
        (60, 200, 90, 0.9),
    )
)

Shown = dict[bytes, Transform]
"""What is shown, by UUID."""


class So101WorldState(WorldStateStore):
    """Shows what one arm of this module plans with.

    Args:
        name: The service's name.
        arm: Name of the arm; None for the only one.
    """

    MODEL: ClassVar = Model.from_string("devrel:so101:world-state")

    def __init__(self, name: str, arm: str | None) -> None:
        super().__init__(name)
        self._arm_name = arm

    @classmethod
    def validate_config(cls, config: ComponentConfig) -> tuple[Sequence[str], Sequence[str]]:
        """Check the attributes.

        Raises:
            ConfigError: As it is, for the SDK makes an INVALID_ARGUMENT of its text.
        """
        arm_named(config)
        return [], []

    @classmethod
    def new(
        cls, config: ComponentConfig, dependencies: Mapping[ResourceName, ResourceBase]
    ) -> So101WorldState:
        """Build the service from its configuration."""
        with grpc_statuses():
            return cls(config.name, arm_named(config))

    async def list_uuids(self, **kwargs: Any) -> list[bytes]:
        """Everything that is shown now."""
        return list(self._now())

    async def get_transform(self, uuid: bytes, **kwargs: Any) -> Transform:
        """One of the things that are shown."""
        found = self._now().get(uuid)
        if found is None:
            raise GRPCError(Status.NOT_FOUND, "nothing of that UUID is shown any more")
        return found

    # The SDK declares its async generator as a coroutine that returns one.
    async def stream_transform_changes(  # type: ignore[override]
        self, **kwargs: Any
    ) -> AsyncGenerator[StreamTransformChangesResponse, None]:
        """Everything that is shown, then what changes, until the client goes away."""
        shown: Shown = {}
        while True:
            now = self._now()
            for change in _changes(shown, now):
                yield change
            shown = now
            await asyncio.sleep(_PERIOD)

    def _now(self) -> Shown:
        resource = arm_here(self._arm_name)
        if resource is None:
            return {}
        return {t.uuid: t for t in shown_of(resource.short_name, resource.rig.arm)}


def shown_of(name: str, arm: Arm) -> Iterator[Transform]:
    """What is shown of an arm.

    Args:
        name: The arm's short name.
        arm: What knows its surroundings and plans.
    """
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
        label = f"{name} goal" if is_last else f"{name} way {k}"
        yield _transform(label, f"{name}_origin", shape, at, _GOAL if is_last else _WAY)


def _things(name: str, scene: Scene) -> Iterator[Transform]:
    for thing in scene.obstacles:
        look = _ZONE if thing.keep_out else _OBSTACLE
        yield _transform(thing.name, f"{name}_origin", thing.shape, thing.T_base_obstacle, look)
    for held in scene.attached:
        yield _transform(held.name, name, held.shape, held.T_tool_object, _HELD)


def _transform(
    label: str, frame: str, shape: Shape, pose: SE3, look: Mapping[str, Any]
) -> Transform:
    metadata = Struct()
    metadata.update(look)
    geometry: Geometry = to_geometry(shape, label)
    return Transform(
        reference_frame=label,
        pose_in_observer_frame=PoseInFrame(reference_frame=frame, pose=convert.to_pose(pose)),
        physical_object=geometry,
        uuid=uuid.uuid5(_NAMESPACE, f"{frame}/{label}").bytes,
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
        elif before[key] != transform:
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
