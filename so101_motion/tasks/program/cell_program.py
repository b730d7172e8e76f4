"""Programs for several arms that share a space, and their files.

Each step has a waypoint for one arm or more. Arms that are named in the same step move together, in
one motion that they begin and end together. Then their jaws move and they pause, and the next step
begins when all are done. A file looks like this::

    {
     "schema": "so101/cell-program/1",
     "rounds": 3,
     "steps": [
      {"left": {"name": "over the mug", "q_deg": [10, -40, 35, 60, 0], "aperture_percent": 80}},
      {"left": {"q_deg": [25, -20, 30, 70, 0], "aperture_percent": 0, "pause_s": 0.5},
       "right": {"q_deg": [40, -40, 35, 60, 0], "speed_percent": 40}}
     ]
    }

Waypoints and ``"loops"`` are as in a program for one arm (``files.py``), but arms stop at each
waypoint. ``"arms": {"left": {"encoder_zeros": ...}}``, in schema 2, has the zeros of each arm.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from so101_motion.common.attributes import Attributes
from so101_motion.common.encoder_zeros import EncoderZeros, shift, zeros_from, zeros_to
from so101_motion.common.errors import ConfigError
from so101_motion.files import user_storage
from so101_motion.tasks.program.files import (
    loops_from,
    loops_to,
    rounds_from,
    rounds_to,
    waypoint_from,
    waypoint_to,
)
from so101_motion.tasks.program.loops import (
    Loop,
    Visit,
    checked_loops,
    loops_around,
    loops_of_part,
    visits_of,
)
from so101_motion.tasks.program.program import MOST, Waypoint, check_rounds

SCHEMA = "so101/cell-program/1"

ZerosOfArms = Mapping[str, EncoderZeros | None]
"""The zeros of each arm's calibration, by the arm's name; None if not known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellProgram:
    """Steps of several arms in order, and how often they are repeated.

    Attributes:
        steps: At most ``MOST``; each has the waypoints of the arms that move, by name.
        rounds: How often they are repeated; None until it is stopped.
        loops: Steps that are repeated within each round, in order, outer loops first.
        before: How many steps of the whole program come before these, in a part of one.

    Raises:
        ConfigError: There are too many steps, one is empty, a waypoint is to be passed, or a loop
            is not valid.
    """

    steps: tuple[Mapping[str, Waypoint], ...]
    rounds: int | None = 1
    loops: tuple[Loop, ...] = ()
    before: int = 0

    def __post_init__(self) -> None:
        if not 0 < len(self.steps) <= MOST:
            raise ConfigError("steps", len(self.steps), f"must be 1 to {MOST}")
        check_rounds(self.rounds)
        object.__setattr__(self, "loops", checked_loops(self.loops, len(self.steps)))
        for number, step in enumerate(self.steps, 1):
            if not step:
                raise ConfigError(f"step {number}", {}, "names no arm")
            for name, waypoint in step.items():
                if waypoint.passes:
                    reason = "cannot be passed; arms of a cell stop at each step"
                    raise ConfigError(f"step {number}: {name}", waypoint.name, reason)

    def part(self, begin: int, end: int) -> CellProgram:
        """The steps from ``begin`` to before ``end``, once, with the loops that are in it."""
        return CellProgram(
            steps=self.steps[begin:end],
            loops=loops_of_part(self.loops, begin, end),
            before=self.before + begin,
        )

    def loops_around(self, index: int) -> tuple[Loop, ...]:
        """The loops that a step is in, the outer one first."""
        return loops_around(self.loops, index)

    def visits(self, most: int | None = None) -> Iterator[Visit]:
        """Every arrival at a step, in order; see ``loops.visits_of``."""
        return visits_of(len(self.steps), self.loops, self.rounds, most=most)

    def called(self, index: int) -> str:
        """What messages call a step: its number, and which arm goes where, if that has a name."""
        number = self.before + index + 1
        goals = ", ".join(
            name if each.name == _nameless(number, name) else f"{name} to {each.name}"
            for name, each in self.steps[index].items()
        )
        return f"step {number} ({goals})"


def cell_folder() -> Path:
    """The folder of the user's programs of several arms.

    Raises:
        ConfigError: This user has no home.
    """
    return user_storage.folder() / "cell_programs"


def read_cell_program(path: Path, zeros: ZerosOfArms | None = None) -> CellProgram:
    """Read the program in a file, and convert it to the zeros of the arms that are to run it.

    Raises:
        ConfigError: It cannot be read, something in it is not valid, or the zeros are another
            arm's; see ``encoder_zeros.shift``.
    """
    content = user_storage.read(path, schema=SCHEMA, zeros=True)
    Attributes(content, ("schema", "rounds", "loops", "steps", "arms"), kind="entry of a program")
    given = content.get("steps")
    if not isinstance(given, list):
        raise ConfigError("steps", given, "must be a list of steps")
    made_with, off = content.get("arms", {}), {}
    if not isinstance(made_with, Mapping):
        raise ConfigError("arms", made_with, 'must be {"left": {"encoder_zeros": ...}, ...}')
    for name, each in made_with.items():
        known = zeros_from(each if isinstance(each, Mapping) else {})
        what = f"the program {path.stem}, {name}"
        off[name] = shift(known, (zeros or {}).get(name), what=what, file=path, name=name)
    steps = (_step(number, each) for number, each in enumerate(given, 1))
    return CellProgram(
        steps=tuple(
            {name: replace(each, q=each.q + off.get(name, 0.0)) for name, each in step.items()}
            for step in steps
        ),
        rounds=rounds_from(content.get("rounds", 1)),
        loops=loops_from(content.get("loops", [])),
    )


def write_cell_program(program: CellProgram, path: Path, zeros: ZerosOfArms | None = None) -> None:
    """Save a program with the zeros of its arms, if known; makes its folder if need be.

    Raises:
        ConfigError: It cannot be written; an existing file is unchanged.
    """
    steps = [{name: waypoint_to(each) for name, each in step.items()} for step in program.steps]
    loops = {"loops": loops_to(program.loops)} if program.loops else {}
    arms = {name: known for name, each in (zeros or {}).items() if (known := zeros_to(each))}
    known = {"arms": arms} if arms else {}
    content = {"rounds": rounds_to(program.rounds), **loops, **known, "steps": steps}
    user_storage.write(path, content, schema=user_storage.with_zeros(SCHEMA) if arms else SCHEMA)


def _step(number: int, content: object) -> dict[str, Waypoint]:
    if not isinstance(content, Mapping):
        raise ConfigError(f"step {number}", content, 'must be {"left": {"q_deg": [...]}, ...}')
    return {
        str(name): waypoint_from(_nameless(number, name), each) for name, each in content.items()
    }


def _nameless(number: int, arm: object) -> str:
    """What a waypoint without a name is called."""
    return f"step {number}: {arm}"
