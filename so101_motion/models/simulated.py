"""``devrel:so101:simulated``: the arm without hardware, moved by the same planner and executor."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from viam.proto.app.robot import ComponentConfig
from viam.proto.common import ResourceName
from viam.resource.base import ResourceBase
from viam.resource.types import Model

from so101_motion.clock import ManualClock, MonotonicClock
from so101_motion.config import SimulatedArmConfig
from so101_motion.errors import ConfigError
from so101_motion.hardware_config import MANUAL_RANGES, compliance
from so101_motion.models import convert
from so101_motion.models.arm_resource import ArmResource, ArmSettings, scene_of
from so101_motion.models.commands import (
    KEYS,
    Command,
    Request,
    answer,
    arguments,
    in_deg,
    motion_params,
)
from so101_motion.models.convert import grpc_statuses
from so101_motion.models.dependencies import motion_name
from so101_motion.models.manual import LONGEST
from so101_motion.rig import TICK, Rig, open_simulated

LONGEST_STEP = 3600.0
"""How much simulated time may pass in one request [s]; chosen."""


class SimulatedArm(ArmResource):
    """A simulated SO-101 arm.

    Args:
        name: The component's name.
        rig: A simulated arm and its clock.
        settings: How it behaves.
    """

    MODEL: ClassVar = Model.from_string("devrel:so101:simulated")

    def __init__(self, name: str, rig: Rig, settings: ArmSettings) -> None:
        super().__init__(name, rig, settings)
        self._commands: dict[str, Command] = {
            "get_motion_params": self._get_motion_params,
            "enter_manual_mode": self._enter_manual_mode,
            "exit_manual_mode": self._exit_manual_mode,
            "advance_time": self._advance_time,
            "get_planning_setup": self._get_planning_setup,
            **self.paths.commands,
        }

    @classmethod
    def validate_config(cls, config: ComponentConfig) -> tuple[Sequence[str], Sequence[str]]:
        """Check the attributes; a motion service named in them is a required dependency.

        Raises:
            ConfigError: As it is, for the SDK makes an INVALID_ARGUMENT of its text.
        """
        settings = SimulatedArmConfig.from_attributes(convert.from_struct(config.attributes))
        scene_of(settings)
        return ([motion_name(settings.motion)] if settings.motion else []), []

    @classmethod
    def new(
        cls, config: ComponentConfig, dependencies: Mapping[ResourceName, ResourceBase]
    ) -> SimulatedArm:
        """Build the component from its configuration."""
        with grpc_statuses():
            wanted = SimulatedArmConfig.from_attributes(convert.from_struct(config.attributes))
            settings = ArmSettings.of(wanted, dependencies)
            rig = open_simulated(
                speed=wanted.speed,
                acceleration=wanted.acceleration,
                scene=scene_of(wanted),
                clock=MonotonicClock() if wanted.simulate_time else ManualClock(),
            )
        rig.arm.set_load(wanted.load)
        arm = cls(config.name, rig, settings)
        if wanted.mesh_ratios_given:
            arm.logger.info("mesh_decimation_ratios has no effect: these meshes are light as is")
        return arm

    async def do_command(self, command: Mapping[str, Any], **kwargs: Any) -> Mapping[str, Any]:
        """Answer the published module's requests, and ``advance_time``."""
        with grpc_statuses():
            return await answer(command, self._commands, self._motion_params, KEYS)

    async def _motion_params(self, request: Request) -> dict[str, Any]:
        return motion_params(self._arm, request)

    async def _get_motion_params(self, request: Request) -> dict[str, Any]:
        arguments(request)
        return {"speed_degs_per_sec": in_deg(self._arm.speed)}

    async def _enter_manual_mode(self, request: Request) -> dict[str, Any]:
        given = arguments(request, "enabled_for", *MANUAL_RANGES)
        how = compliance(given)  # checked as on the real arm; here it makes no odds
        seconds = given.number("enabled_for", 0.0, lower=0.0, upper=LONGEST, unit="s")
        await self._manual.set(True, seconds, how)
        return {"mode": "manual"}

    async def _exit_manual_mode(self, request: Request) -> dict[str, Any]:
        arguments(request)
        await self._manual.set(False)
        return {"mode": "auto"}

    async def _advance_time(self, request: Request) -> dict[str, Any]:
        given = arguments(request, "seconds")
        seconds = given.number("seconds", 0.0, lower=0.0, upper=LONGEST_STEP, unit="s")
        clock = self.rig.clock
        if not isinstance(clock, ManualClock):
            raise ConfigError(
                "command", "advance_time", 'time passes by itself; set "simulate_time": false'
            )
        await asyncio.to_thread(clock.advance, seconds)
        return {"time": clock.now()}

    async def _come_to_rest(self, over: asyncio.Future[None]) -> None:
        """As for every arm; where time stands still, what the arm needs to stop is let pass.

        Otherwise a stop, a cancelled call and the end of the process would wait for a request to
        advance the time that nobody may send.
        """
        passing = asyncio.create_task(self._let_time_pass(over))
        try:
            await super()._come_to_rest(over)
        finally:
            passing.cancel()

    async def _let_time_pass(self, over: asyncio.Future[None]) -> None:
        clock = self.rig.clock
        while isinstance(clock, ManualClock) and not over.done():
            if self._arm.is_moving:
                await asyncio.to_thread(clock.advance, TICK)
            await asyncio.sleep(0.001)
