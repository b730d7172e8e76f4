"""The base of services for one arm of this module.

The arm is no dependency in viam-server's sense, because its own configuration may name such a
service; it is looked up when it is needed, and may be built later or be rebuilt meanwhile.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Self

from so101_motion.common.attributes import suggest
from so101_motion.common.errors import ConfigError
from so101_motion.viam.component_config import arm_served
from so101_motion.viam.models.arm_resource import ArmResource
from so101_motion.viam.models.configured import Configured, Dependencies


class ServiceForAnArm(Configured):
    """A service whose only attribute is ``arm``, the name of the arm it serves.

    Args:
        name: The service's name.
        arm: Name of the arm; None for the only one.
    """

    READ: ClassVar[staticmethod[[Mapping[str, Any]], Any]] = staticmethod(arm_served)

    def __init__(self, name: str, arm: str | None) -> None:
        super().__init__(name)  # type: ignore[call-arg]  # the constructor of the service
        self._arm_name = arm

    @classmethod
    def build(cls, name: str, wanted: Any, dependencies: Dependencies) -> Self:
        """Make the service for the named arm; the arm is no dependency."""
        return cls(name, wanted)

    async def get_status(self, **kwargs: Any) -> Mapping[str, Any]:
        """The arm that is served, or why none can be."""
        if self._arm_name is None and ArmResource.here:
            return {"arms": list(ArmResource.here)}
        try:
            return {"arms": [arm_here(self._arm_name).short_name]}
        except ConfigError as error:
            return {"problem": str(error)}


def arm_here(name: str | None) -> ArmResource:
    """The arm of this name, or without a name the only one.

    Raises:
        ConfigError: It is not there now; the message names those that are.
    """
    here = ArmResource.here
    if name is not None and name not in here:
        raise ConfigError("arm", name, f"is not an arm of this module now; {suggest(name, here)}")
    if name is None and len(here) != 1:
        known = ", ".join(here) or "none"
        raise ConfigError(
            "arm", name, f'which arm? set "arm" in the configuration; arms here: {known}'
        )
    return here[name] if name is not None else next(iter(here.values()))
