"""The base class of all models: checks a configuration and builds the resource."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, ClassVar, Self

from viam.proto.app.robot import ComponentConfig
from viam.proto.common import ResourceName
from viam.resource.base import ResourceBase
from viam.resource.types import Model

from so101_motion.common.attributes import Attribute, Config, ignorable
from so101_motion.common.errors import LONGEST_QUOTE, clipped
from so101_motion.viam.component_config import MANUAL_RANGES
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.convert import grpc_statuses
from so101_motion.viam.requests.commands import Command, answer

Dependencies = Mapping[ResourceName, ResourceBase]


class Configured:
    """The base of all models: checks a configuration and builds the resource; inherited first."""

    CONFIG: ClassVar[type[Config]]
    """The attributes that it knows; others are left out, see ``without_ignored``."""

    MODEL: ClassVar[Model]

    _commands: Mapping[str, Command]
    _keys: tuple[Any, ...] = ()  # what ``answer`` takes besides

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

    async def do_command(self, command: Mapping[str, Any], **kwargs: Any) -> Mapping[str, Any]:
        with grpc_statuses():
            result = await answer(command, self._commands, *self._keys)
        return convert.to_result(result)

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


def dependency(dependencies: Dependencies, subtype: str, name: str | None) -> Any:
    """The client of a resource that a configuration names; None if the machine has none such."""
    short = (name or "").rpartition("/")[2].rpartition(":")[2]
    for resource, client in dependencies.items():
        if (resource.subtype, resource.name) == (subtype, short):
            return client
    return None


def without_ignored(
    attributes: Mapping[str, object], rows: tuple[Attribute, ...]
) -> tuple[Mapping[str, object], tuple[str, ...]]:
    """Leave out the attributes that a model does not know, as the published module does; name them.

    They are remarks, or of an arm that is simulated for a while. One that looks like a misspelt
    attribute of the model is refused: it may be a cap.
    """
    names = [row.name for row in rows]
    known = {key: value for key, value in attributes.items() if key in names}
    ignored: tuple[str, ...] = ()
    if len(known) < len(attributes):
        ignored = ignorable(attributes, names, elsewhere=names_of_the_family())
    manual = known.get("manual_mode")
    if isinstance(manual, Mapping) and not manual.keys() <= MANUAL_RANGES.keys():
        left_out = ignorable(manual, MANUAL_RANGES, kind="key of manual_mode")
        known["manual_mode"] = {k: value for k, value in manual.items() if k not in left_out}
        ignored += tuple(f"manual_mode.{key}" for key in left_out)
    return known, ignored


@cache
def names_of_the_family() -> frozenset[str]:
    """The names of all attributes that some model of this module has."""
    from so101_motion.viam.published_models import MODELS  # needed only here, by few machines

    return frozenset(row.name for each in MODELS.values() for row in each.rows())
