"""The base class of all models: checks a configuration and builds the resource."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

from viam.proto.app.robot import ComponentConfig
from viam.proto.common import ResourceName
from viam.resource.base import ResourceBase
from viam.resource.types import Model

from so101_motion.common.attributes import Config
from so101_motion.common.errors import LONGEST_QUOTE, clipped
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.convert import grpc_statuses
from so101_motion.viam.ignored_attributes import without_ignored

Dependencies = Mapping[ResourceName, ResourceBase]


class Configured:
    """The base of all models: checks a configuration and builds the resource; inherited first."""

    CONFIG: ClassVar[type[Config]]
    """The attributes that it knows; others are left out, see ``ignored_attributes``."""

    MODEL: ClassVar[Model]

    @classmethod
    def validate_config(cls, config: ComponentConfig) -> tuple[Sequence[str], Sequence[str]]:
        wanted = cls.CONFIG.from_attributes(cls._known(config)[0])
        return cls.needed(wanted), cls.used(wanted)

    @classmethod
    def new(cls, config: ComponentConfig, dependencies: Dependencies) -> Self:
        with grpc_statuses():
            known, ignored = cls._known(config)
            wanted = cls.CONFIG.from_attributes(known)
            made = cls.build(config.name, wanted, dependencies)
        logger = made.logger  # type: ignore[attr-defined]  # the SDK's
        for key in getattr(wanted, "unused", ()):
            logger.info("%s has no effect here", key)
        for note in getattr(wanted, "notes", ()):
            logger.warning("%s", note)
        if ignored:
            names = ", ".join(clipped(key, LONGEST_QUOTE) for key in sorted(ignored))
            logger.warning("ignored, because %s has no such attribute: %s", cls.MODEL, names)
        return made

    @classmethod
    def _known(cls, config: ComponentConfig) -> tuple[Mapping[str, object], tuple[str, ...]]:
        return without_ignored(convert.from_struct(config.attributes), cls.CONFIG.rows())

    @classmethod
    def needed(cls, wanted: Any) -> Sequence[str]:
        """The required dependencies."""
        return []

    @classmethod
    def used(cls, wanted: Any) -> Sequence[str]:
        """The optional dependencies."""
        return []

    @classmethod
    def build(cls, name: str, wanted: Any, dependencies: Dependencies) -> Self:
        raise NotImplementedError
