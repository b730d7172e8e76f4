"""Which arm a service serves that serves one arm of this module.

The arm is no dependency in viam-server's sense, because its own configuration may name such a
service; it is looked up when it is needed, and may be built later or be rebuilt meanwhile.
"""

from __future__ import annotations

from viam.proto.app.robot import ComponentConfig

from so101_motion.config import Attributes
from so101_motion.models import convert
from so101_motion.models.arm_resource import ArmResource


def arm_named(config: ComponentConfig) -> str | None:
    """The arm in the configuration of a service whose only attribute is ``arm``.

    Raises:
        ConfigError: There are other attributes, or it is no name.
    """
    given = Attributes(convert.from_struct(config.attributes), ("arm",))
    return given.text("arm", "").rpartition("/")[2] or None


def arm_here(name: str | None) -> ArmResource | None:
    """The arm of that name, or without a name the only one; None if it is not there now."""
    here = ArmResource.here
    if name is not None:
        return here.get(name)
    return next(iter(here.values())) if len(here) == 1 else None
