"""The base class of all models: checks a configuration and builds the resource."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

from viam.proto.app.robot import ComponentConfig
from viam.proto.common import ResourceName
from viam.resource.base import ResourceBase

from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.convert import grpc_statuses

Dependencies = Mapping[ResourceName, ResourceBase]


class Configured:
    """A component or service that is built from its attributes; every model inherits it first."""

    READ: ClassVar[staticmethod[[Mapping[str, Any]], Any]]
    """Turns attributes into settings; raises ``ConfigError`` for what cannot be used."""

    @classmethod
    def validate_config(cls, config: ComponentConfig) -> tuple[Sequence[str], Sequence[str]]:
        """Check the attributes; return the required and the optional dependencies."""
        wanted = cls.READ(convert.from_struct(config.attributes))
        return cls.needed(wanted), cls.used(wanted)

    @classmethod
    def new(cls, config: ComponentConfig, dependencies: Dependencies) -> Self:
        """Build the resource from its configuration; nothing moves."""
        with grpc_statuses():
            wanted = cls.READ(convert.from_struct(config.attributes))
            made = cls.build(config.name, wanted, dependencies)
        for key in getattr(wanted, "unused", ()):
            made.logger.info("%s has no effect here", key)  # type: ignore[attr-defined]  # SDK's
        return made

    @classmethod
    def needed(cls, wanted: Any) -> Sequence[str]:
        """The required dependencies: resources that viam-server builds before this one."""
        return []

    @classmethod
    def used(cls, wanted: Any) -> Sequence[str]:
        """The optional dependencies: resources that are used if the machine has them."""
        return []

    @classmethod
    def build(cls, name: str, wanted: Any, dependencies: Dependencies) -> Self:
        """Build the resource from its settings."""
        raise NotImplementedError
