"""``devrel:so101:simulated``: a simulated arm, planned and moved like the real one."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ClassVar

from viam.resource.types import Model

from so101_motion.common.attributes import Attributes
from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.rig.rig import TICK, Rig
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.viam.component_config import SimulatedArmConfig
from so101_motion.viam.models.arm_resource import ArmResource, motion_service, scene_of
from so101_motion.viam.models.configured import Dependencies
from so101_motion.viam.requests.commands import Taking, in_deg

LONGEST_STEP = 3600.0  # most simulated time that one request may let pass [s]; chosen


class SimulatedArm(ArmResource):
    """A simulated SO-101 arm."""

    MODEL: ClassVar = Model.from_string("devrel:so101:simulated")
    CONFIG = SimulatedArmConfig

    left_at: ClassVar[dict[str, Array]] = {}
    """The last joint angles of closed arms, by name, shape (5,), [rad]. A new configuration closes
    and rebuilds an arm; it starts again where it was, as a real arm does."""

    def __init__(
        self, name: str, rig: Rig, config: SimulatedArmConfig, dependencies: Dependencies
    ) -> None:
        super().__init__(name, rig, config, dependencies)
        # One thread for all requests: it takes turns with the arm's, and a new one would begin on
        # another processor, which makes each turn three times as long.
        self._time = ThreadPoolExecutor(1, thread_name_prefix="so101-time")
        self._commands |= {
            "get_motion_params": self._get_motion_params,
            "advance_time": Taking(self._advance_time, ("seconds",)),
        }

    @classmethod
    def build(
        cls, name: str, wanted: SimulatedArmConfig, dependencies: Dependencies
    ) -> SimulatedArm:
        motion_service(wanted.motion, dependencies)  # refuses one that the machine does not have
        rig = open_simulated(
            speed=wanted.speed,
            acceleration=wanted.acceleration,
            scene=scene_of(wanted),
            q_start=cls.left_at.pop(name, None),
            clock=None if wanted.simulate_time else ManualClock(),
        )
        return cls(name, rig, wanted, dependencies)

    async def close(self) -> None:
        await super().close()
        self._time.shutdown(wait=False)
        self.left_at[self.short_name] = self._arm.state.q_ref

    async def _get_motion_params(self) -> dict[str, Any]:
        return {"speed_degs_per_sec": in_deg(self._arm.speed)}

    async def _advance_time(self, given: Attributes) -> dict[str, Any]:
        seconds = given.number("seconds", 0.0, lower=0.0, upper=LONGEST_STEP, unit="s")
        clock = self.rig.clock
        if not isinstance(clock, ManualClock):
            reason = 'needs "simulate_time": false in the configuration; now time passes by itself'
            raise ConfigError("command", "advance_time", reason)
        await self._pass_time(clock, seconds)
        return {"time": clock.now()}

    async def _come_to_rest(self, over: asyncio.Future[None]) -> None:
        """Wait until a motion is over; with a clock that stands still, advance it meanwhile.

        Otherwise a stop, a cancelled call and the end of the process would wait for an
        ``advance_time`` that may never come.
        """

        async def let_time_pass() -> None:
            clock = self.rig.clock
            while isinstance(clock, ManualClock) and not over.done():
                if self._arm.state.arm_moving:
                    await self._pass_time(clock, TICK)
                await asyncio.sleep(0.001)

        passing = asyncio.create_task(let_time_pass())
        try:
            await super()._come_to_rest(over)
        finally:
            passing.cancel()

    async def _pass_time(self, clock: ManualClock, seconds: float) -> None:
        await asyncio.get_running_loop().run_in_executor(self._time, clock.advance, seconds)
