"""The interface of a sweep, and a function that computes one shard of it.

A sweep is plain data, so that it can be sent to any process on any computer; models are made from
it there, once a thread. The content of a shard depends only on the sweep and its number.
"""

from __future__ import annotations

import hashlib
import io
import threading
import traceback
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.errors import NoPath, So101Error, clipped

Columns = Mapping[str, NDArray[Any]]  # the arrays of a shard by name


class Packed(NamedTuple):
    """A packed shard; workers make it, and one process writes it."""

    data: bytes  # the bytes of its file
    digest: str  # the digest of its arrays


_LONGEST = 500  # how much of an error's message is kept. Chosen.


class Sweep(Protocol):
    """Work that is cut into shards. Implemented by frozen dataclasses of plain data."""

    @property
    def kind(self) -> str:
        """Its kind, one word."""

    @property
    def shards(self) -> int:
        """How many shards there are."""

    @property
    def items(self) -> int:
        """How many items it computes in total."""

    @property
    def unit(self) -> str:
        """Name of the items, in the plural."""

    def facts(self) -> Mapping[str, object]:
        """Its parameters as JSON values: two sweeps with the same facts are the same sweep."""

    def open(self) -> Callable[[int], Columns]:
        """Load what the work needs; returns a function that computes the shard of a number."""


class Outcome(NamedTuple):
    """The result of one shard."""

    shard: Packed | None  # the content of its file; None if it failed
    why: str = ""  # why it failed


def compute(sweep: Sweep, shard: int) -> Outcome:
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


def packed(columns: Columns) -> Packed:
    file = io.BytesIO()
    np.savez_compressed(file, **columns)  # type: ignore[arg-type]  # arrays by name only
    return Packed(file.getvalue(), digest(columns))


def digest(columns: Columns) -> str:
    """The SHA-256 of arrays: their names, types, shapes and values, in the order of the names."""
    whole = hashlib.sha256()
    for name in sorted(columns):
        array = np.ascontiguousarray(columns[name])
        whole.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        whole.update(array.tobytes())
    return whole.hexdigest()


NEVER = 1e6  # A time budget that no search uses up [s]


class WorkBudget:
    """A planner's checkpoint that ends a plan after a number of calls instead of a time.

    So load changes no result. The library calls it every 2048 configurations.
    """

    def __init__(self, looks: int) -> None:
        self._most = self._left = looks

    def reset(self) -> None:
        self._left = self._most

    def __call__(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise NoPath("no path found within the allowed amount of work")
