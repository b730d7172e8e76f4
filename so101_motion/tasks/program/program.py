"""A program of waypoints as an immutable value, with the edits of it.

An index counts from 0, a number in messages from 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from so101_motion.common.attributes import checked_number
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array, frozen_array
from so101_motion.files.user_storage import checked_name
from so101_motion.tasks.program.loops import (
    Loop,
    Visit,
    checked_count,
    checked_loops,
    loops_around,
    loops_of_part,
    visits_of,
    with_loop,
    with_step_moved,
    without_step,
)

MOST = 200
"""How many waypoints a program may have. Chosen; beyond that it is a path, see ``guided``."""

LONGEST_PAUSE = 3600.0
"""Longest pause at a waypoint [s]. Chosen."""

SLOWEST = 0.05
"""Smallest share of the arm's caps that a step may have. Chosen."""


def check_rounds(rounds: int | None) -> None:
    """Refuse a number of rounds that is not valid; None is endless.

    Raises:
        ConfigError: It is too large, too small, or not a whole number.
    """
    if rounds is not None:
        checked_count("rounds", rounds)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Waypoint:
    """A place of the arm, the jaw's aperture there, and a pause; or a place it only passes.

    Attributes:
        name: Its name; need not be unique.
        q: Joint angles, shape (5,), [rad].
        aperture: The jaw's aperture after arrival, 0 to 1; None to leave it.
        pause: How long to stay after that [s].
        passes: Whether the arm goes on without stopping; then there is no aperture and no pause.
        speed: Share of the arm's speed and acceleration caps on the step to it. If waypoints are
            passed, the slowest step up to the next stop counts.

    Raises:
        ConfigError: A value is not valid, or a passed waypoint has a pause or an aperture.
    """

    name: str
    q: Array
    aperture: float | None = None
    pause: float = 0.0
    passes: bool = False
    speed: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", checked_name(self.name, what="waypoint"))
        object.__setattr__(self, "q", frozen_array(self.q, (5,)))
        checked_number("pause", self.pause, lower=0.0, upper=LONGEST_PAUSE, unit="s")
        checked_number("speed", self.speed, lower=SLOWEST, upper=1.0, unit="of the arm's")
        if self.aperture is not None:
            checked_number("aperture", self.aperture, lower=0.0, upper=1.0, unit="of its travel")
        if self.passes and (self.pause > 0.0 or self.aperture is not None):
            what = "a pause" if self.pause > 0.0 else "a move of the gripper"
            raise ConfigError(
                "pass", True, f"cannot be with {what}, for which the arm has to stop; leave one out"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Program:
    """Waypoints in order, and how often they are repeated.

    Attributes:
        waypoints: At most ``MOST``.
        rounds: How often all of it is repeated; None until it is stopped.
        loops: Waypoints that are repeated within each round, in order, outer loops first.

    Raises:
        ConfigError: There are too many waypoints, or a loop is not valid.
    """

    waypoints: tuple[Waypoint, ...] = ()
    rounds: int | None = 1
    loops: tuple[Loop, ...] = ()

    def __post_init__(self) -> None:
        if len(self.waypoints) > MOST:
            raise ConfigError(
                "waypoints", len(self.waypoints), f"are more than {MOST}; make two programs"
            )
        check_rounds(self.rounds)
        object.__setattr__(self, "loops", checked_loops(self.loops, len(self.waypoints)))

    def __len__(self) -> int:
        return len(self.waypoints)

    def called(self, index: int) -> str:
        """The name of a waypoint in messages: its number and its name."""
        return f"waypoint {index + 1} ({self.waypoints[index].name})"

    def stops_at(self, index: int) -> bool:
        """Whether the arm stops at a waypoint.

        It does at the last one of the program or of a loop, even if that is to be passed.
        """
        is_last = index == len(self.waypoints) - 1 or any(index == each.last for each in self.loops)
        return is_last or not self.waypoints[index].passes

    def loops_around(self, index: int) -> tuple[Loop, ...]:
        """The loops that a waypoint is in, the outer one first."""
        return loops_around(self.loops, index)

    def visits(self, most: int | None = None) -> Iterator[Visit]:
        """Every arrival at a stop, in order; see ``loops.visits_of``."""
        return visits_of(len(self), self.loops, self.rounds, stops_at=self.stops_at, most=most)

    def with_waypoint(self, waypoint: Waypoint) -> Program:
        """This program with one more waypoint at the end."""
        return replace(self, waypoints=(*self.waypoints, waypoint))

    def without(self, index: int) -> Program:
        """This program without one waypoint."""
        self._check(index)
        others = self.waypoints[:index] + self.waypoints[index + 1 :]
        return replace(self, waypoints=others, loops=without_step(self.loops, index))

    def with_changed(self, index: int, waypoint: Waypoint) -> Program:
        """This program with one waypoint replaced."""
        self._check(index)
        changed = (*self.waypoints[:index], waypoint, *self.waypoints[index + 1 :])
        return replace(self, waypoints=changed)

    def moved(self, index: int, to: int) -> Program:
        """This program with one waypoint at another place in the order."""
        self._check(index)
        self._check(to)
        others = [*self.waypoints]
        others.insert(to, others.pop(index))
        loops = with_step_moved(self.loops, index, to)
        return replace(self, waypoints=tuple(others), loops=loops)

    def with_rounds(self, rounds: int | None) -> Program:
        """This program with another number of rounds."""
        return replace(self, rounds=rounds)

    def with_loop(self, loop: Loop) -> Program:
        """This program with one more loop, or with another number of times for the same steps."""
        return replace(self, loops=with_loop(self.loops, loop))

    def without_loop(self, loop: Loop) -> Program:
        """This program without one of its loops; its waypoints stay."""
        return replace(self, loops=tuple(each for each in self.loops if each is not loop))

    def part(self, begin: int, end: int) -> Program:
        """The waypoints from ``begin`` to before ``end``, once, with the loops that are in it."""
        return Program(
            waypoints=self.waypoints[begin:end], loops=loops_of_part(self.loops, begin, end)
        )

    def _check(self, index: int) -> None:
        if not 0 <= index < len(self.waypoints):
            raise ConfigError(
                "waypoint", index + 1, f"is not one of the program's {len(self.waypoints)}"
            )
