"""Leave out the attributes that a model does not know, as the published module does.

A configuration keeps attributes that have no meaning any more, such as the port of an arm that is
simulated for a while, and remarks. They are left out, and the log names them. One that looks like a
misspelt attribute of the model is refused: it may be a cap.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from so101_motion.common.attributes import Attribute, ignorable
from so101_motion.viam.component_config import MANUAL_RANGES


def without_ignored(
    attributes: Mapping[str, object], rows: tuple[Attribute, ...]
) -> tuple[Mapping[str, object], tuple[str, ...]]:
    """Leave out what has no meaning."""
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
