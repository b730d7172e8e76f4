"""Build a resource of this module from its configuration."""

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
    """A component or service that its attributes describe; what every model inherits first."""

    READ: ClassVar[staticmethod[[Mapping[str, Any]], Any]]
    """Turns attributes into settings; raises ``ConfigError`` for what cannot be used."""

    @classmethod
    def validate_config(cls, config: ComponentConfig) -> tuple[Sequence[str], Sequence[str]]:
        """Check the attributes; the resources that must be there first, and that may be."""
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
        """The resources that must be there before this one, by the names in its settings."""
        return []

    @classmethod
    def used(cls, wanted: Any) -> Sequence[str]:
        """The resources that it uses if they are there."""
        return []

    @classmethod
    def build(cls, name: str, wanted: Any, dependencies: Dependencies) -> Self:
        """Make it as its settings say."""
        raise NotImplementedError
