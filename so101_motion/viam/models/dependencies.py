"""Find the motion service that a configuration names."""

from __future__ import annotations

from typing import cast

from viam.services.motion import Motion as MotionService

from so101_motion.common.errors import ConfigError
from so101_motion.viam.models.configured import Dependencies


def motion_name(service: str) -> str:
    """The full resource name of a motion service."""
    return service if "/" in service else f"rdk:service:motion/{service}"


def motion_service(name: str | None, dependencies: Dependencies) -> MotionService | None:
    """The motion service of that name; None when none is named.

    Raises:
        ConfigError: There is none of that name.
    """
    if name is None:
        return None
    short_name = name.rpartition("/")[2]
    for resource, client in dependencies.items():
        if resource.subtype == "motion" and resource.name == short_name:
            return cast("MotionService", client)
    raise ConfigError("motion", name, "there is no such motion service on this machine")
