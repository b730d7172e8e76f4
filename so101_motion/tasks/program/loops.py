"""Loops inside a program: waypoints that are repeated several times in a row.

A loop may lie inside one other. The arm stops at its last waypoint, because it turns back there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from so101_motion.common.attributes import checked_number
from so101_motion.common.errors import ConfigError

MOST_TIMES = 10_000
"""Most repetitions of a loop, or of a program that is not endless. Chosen."""

DEEPEST = 2
"""How many loops a waypoint may be in. Chosen."""


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Loop:
    """Waypoints that are repeated several times in a row.

    Attributes:
        first: Index of the first of them.
        last: Index of the last of them.
        times: How often, at least 2.

    Raises:
        ConfigError: A value is not valid.
    """

    first: int
    last: int
    times: int

    def __post_init__(self) -> None:
        if not 0 <= self.first <= self.last:
            raise ConfigError("loop", self.called, "must begin at a step that is not after its end")
        checked_count("times", self.times, lower=2)

    def __contains__(self, index: object) -> bool:
        return isinstance(index, int) and self.first <= index <= self.last

    @property
    def called(self) -> str:
        """What messages call it: the numbers of its first and its last waypoint."""
        return f"{self.first + 1} to {self.last + 1}"

    def without(self, index: int) -> Loop | None:
        """This loop when a waypoint has been removed; None if nothing is left in it."""
        first, last = self.first - (index < self.first), self.last - (index <= self.last)
        return replace(self, first=first, last=last) if first <= last else None

    def moved(self, index: int, to: int) -> Loop | None:
        """This loop when a waypoint has been moved; None if nothing is left in it.

        A waypoint that is moved between two of the loop is then in the loop.
        """
        if index in self and to in self:
            return self
        left = self.without(index)
        if left is None:
            return None
        return replace(
            left, first=left.first + (to <= left.first), last=left.last + (to <= left.last)
        )


def checked_count(
    key: str, value: object, *, lower: int = 1, upper: int = MOST_TIMES, unit: str = "times"
) -> int:
    """``value`` as a whole number within bounds.

    Raises:
        ConfigError: It is not such a number.
    """
    number = checked_number(key, value, lower=lower, upper=upper, unit=unit)
    if number != int(number):
        raise ConfigError(key, value, "must be a whole number")
    return int(number)


def checked_loops(loops: Sequence[Loop], count: int) -> tuple[Loop, ...]:
    """The loops of a program of ``count`` waypoints in order, an outer one before an inner one.

    Raises:
        ConfigError: One is not within the program, two overlap in part, or they are too deep.
    """
    for loop in loops:
        if loop.last >= count:
            raise ConfigError("loop", loop.called, f"must be within the program's {count} steps")
    for one, other in combinations(loops, 2):
        apart = one.last < other.first or other.last < one.first
        within = (one.first in other and one.last in other) or (
            other.first in one and other.last in one
        )
        if not apart and not within:
            raise ConfigError(
                "loop", one.called, f"overlaps the loop {other.called}; put one inside the other"
            )
    for index in range(count):
        if sum(index in loop for loop in loops) > DEEPEST:
            raise ConfigError("loop", index + 1, f"is a step in more than {DEEPEST} loops")
    return tuple(sorted(loops, key=lambda loop: (loop.first, -loop.last)))
