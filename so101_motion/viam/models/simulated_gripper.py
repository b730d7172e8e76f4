"""``devrel:so101:simulated-gripper``: a simulated gripper, by itself or that of a simulated arm.

That of an arm grips the items of the arm's scene; one by itself never holds anything.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from viam.components.gripper import Gripper
from viam.resource.types import Model

from so101_motion.arm.gripper import JAW_CLOSED
from so101_motion.common.attributes import Attributes
from so101_motion.common.errors import ConfigError
from so101_motion.rig.rig import Rig
from so101_motion.rig.simulated_rig import open_simulated_gripper
from so101_motion.viam.component_config import SimulatedGripperConfig
from so101_motion.viam.conversion import convert
from so101_motion.viam.models.configured import Dependencies
from so101_motion.viam.models.gripper_resource import GripperResource
from so101_motion.viam.models.simulated import SimulatedArm
from so101_motion.viam.requests.commands import Taking


class SimulatedGripper(GripperResource):
    """A simulated SO-101 gripper."""

    MODEL: ClassVar = Model.from_string("devrel:so101:simulated-gripper")
    CONFIG = SimulatedGripperConfig

    WAITS = False  # as in the published module

    left_at: ClassVar[dict[str, float]] = {}
    """The last jaw angles of closed components, by name [rad]; as for the simulated arm."""

    def __init__(self, name: str, rig: Rig, config: SimulatedGripperConfig) -> None:
        super().__init__(name, rig, config)
        self._target, self._is_alone = self._gripper.aperture, config.arm is None
        self._commands |= {
            "set_position": Taking(
                self._set_position, ("percentage", "position_percentage", "wait")
            ),
            "get_position": self._position,
        }

    @classmethod
    def build(
        cls, name: str, wanted: SimulatedGripperConfig, dependencies: Dependencies
    ) -> SimulatedGripper:
        if wanted.arm:
            arm = SimulatedArm.here.get(wanted.arm)
            if not isinstance(arm, SimulatedArm):
                raise ConfigError(
                    "arm", wanted.arm, "is no simulated arm of this module; leave it out"
                )
            return cls(name, arm.rig, wanted)
        q_jaw = cls.left_at.pop(name, JAW_CLOSED)
        return cls(name, open_simulated_gripper(q_jaw_start=q_jaw), wanted)

    # Moving

    async def _prepare(self, percentage: float, *, closes: bool) -> None:
        self._target = percentage / 100.0

    async def stop(self, **kwargs: Any) -> None:
        await super().stop(**kwargs)
        self._target = self._gripper.aperture

    async def close(self) -> None:
        if not self._is_alone:
            return self._forget()
        await super().close()
        self.left_at[self.short_name] = self.rig.arm.state.q_jaw

    # State

    async def is_holding_something(self, **kwargs: Any) -> Gripper.HoldingStatus:
        return Gripper.HoldingStatus(is_holding_something=self._gripper.is_holding)

    async def get_status(self, **kwargs: Any) -> Mapping[str, Any]:
        return convert.to_result({**await self._position(), "is_moving": await self.is_moving()})

    async def _set_position(self, given: Attributes) -> dict[str, Any]:
        for key in ("percentage", "position_percentage"):
            if given.given(key):
                percentage = await self._go(given.required(key, unit="%"), given)
                return {"target_percentage": percentage}
        raise ConfigError("percentage", None, "is missing; a number from 0 (closed) to 100 (open)")

    async def _position(self) -> dict[str, Any]:
        return {
            "position_percentage": self._percentage(),
            "target_percentage": round(100.0 * self._target, 3),
        }
