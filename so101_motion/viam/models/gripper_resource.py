"""The Viam gripper methods that real and simulated grippers share."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from grpclib import GRPCError, Status
from viam.components.gripper import Gripper
from viam.proto.common import Geometry, KinematicsFileFormat

from so101_motion.arm.gripper import JAW_CLOSED
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.attributes import Attributes, checked_number
from so101_motion.planning.collision.scene import TCP_FRAME
from so101_motion.rig.rig import Rig
from so101_motion.viam.component_config import SimulatedGripperConfig
from so101_motion.viam.conversion import kinematics, meshes
from so101_motion.viam.conversion.convert import grpc_statuses
from so101_motion.viam.models.configured import Configured
from so101_motion.viam.requests.await_motion import (
    in_own_thread,
    log_failure_of,
    rest,
    wait_for_arrival,
)
from so101_motion.viam.requests.commands import Command, Request, arguments


def clamped(percentage: float) -> float:
    return min(max(percentage, 0.0), 100.0)


class GripperResource(Configured, Gripper):
    """A gripper component; the arm of its rig is not moved."""

    WAITS: ClassVar = True  # whether a position waits for the jaw unless the request says so

    NEEDS_NO_SERVO: ClassVar[frozenset[str]] = frozenset()
    """The commands that are answered before the servo has been found."""

    here: ClassVar[dict[str, GripperResource]] = {}
    """The grippers of this process by name; services look up theirs here."""

    def __init__(self, name: str, rig: Rig, config: SimulatedGripperConfig) -> None:
        super().__init__(name)
        self.rig = rig
        self.short_name = name.rpartition(":")[2]
        self.here[self.short_name] = self
        self._gripper = rig.gripper
        self._type, self._detail = config.gripper_type, config.mesh_detail
        self._latest: Motion | None = None
        self._open_percent, self._closed_percent = 100.0, 0.0  # where open and grab move the jaw
        self._commands: dict[str, Command] = {}
        self._keys = (self._short_form, ("get", "set"))

    async def found(self) -> None:
        """Wait until the servo has been found, for a request that reads it."""

    @classmethod
    def needed(cls, wanted: SimulatedGripperConfig) -> Sequence[str]:
        return [wanted.arm] if wanted.arm else []

    # Moving

    async def open(self, **kwargs: Any) -> None:
        with grpc_statuses():
            await wait_for_arrival(await self._start(self._open_percent))

    async def grab(self, **kwargs: Any) -> bool:
        """Close until something stops the jaw, and hold the object gently; whether one is held."""
        with grpc_statuses():
            await self._prepare(self._closed_percent, closes=True)
            motion = self._gripper.grab(self._closed_percent / 100.0, wait=False)
            await wait_for_arrival(self._watched(motion))
            return self._gripper.is_holding

    async def _start(self, percentage: float) -> Motion:
        """Start moving the jaw; an object in the way is gripped, not crushed."""
        aperture = percentage / 100.0
        closes = aperture < self._gripper.aperture
        await self._prepare(percentage, closes=closes)
        go = self._gripper.grab if closes else self._gripper.move
        return self._watched(go(aperture, wait=False))

    async def _prepare(self, percentage: float, *, closes: bool) -> None:
        """Make the jaw ready to move."""

    def _watched(self, motion: Motion) -> Motion:
        self._latest = motion
        return motion

    async def stop(self, **kwargs: Any) -> None:
        with grpc_statuses():
            await self._stop()

    async def _stop(self) -> None:
        stopping = asyncio.wrap_future(self._gripper.start_stop())
        await rest(stopping)
        stopping.result()

    async def is_moving(self) -> bool:
        latest = self._latest
        return self._gripper.is_moving or (latest is not None and not latest.future.done())

    async def get_geometries(self, **kwargs: Any) -> list[Geometry]:
        """The parts as meshes, the jaw where it is now, in the arm's tool frame."""
        await self.found()
        body, moving = meshes.gripper_placements(self.rig.arm.model, self._gripper.q_jaw)
        tool = self.rig.arm.tool
        return [
            *meshes.gripper_geometries(self._type, self._detail, body, moving),
            *(() if tool is None else meshes.tool_geometries(tool)),
        ]

    async def get_kinematics(self, **kwargs: Any) -> tuple[KinematicsFileFormat.ValueType, bytes]:
        """Boxes around the closed gripper, and the tool centre point as the leaf; no joints."""
        body, moving = meshes.gripper_placements(self.rig.arm.model, JAW_CLOSED)
        parts = [
            (label, moving if label.startswith("gripper_moving") else body, box)
            for label, box in meshes.gripper_boxes(self._type)
        ]
        tool, T_tool_tcp = self.rig.arm.tool, None
        if tool is not None:
            parts += [
                (each.name, each.T_tool_object, meshes.box_around(each)) for each in tool.parts
            ]
            T_tool_tcp = tool.frames[TCP_FRAME]
        sva = kinematics.gripper_sva(self.short_name, self._type, parts, T_tool_tcp)
        return KinematicsFileFormat.KINEMATICS_FILE_FORMAT_SVA, sva

    async def get_current_inputs(self, **kwargs: Any) -> list[float]:
        return []

    async def go_to_inputs(self, values: list[float], **kwargs: Any) -> None:
        if len(values) > 0:
            raise GRPCError(
                Status.OUT_OF_RANGE,
                f"got {len(values)} inputs, but this gripper's kinematics have no joints; "
                'use open, grab or {"command": "set_position", "percentage": ...}',
            )

    # Requests

    async def do_command(self, command: Mapping[str, Any], **kwargs: Any) -> Mapping[str, Any]:
        if command.get("command") not in self.NEEDS_NO_SERVO:
            await self.found()
        return await super().do_command(command)

    async def _short_form(self, request: Request) -> dict[str, Any]:
        given = arguments(request, ("get", "set", "wait"))
        if "set" in request:
            percentage = checked_number("set", request["set"], unit="%")
            return {"position": await self._go(percentage, given)}
        return {"position": self._percentage()}

    async def _go(self, percentage: float, given: Attributes) -> float:
        """Move to a percentage, limited to 0 .. 100 as in the published module; return it."""
        percentage, waits = clamped(percentage), given.flag("wait", self.WAITS)
        motion = await self._start(percentage)
        if waits:
            await wait_for_arrival(motion)
        else:
            log_failure_of(motion, self.logger)
        return percentage

    def _percentage(self) -> float:
        return round(clamped(100.0 * self._gripper.aperture), 3)

    async def close(self) -> None:
        self._forget()
        await in_own_thread(self.rig.close)

    def _forget(self) -> None:
        if self.here.get(self.short_name) is self:
            del self.here[self.short_name]
