"""The base class of services for one arm of this module.

The arm is no dependency in viam-server's sense, because its configuration may name the service. So
it is looked up with every request; it may be built later, or rebuilt.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Self

from so101_motion.common.attributes import Config, suggest
from so101_motion.common.errors import ConfigError
from so101_motion.viam.component_config import ForAnArmConfig
from so101_motion.viam.models.arm_resource import ArmResource
from so101_motion.viam.models.configured import Configured, Dependencies


class ServiceForAnArm(Configured):
    """A service for the arm that its configuration names, or for the only one."""

    CONFIG: ClassVar[type[Config]] = ForAnArmConfig

    def __init__(self, name: str, arm: str | None) -> None:
        super().__init__(name)  # type: ignore[call-arg]  # the constructor of the service
        self._arm_name = arm

    @classmethod
    def build(cls, name: str, wanted: Any, dependencies: Dependencies) -> Self:
        return cls(name, wanted.arm)

    async def get_status(self, **kwargs: Any) -> Mapping[str, Any]:
        if self._arm_name is None and ArmResource.here:
            return {"arms": list(ArmResource.here)}
        try:
            return {"arms": [arm_here(self._arm_name).short_name]}
        except ConfigError as error:
            return {"problem": str(error)}


def arm_here(name: str | None) -> ArmResource:
    """The arm of this name, or without a name the only one."""
    here = ArmResource.here
    if name is not None and name not in here:
        raise ConfigError("arm", name, f"is not an arm of this module now; {suggest(name, here)}")
    if name is None and len(here) != 1:
        known = ", ".join(here) or "none"
        raise ConfigError(
            "arm", name, f"must name an arm, because there is not exactly one; arms: {known}"
        )
    return here[name] if name is not None else next(iter(here.values()))
