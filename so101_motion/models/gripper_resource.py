"""What every gripper component does, real or simulated: how it looks, and how it is stopped."""

from __future__ import annotations

import asyncio
from typing import Any, ClassVar

from grpclib import GRPCError, Status
from viam.components.gripper import Gripper
from viam.proto.common import Geometry, KinematicsFileFormat

from so101_motion.gripper import JAW_CLOSED
from so101_motion.models import kinematics, meshes
from so101_motion.models.convert import grpc_statuses
from so101_motion.motion import Motion
from so101_motion.rig import Rig


class GripperResource(Gripper):
    """A gripper component.

    Args:
        name: The component's name.
        rig: An arm and its gripper; only the gripper is used.
        gripper_type: ``"follower"`` (moving jaw) or ``"leader"`` (handle and trigger).
        mesh_detail: ``"low"`` or ``"high"``.
    """

    here: ClassVar[dict[str, GripperResource]] = {}
    """The grippers of this process by name, for whoever names one."""

    def __init__(self, name: str, rig: Rig, *, gripper_type: str, mesh_detail: str) -> None:
        super().__init__(name)
        self.rig = rig
        self.short_name = name.rpartition(":")[2]
        self.here[self.short_name] = self
        self._gripper = rig.gripper
        self._type, self._detail = gripper_type, mesh_detail
        self._latest: Motion | None = None

    def _watched(self, motion: Motion) -> Motion:
        self._latest = motion
        return motion

    async def stop(self, **kwargs: Any) -> None:
        """Slow to rest and stay there; returns when the jaw is at rest. The arm is left alone."""
        with grpc_statuses():
            await asyncio.to_thread(self._gripper.stop)

    async def is_moving(self) -> bool:
        """Whether the jaw is under way, or about to be."""
        latest = self._latest
        return self._gripper.is_moving or (latest is not None and not latest.future.done())

    async def get_geometries(self, **kwargs: Any) -> list[Geometry]:
        """The parts as meshes, the jaw where it is now, in the arm's tool frame."""
        body, moving = meshes.gripper_placements(self.rig.arm.model, self._gripper.q_jaw)
        return meshes.gripper_geometries(self._type, self._detail, body, moving)

    async def get_kinematics(self, **kwargs: Any) -> tuple[KinematicsFileFormat.ValueType, bytes]:
        """Boxes around the closed gripper, and the tool centre point as the leaf; no joints."""
        body, moving = meshes.gripper_placements(self.rig.arm.model, JAW_CLOSED)
        parts = [
            (label, moving if label.startswith("gripper_moving") else body, box)
            for label, box in meshes.gripper_boxes(self._type)
        ]
        sva = kinematics.gripper_sva(self.short_name, self._type, parts)
        return KinematicsFileFormat.KINEMATICS_FILE_FORMAT_SVA, sva

    async def get_current_inputs(self, **kwargs: Any) -> list[float]:
        """None: its kinematics have no joints."""
        return []

    async def go_to_inputs(self, values: list[float], **kwargs: Any) -> None:
        """Its kinematics have no joints, so there is nowhere to go to."""
        if len(values) > 0:
            raise GRPCError(
                Status.OUT_OF_RANGE,
                f"got {len(values)} inputs, but this gripper's kinematics have no joints; "
                'use open, grab or {"command": "set_position", "percentage": ...}',
            )

    async def close(self) -> None:
        """Stop and let go of everything; may be called twice."""
        if self.here.get(self.short_name) is self:
            del self.here[self.short_name]
        await asyncio.to_thread(self.rig.close)
