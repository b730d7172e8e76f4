"""``devrel:so101:arm``: the real arm on a serial port."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import aclosing
from dataclasses import replace
from typing import Any, ClassVar

from viam.components.arm import Arm, JointPositions, MoveOptions, Pose
from viam.proto.app.robot import ComponentConfig
from viam.proto.common import ResourceName
from viam.resource.base import ResourceBase
from viam.resource.types import Model

from so101_motion.calib import store
from so101_motion.entry import remarks
from so101_motion.errors import So101Error
from so101_motion.hardware_config import HardwareArmConfig, PortConfig
from so101_motion.models import convert
from so101_motion.models.arm_resource import ArmResource, ArmSettings, scene_of
from so101_motion.models.commands import KEYS, Request, answer, motion_params
from so101_motion.models.convert import grpc_statuses
from so101_motion.models.dependencies import motion_name
from so101_motion.models.further_servos import FurtherServos
from so101_motion.models.servo_commands import ServoCommands, health, out_of_fault
from so101_motion.rig import HardwareRig, open_hardware
from so101_motion.servos import ServoSettings


def servo_settings(connection: PortConfig) -> ServoSettings:
    """What a component's configuration asks of its port."""
    file = connection.calibration_file
    return ServoSettings(
        port=connection.port,
        baudrate=connection.baudrate,
        timeout=connection.timeout,
        calibration_file=store.resolve(file) if file else None,
        rate=connection.rate,
    )


class HardwareArm(ArmResource):
    """The SO-101 arm.

    A fault (an unplugged cable, a servo that restarted) ends what is under way. The arm holds then;
    the next request to move lets it hold where it stands, if it can be reached, and moves.

    Args:
        name: The component's name.
        rig: Its share of the rig of its port.
        settings: How it behaves.
        servo_ids: Its servos, base to wrist.
    """

    MODEL: ClassVar = Model.from_string("devrel:so101:arm")

    rig: HardwareRig

    def __init__(
        self, name: str, rig: HardwareRig, settings: ArmSettings, servo_ids: tuple[int, ...]
    ) -> None:
        super().__init__(name, rig, settings)
        self._commands = {
            **ServoCommands(rig, servo_ids, self._manual).commands,
            **FurtherServos(rig, self.logger).commands,
            "get_planning_setup": self._get_planning_setup,
            **self.paths.commands,
        }

    @classmethod
    def validate_config(cls, config: ComponentConfig) -> tuple[Sequence[str], Sequence[str]]:
        """Check the attributes; a motion service named in them is a required dependency.

        Raises:
            ConfigError: As it is, for the SDK makes an INVALID_ARGUMENT of its text.
        """
        settings = HardwareArmConfig.from_attributes(convert.from_struct(config.attributes))
        scene_of(settings)
        return ([motion_name(settings.motion)] if settings.motion else []), []

    @classmethod
    def new(
        cls, config: ComponentConfig, dependencies: Mapping[ResourceName, ResourceBase]
    ) -> HardwareArm:
        """Build the component from its configuration; nothing moves."""
        with grpc_statuses():
            wanted = HardwareArmConfig.from_attributes(convert.from_struct(config.attributes))
            settings, scene = ArmSettings.of(wanted, dependencies), scene_of(wanted)
            asked = replace(servo_settings(wanted.connection), lets_go=wanted.lets_go)
            rig = open_hardware(asked.with_arm(wanted.servo_ids, wanted.zero_offsets))
        try:
            rig.arm.set_speed(wanted.speed)
            rig.arm.set_acceleration(wanted.acceleration)
            rig.arm.compliance = wanted.compliance
            rig.arm.set_load(wanted.load)
            rig.arm.scene = scene
            rig.warm_up()
            arm = cls(config.name, rig, settings, wanted.servo_ids)
        except BaseException:
            rig.close()
            raise
        for key in wanted.unused:
            arm.logger.info("%s has no effect here", key)
        return arm

    # Moving: as every arm, once it holds

    async def move_to_position(
        self, pose: Pose, *, extra: dict[str, Any] | None = None, **kwargs: Any
    ) -> None:
        """Bring the tool to a pose, along a way that is planned; returns on arrival."""
        await self._ready()
        await super().move_to_position(pose, extra=extra, **kwargs)

    async def move_to_joint_positions(
        self, positions: JointPositions, *, extra: dict[str, Any] | None = None, **kwargs: Any
    ) -> None:
        """Bring the joints to angles, along a way that is planned; returns on arrival."""
        await self._ready()
        await super().move_to_joint_positions(positions, extra=extra, **kwargs)

    async def move_through_joint_positions(
        self,
        positions: list[JointPositions],
        options: MoveOptions | None = None,
        *,
        extra: dict[str, Any] | None = None,
        **kwargs: Any,
    ) -> None:
        """Follow joint waypoints without stopping at each; returns on arrival at the last."""
        await self._ready()
        await super().move_through_joint_positions(positions, options, extra=extra, **kwargs)

    async def move_through_joint_positions_streamed(  # type: ignore[override]
        self,
        batches: AsyncIterator[list[Arm.TrajectoryPoint]],
        *,
        extra: dict[str, Any] | None = None,
        **kwargs: Any,
    ) -> AsyncIterator[Arm.TrajectoryUpdate]:
        """Play time-stamped points while they come in, an acknowledgement for each batch."""
        await self._ready()
        playing = super().move_through_joint_positions_streamed(batches, extra=extra, **kwargs)
        async with aclosing(playing) as updates:  # type: ignore[type-var]
            async for update in updates:
                yield update

    async def set_manual_mode(
        self, manual_mode: bool, enabled_for: float = 0, **kwargs: Any
    ) -> None:
        """Yield to a hand, for ``enabled_for`` seconds or until told otherwise; or hold."""
        await self._ready()
        await super().set_manual_mode(manual_mode, enabled_for, **kwargs)

    async def _ready(self) -> None:
        with grpc_statuses():
            await out_of_fault(self.rig)

    # Requests

    async def do_command(self, command: Mapping[str, Any], **kwargs: Any) -> Mapping[str, Any]:
        """Answer the published module's requests, and ``health``."""
        with grpc_statuses():
            result = await answer(command, self._commands, self._motion_params, KEYS)
        return convert.to_result(result)

    async def _motion_params(self, request: Request) -> dict[str, Any]:
        return motion_params(self._arm, request)

    async def get_status(self, **kwargs: Any) -> Mapping[str, Any]:
        """Mode, joints, how the control loop is doing, and how the servos are."""
        status = dict(await super().get_status(**kwargs))
        status["connected"] = self.rig.servos.is_connected
        status["port_losses"] = self.rig.servos.port_losses
        state = self._arm.state
        status["alarms"] = dict(state.reading.alarms)
        status["notes"] = [*self.rig.servos.notes, *remarks(state.reading)]
        status["lent_to"] = state.lent_to
        status["health"] = health(self.rig.servos)
        return convert.to_result(status)

    async def close(self) -> None:
        """Come to rest, hold, and give up the port; may be called twice."""
        self._manual.forget()
        if self.here.get(self.short_name) is self:
            try:
                await asyncio.to_thread(self._arm.stop)
            except So101Error as error:
                self.logger.warning("the arm could not be stopped properly: %s", error)
        await super().close()
