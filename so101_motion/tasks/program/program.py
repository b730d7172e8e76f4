"""Programs of waypoints, as immutable values; an index counts from 0, a number from 1."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from so101_motion.common.attributes import checked_number
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array, frozen_array
from so101_motion.files.user_storage import checked_name

MOST = 200
"""How many waypoints a program may have. Chosen; beyond that it is a path, see ``guided``."""

LONGEST_PAUSE = 3600.0
"""Longest pause at a waypoint [s]. Chosen."""

SLOWEST = 0.05
"""The least share of the arm's caps that a step may be given. Chosen."""

MOST_ROUNDS = 10_000
"""How often a program may be run in a row unless it is endless. Chosen."""


def check_rounds(rounds: int | None) -> None:
    """Refuse a number of rounds that cannot be meant; None is endless.

    Raises:
        ConfigError: It is too large, too small, or no whole number.
    """
    if rounds is not None:
        checked_number("rounds", rounds, lower=1, upper=MOST_ROUNDS, unit="times")
        if rounds != int(rounds):
            raise ConfigError("rounds", rounds, "must be a whole number")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Waypoint:
    """A place of the arm, the jaw's aperture there, and a pause; or a place it only passes.

    Attributes:
        name: What people call it; need not be the only one of that name.
        q: Joint angles, shape (5,), [rad].
        aperture: How far the jaw is opened or closed on arrival, 0 to 1; None to leave it.
        pause: How long to stay after that [s].
        passes: Whether the arm goes on without stopping; then nothing else is done there.
        speed: How fast to go there, as a share of the arm's speed and acceleration caps. Where
            waypoints are passed, the slowest step up to the next stop counts.

    Raises:
        ConfigError: A value is not valid, or what needs a stop is wanted in passing.
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
        rounds: How often; None for until it is stopped.
    """

    waypoints: tuple[Waypoint, ...] = ()
    rounds: int | None = 1

    def __post_init__(self) -> None:
        if len(self.waypoints) > MOST:
            raise ConfigError(
                "waypoints", len(self.waypoints), f"are more than {MOST}; make two programs"
            )
        check_rounds(self.rounds)

    def __len__(self) -> int:
        return len(self.waypoints)

    def called(self, index: int) -> str:
        """The name of a waypoint in messages: its number and its name."""
        return f"waypoint {index + 1} ({self.waypoints[index].name})"

    def stops_at(self, index: int) -> bool:
        """Whether the arm stops at a waypoint; at the last it does, even if that may be passed."""
        return index == len(self.waypoints) - 1 or not self.waypoints[index].passes

    def stretches(self) -> Iterator[range]:
        """The waypoints from one stop to the next: those passed, then the one stopped at."""
        begin = 0
        for index in range(len(self.waypoints)):
            if self.stops_at(index):
                yield range(begin, index + 1)
                begin = index + 1

    def with_waypoint(self, waypoint: Waypoint) -> Program:
        """This program with one more waypoint at the end."""
        return replace(self, waypoints=(*self.waypoints, waypoint))

    def without(self, index: int) -> Program:
        """This program without one waypoint."""
        self._check(index)
        return replace(self, waypoints=self.waypoints[:index] + self.waypoints[index + 1 :])

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
        return replace(self, waypoints=tuple(others))

    def with_rounds(self, rounds: int | None) -> Program:
        """This program with another number of rounds."""
        return replace(self, rounds=rounds)

    def _check(self, index: int) -> None:
        if not 0 <= index < len(self.waypoints):
            raise ConfigError(
                "waypoint", index + 1, f"is not one of the program's {len(self.waypoints)}"
            )
