"""What a sweep is: plain data that says what to compute, cut into shards.

A sweep is a frozen dataclass of numbers, text and tuples, so that it can be sent to any process on
any computer. Live objects (a model, a planner) are made from it where the work is done, once a
thread. What a shard holds depends on the sweep and the shard's number alone: not on who computes
it, in which order, or beside how many others.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

from so101_motion.common.errors import So101Error, clipped
from so101_motion.tasks.sweeps.packed import Columns, Packed, packed

_LONGEST = 500
"""How much of an error's message is kept. Chosen."""


class Sweep(Protocol):
    """Work that is cut into shards. Implemented by frozen dataclasses of plain data."""

    @property
    def kind(self) -> str:
        """What it does, one word."""

    @property
    def shards(self) -> int:
        """Into how many shards it is cut."""

    @property
    def items(self) -> int:
        """How many things it looks at in all."""

    @property
    def unit(self) -> str:
        """What those things are, in the plural."""

    def facts(self) -> Mapping[str, object]:
        """What it is, as JSON values: two sweeps with the same facts are the same sweep."""

    def open(self) -> Callable[[int], Columns]:
        """Load what the work needs; what comes back computes the shard of a number."""


class Outcome(NamedTuple):
    """What became of one shard.

    Attributes:
        shard: What goes into its file, or None.
        why: Why there are none.
    """

    shard: Packed | None
    why: str = ""


def compute(sweep: Sweep, shard: int) -> Outcome:
    """Compute one shard, in whichever process this runs."""
    try:
        return Outcome(packed(_opened(sweep)(shard)))
    except So101Error as error:
        return Outcome(None, clipped(str(error), _LONGEST))
    except Exception as error:  # it becomes a sentence in the manifest; the others go on
        where = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{type(error).__name__}: {error} ({where.name}, line {where.lineno})"
        return Outcome(None, clipped(text, _LONGEST))


class _Opened(threading.local):
    """The sweep that this thread works on; models belong to one thread."""

    newest: tuple[Sweep, Callable[[int], Columns]] | None = None


_OPENED = _Opened()


def _opened(sweep: Sweep) -> Callable[[int], Columns]:
    if _OPENED.newest is None or _OPENED.newest[0] != sweep:
        _OPENED.newest = sweep, sweep.open()
    return _OPENED.newest[1]
