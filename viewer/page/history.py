"""Undo and redo for a value."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Generic, TypeVar

T = TypeVar("T")

KEPT = 100
"""How many values are remembered; chosen."""

ONE_DRAG = 0.7
"""Values that follow each other faster than this are one change [s]; chosen: a drag, a slider."""


class History(Generic[T]):
    """The past values of something, the present one, and those that were undone.

    Args:
        value: The first one.
        now: The time [s]; the values of one drag then count as one. Without it each counts.
    """

    def __init__(self, value: T, now: Callable[[], float] | None = None) -> None:
        self._values, self._at = [value], 0
        self._now, self._changed = now, -inf

    @property
    def can_undo(self) -> bool:
        """Whether there is an earlier value."""
        return self._at > 0

    @property
    def can_redo(self) -> bool:
        """Whether there is a later value."""
        return self._at < len(self._values) - 1

    def add(self, value: T) -> None:
        """Take a new value; what was undone is forgotten."""
        before, self._changed = self._changed, inf if self._now is None else self._now()
        is_same_drag = self._now is not None and self._changed - before < ONE_DRAG
        kept = self._values[: self._at + (0 if is_same_drag else 1)]
        self._values = [*kept, value][-KEPT:]
        self._at = len(self._values) - 1

    def amend(self, value: T) -> None:
        """Put a value in the place of the present one."""
        self._values[self._at] = value

    def undo(self) -> T:
        """The value before, or the first one again."""
        self._at, self._changed = max(self._at - 1, 0), -inf
        return self._values[self._at]

    def redo(self) -> T:
        """The value after, or the last one again."""
        self._at, self._changed = min(self._at + 1, len(self._values) - 1), -inf
        return self._values[self._at]
