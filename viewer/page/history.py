"""Go back and forth between the values that something had."""

from __future__ import annotations

from typing import Generic, TypeVar

T = TypeVar("T")

KEPT = 100
"""How many values are remembered; chosen."""


class History(Generic[T]):
    """The values that something had, and the present one.

    Args:
        value: The first one.
    """

    def __init__(self, value: T) -> None:
        self._values, self._at = [value], 0

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
        self._values = [*self._values[: self._at + 1], value][-KEPT:]
        self._at = len(self._values) - 1

    def undo(self) -> T:
        """The value before, or the first one again."""
        self._at = max(self._at - 1, 0)
        return self._values[self._at]

    def redo(self) -> T:
        """The value after, or the last one again."""
        self._at = min(self._at + 1, len(self._values) - 1)
        return self._values[self._at]
