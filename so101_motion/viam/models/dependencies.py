"""Find the services and components that a configuration names."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any, cast

from viam.services.motion import Motion as MotionService

from so101_motion.common.errors import ConfigError
from so101_motion.viam.component_config import SensesConfig
from so101_motion.viam.models.configured import Dependencies
from so101_motion.viam.surroundings.camera_view import CameraView
from so101_motion.viam.surroundings.store_watch import StoreWatch
from so101_motion.viam.surroundings.surroundings import Source


def motion_name(service: str) -> str:
    return service if "/" in service else f"rdk:service:motion/{service}"


def motion_service(name: str | None, dependencies: Dependencies) -> MotionService | None:
    if name is None:
        return None
    short_name = name.rpartition("/")[2]
    for resource, client in dependencies.items():
        if resource.subtype == "motion" and resource.name == short_name:
            return cast("MotionService", client)
    raise ConfigError("motion", name, "is not a motion service of this machine; check the name")


def sources(
    senses: SensesConfig, dependencies: Dependencies, logger: logging.Logger
) -> Sequence[Source]:
    """The store and the camera that report the surroundings; the caller closes them.

    A resource that the machine does not have makes a source too; planning with it fails.
    """
    found: list[Source] = []
    if senses.store is not None:
        store = _named("world_state_store", senses.store, dependencies)
        found.append(StoreWatch(senses.store, store, logger))
    if senses.camera is not None:
        camera = _named("camera", senses.camera, dependencies)
        finder = _named("vision", senses.vision, dependencies)
        found.append(CameraView(senses.camera, camera, senses.vision, finder))
    return found


def _named(subtype: str, name: str | None, dependencies: Dependencies) -> Any:
    for resource, client in dependencies.items():
        if (resource.subtype, resource.name) == (subtype, name):
            return client
    return None
