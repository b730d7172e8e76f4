"""A program of one arm or several as an immutable value, with the edits of it.

An index counts from 0, a number in messages from 1.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import count

from so101_motion.common.attributes import checked_number
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array, joint_angles
from so101_motion.files.user_storage import checked_name
from so101_motion.tasks.program.loops import Loop, Visit, checked_count, checked_loops, round_of

ARM = "arm"  # the name of the arm in a program of one; nobody has to type it
MOST = 2000  # how many steps a program may have. Chosen; beyond that it is a path, see ``guided``.
LONGEST_PAUSE = 3600.0  # longest pause at a waypoint [s]. Chosen.
MOST_NAMED = 3  # of more arms in a step only the number is said. Chosen: a line of a phone.
SLOWEST = 0.05  # smallest share of the arm's caps that a step may have. Chosen.


def check_rounds(rounds: int | None) -> None:
    if rounds is not None:
        checked_count("rounds", rounds)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Waypoint:
    """A place of the arm and what it does there; or a place it only passes."""

    name: str  # its name; need not be unique
    q: Array  # joint angles, shape (5,), [rad]
    aperture: float | None = None  # the jaw's aperture after arrival, 0 to 1; None to leave it
    pause: float = 0.0  # how long to stay after that [s]
    passes: bool = False  # whether the arm goes on at once, with no aperture and no pause
    # share of the arm's speed and acceleration caps on the step to it. If waypoints are passed, the
    # slowest step up to the next stop counts.
    speed: float = 1.0
    # what it picks there, and where it puts it then, as for ``tasks.picking.place_from``, or holds
    # it if that is empty; what it holds already is only put there
    item: str | None = None
    place: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", checked_name(self.name, what="waypoint"))
        object.__setattr__(self, "q", joint_angles("q", self.q))
        checked_number("pause", self.pause, lower=0.0, upper=LONGEST_PAUSE, unit="s")
        checked_number("speed", self.speed, lower=SLOWEST, upper=1.0, unit="of the arm's")
        if self.aperture is not None:
            checked_number("aperture", self.aperture, lower=0.0, upper=1.0, unit="of its travel")
        if self.place and self.item is None:
            raise ConfigError("place", self.place, "needs an item to put there")
        if self.item is not None and self.aperture is not None:
            reason = "moves the gripper itself; leave the gripper as it is, or the item out"
            raise ConfigError("item", self.item, reason)
        if self.passes and (self.pause > 0.0 or self.aperture is not None or self.item is not None):
            what = "a pause" if self.pause > 0.0 else "a move of the gripper"
            raise ConfigError(
                "pass", True, f"cannot go with {what}, for which the arm has to stop; leave one out"
            )


Step = Mapping[str, Waypoint]  # the waypoints of the arms that move in a step, by their names


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Program:
    """Steps in order, and how often they are repeated. Arms named in one step move together."""

    steps: tuple[Step, ...] = ()  # at most ``MOST``
    rounds: int | None = 1  # how often all of it is repeated; None until it is stopped
    loops: tuple[Loop, ...] = ()  # repeated within each round, outer loops first
    before: int = 0  # how many steps of the whole program come before these, in a part of one

    def __post_init__(self) -> None:
        if len(self.steps) > MOST:
            raise ConfigError("steps", len(self.steps), f"are more than {MOST}; make two programs")
        check_rounds(self.rounds)
        object.__setattr__(self, "loops", checked_loops(self.loops, len(self.steps)))
        for number, step in enumerate(self.steps, 1):
            if not step:
                raise ConfigError(f"step {number}", {}, "names no arm")
            for name, each in step.items():
                if each.passes and len(step) > 1:
                    reason = "cannot be passed; arms that move together stop at each step"
                    raise ConfigError(f"step {number}: {name}", each.name, reason)

    @classmethod
    def of_waypoints(
        cls, waypoints: Iterable[Waypoint], *, rounds: int | None = 1, loops: tuple[Loop, ...] = ()
    ) -> Program:
        steps = tuple({ARM: each} for each in waypoints)
        return cls(steps=steps, rounds=rounds, loops=loops)

    def __len__(self) -> int:
        return len(self.steps)

    @property
    def arms(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for step in self.steps for name in step))

    @property
    def picking(self) -> frozenset[str]:
        """The arms that pick or place something."""
        return frozenset(
            name for step in self.steps for name, each in step.items() if each.item is not None
        )

    @property
    def waypoints(self) -> tuple[Waypoint, ...]:
        """The waypoints of a program of one arm; ``ConfigError`` for one of several."""
        if len(self.arms) > 1:
            raise ConfigError("arms", ", ".join(self.arms), "are several; give a program of one")
        return tuple(each for step in self.steps for each in step.values())

    def refuse_empty(self) -> None:
        """Refuse to plan or run a program without a step."""
        if not self.steps:
            raise ConfigError("program", "empty", "has no waypoint; record one first")

    def on(self, arms: Collection[str]) -> Program:
        """This program for these arms; if it is of one and they are one, that one runs it."""
        if len(arms) != 1 or len(self.arms) != 1:
            return self
        (name,), waypoints = arms, self.waypoints
        return replace(self, steps=tuple({name: each} for each in waypoints))

    def for_all(self, arms: Collection[str]) -> Program:
        """This program of one arm for each of ``arms``, together; they stop at each step."""
        stops = (replace(each, passes=False) for each in self.waypoints)
        return replace(self, steps=tuple(dict.fromkeys(arms, each) for each in stops))

    def called(self, index: int) -> str:
        """What messages call a step: its number, and what it does."""
        step = "waypoint" if self.steps[index].keys() == {ARM} else "step"
        called, does = f"{step} {self.before + index + 1}", self.goals(index)
        return called if called == does else f"{called} ({does})"

    def goals(self, index: int) -> str:
        """What a step does: the name of the waypoint, or which arm goes where, if that has one.

        Of more arms than ``MOST_NAMED`` only how many they are.
        """
        step, number = self.steps[index], self.before + index + 1
        if step.keys() == {ARM}:
            return step[ARM].name
        if len(step) > MOST_NAMED:
            return f"{len(step)} arms"
        return ", ".join(
            name if each.name == nameless(number, name) else f"{name} to {each.name}"
            for name, each in step.items()
        )

    def stops_at(self, index: int) -> bool:
        """Whether arms stop at a step; otherwise its only arm goes on to the next without a stop.

        They stop at the last step of the program or of a loop, even if it is to be passed, and
        where another arm moves next.
        """
        is_last = index == len(self) - 1 or any(index == each.last for each in self.loops)
        step = self.steps[index]
        passes = all(each.passes for each in step.values())
        return is_last or not passes or self.steps[index + 1].keys() != step.keys()

    def loops_around(self, index: int) -> tuple[Loop, ...]:
        """The loops that a step is in, the outer one first."""
        return tuple(loop for loop in self.loops if index in loop)

    def visits(self, most: int | None = None) -> Iterator[Visit]:
        """Every arrival at a stop, in order; without end if the program is endless.

        Args:
            most: Loops and rounds are repeated at most so often. Two times give every path there
                is, because what a loop does to arms and jaws holds from its second time on.
        """
        for lap in count():
            if not self.steps or lap in (most, self.rounds):
                return
            for laps, indices in round_of(len(self), self.loops, self.stops_at, most):
                yield Visit(lap, laps, indices)

    def with_step(self, step: Step) -> Program:
        return replace(self, steps=(*self.steps, step))

    def with_program(self, other: Program, at: int) -> Program:
        """This program with the steps, loops and rounds of another before the step ``at``."""
        if other.rounds is None:
            raise ConfigError("program", "until stopped", "never ends; give it a number of rounds")
        count = len(other)
        around = [
            replace(
                each,
                first=each.first + count * (each.first >= at),
                last=each.last + count * (each.last >= at),
            )
            for each in self.loops
        ]
        inside = [replace(each, first=each.first + at, last=each.last + at) for each in other.loops]
        if other.rounds > 1:
            around.append(Loop(first=at, last=at + count - 1, times=other.rounds))
        steps = (*self.steps[:at], *other.steps, *self.steps[at:])
        return replace(self, steps=steps, loops=(*around, *inside))

    def without(self, index: int) -> Program:
        self._check(index)
        others = self.steps[:index] + self.steps[index + 1 :]
        loops = tuple(left for each in self.loops if (left := each.without(index)))
        return replace(self, steps=others, loops=loops)

    def with_changed(self, index: int, step: Step) -> Program:
        self._check(index)
        return replace(self, steps=(*self.steps[:index], step, *self.steps[index + 1 :]))

    def moved(self, index: int, to: int) -> Program:
        """This program with one step at another place in the order."""
        self._check(index)
        self._check(to)
        others = [*self.steps]
        others.insert(to, others.pop(index))
        loops = tuple(left for each in self.loops if (left := each.moved(index, to)))
        return replace(self, steps=tuple(others), loops=loops)

    def with_rounds(self, rounds: int | None) -> Program:
        return replace(self, rounds=rounds)

    def with_loop(self, loop: Loop) -> Program:
        """This program with one more loop, or with another number of times for the same steps."""
        same = (loop.first, loop.last)
        others = (each for each in self.loops if (each.first, each.last) != same)
        return replace(self, loops=(*others, loop))

    def without_loop(self, loop: Loop) -> Program:
        return replace(self, loops=tuple(each for each in self.loops if each is not loop))

    def part(self, begin: int, end: int) -> Program:
        """The steps from ``begin`` to before ``end``, once, with the loops that are in it."""
        loops = tuple(
            replace(each, first=each.first - begin, last=each.last - begin)
            for each in self.loops
            if begin <= each.first and each.last < end
        )
        return Program(steps=self.steps[begin:end], loops=loops, before=self.before + begin)

    def _check(self, index: int) -> None:
        if not 0 <= index < len(self):
            raise ConfigError("step", index + 1, f"is not one of the program's {len(self)}")


def nameless(number: int, arm: str) -> str:
    return f"waypoint {number}" if arm == ARM else f"step {number}: {arm}"
