"""Leave out the attributes that a model does not know, as the published module does.

A configuration keeps attributes that have no meaning any more, such as the port of an arm that is
simulated for a while, and remarks. They are left out, and the log names them. One that looks like a
misspelt attribute of the model is refused: it may be a cap.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from so101_motion.common.attributes import Attribute, ignorable
from so101_motion.viam import attribute_table as table
from so101_motion.viam.component_config import MANUAL_RANGES


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownAttributes:
    """The attributes of a configuration that its model knows.

    Attributes:
        values: Those.
        ignored: The names of the others.
    """

    values: Mapping[str, object]
    ignored: tuple[str, ...]


def without_ignored(
    attributes: Mapping[str, object], rows: tuple[Attribute, ...]
) -> KnownAttributes:
    """Leave out what has no meaning.

    Args:
        attributes: As configured.
        rows: Those of the model.

    Raises:
        ConfigError: One looks misspelt; the message suggests the nearest.
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
    return KnownAttributes(values=known, ignored=ignored)


@cache
def names_of_the_family() -> frozenset[str]:
    """The names of all attributes that some model of this module has."""
    from so101_motion.tasks.teleop.config import ATTRIBUTES  # needed only here, by few machines

    tables = (
        table.ARM, table.GRIPPER, table.SIMULATED_ARM, table.SIMULATED_GRIPPER, table.CALIBRATION,
        table.DISCOVERY, table.MOTION, ATTRIBUTES,
    )  # fmt: skip
    return frozenset(row.name for rows in tables for row in rows)
