"""Undo and redo for a value."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from math import inf
from typing import Generic, TypeVar

T = TypeVar("T")

KEPT = 100
"""How many values are remembered; chosen."""

ONE_DRAG = 0.7
"""Values of one kind that follow each other faster than this are one change [s]; chosen: a drag, a
slider, somebody who types."""


class History(Generic[T]):
    """The past values of something, the present one, and those that were undone.

    Args:
        restore: Takes the value that was undone or redone to, and which of both in a sentence.
        now: The time [s]; without it each value counts.
    """

    def __init__(
        self,
        value: T,
        restore: Callable[[T, str], None],
        now: Callable[[], float] | None = None,
    ) -> None:
        self._values, self._at, self._restore = [value], 0, restore
        self._now, self._changed = now, -inf
        self._kind: Hashable = None

    @property
    def can_undo(self) -> bool:
        return self._at > 0

    @property
    def can_redo(self) -> bool:
        return self._at < len(self._values) - 1

    def add(self, value: T, kind: Hashable = None) -> None:
        """Take a new value; what was undone is forgotten.

        Values of the same ``kind`` that follow each other fast, as in a drag, count as one.
        """
        before, self._changed = self._changed, inf if self._now is None else self._now()
        is_same = kind is not None and kind == self._kind
        is_same_drag = is_same and self._now is not None and self._changed - before < ONE_DRAG
        self._kind = kind
        kept = self._values[: self._at + (0 if is_same_drag else 1)]
        self._values = [*kept, value][-KEPT:]
        self._at = len(self._values) - 1

    def amend(self, value: T) -> None:
        self._values[self._at] = value

    def undo(self) -> None:
        if self.can_undo:
            self._go(-1, "Undone.")

    def redo(self) -> None:
        if self.can_redo:
            self._go(1, "Redone.")

    def _go(self, by: int, words: str) -> None:
        self._restore(self._values[self._at + by], words)
        self._at, self._changed = self._at + by, -inf
