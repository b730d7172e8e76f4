"""Loops inside a program: steps that are repeated several times in a row.

A loop may lie inside one other. The arm stops at its last waypoint, because it turns back there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import prod
from typing import NamedTuple

from so101_motion.common.attributes import checked_number
from so101_motion.common.errors import ConfigError

MOST_TIMES = 10_000  # most repetitions of a loop, or of a program that is not endless. Chosen.
DEEPEST = 2  # how many loops a waypoint may be in. Chosen.


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Loop:
    """Waypoints that are repeated several times in a row; checked when it is made."""

    first: int  # index of the first of them
    last: int  # index of the last of them
    times: int  # how often, at least 2

    def __post_init__(self) -> None:
        if not 0 <= self.first <= self.last:
            raise ConfigError("loop", self.called, "must begin at a step that is not after its end")
        checked_count("times", self.times, lower=2)

    def __contains__(self, index: object) -> bool:
        return isinstance(index, int) and self.first <= index <= self.last

    @property
    def called(self) -> str:
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


class Visit(NamedTuple):
    """One arrival at a stop while a program runs."""

    round: int  # the round, counted from 0
    laps: tuple[int, ...]  # repetition of each loop around it, from 0, the outer one first
    indices: range  # the steps after it: those that are passed, then the one stopped at


def checked_count(
    key: str, value: object, *, lower: int = 1, upper: int = MOST_TIMES, unit: str = "times"
) -> int:
    """``value`` as a whole number within bounds; ``ConfigError`` if it is none."""
    number = checked_number(key, value, lower=lower, upper=upper, unit=unit)
    if number != int(number):
        raise ConfigError(key, value, "must be a whole number")
    return int(number)


def checked_loops(loops: Sequence[Loop], count: int) -> tuple[Loop, ...]:
    """The loops of a program of ``count`` waypoints in order, an outer one before an inner one.

    ``ConfigError`` if one is not within the program, two overlap in part, or they are too deep.
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


def times_in_round(laps: Sequence[int], around: Sequence[Loop]) -> int:
    """How often an arrival comes in a round, if those of later laps count as the second's."""
    pairs = zip(laps, around, strict=True)
    return prod(1 if lap == 0 else loop.times - 1 for lap, loop in pairs)


def round_of(
    steps: int, loops: Sequence[Loop], stops_at: Callable[[int], bool], most: int | None
) -> Iterator[tuple[tuple[int, ...], range]]:
    """The stops of one round: the repetitions of the loops around each, and its steps."""
    laps = [0] * len(loops)
    begin = index = 0
    while index < steps:
        if stops_at(index):
            around = (lap for lap, loop in zip(laps, loops, strict=True) if index in loop)
            yield tuple(around), range(begin, index + 1)
            begin = index + 1
            for k, loop in reversed([*enumerate(loops)]):  # the inner one first
                if loop.last == index:
                    laps[k] += 1
                    if laps[k] < loop.times and laps[k] != most:
                        begin = loop.first
                        break
                    laps[k] = 0
            index = begin
        else:
            index += 1
