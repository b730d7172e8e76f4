"""Sentences and figures of the Program tab, in degrees, percent and seconds."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from so101_motion.common.errors import Interrupted
from so101_motion.common.units import to_mm
from so101_motion.tasks.program import (
    CellProgramRun,
    Loop,
    Program,
    ProgramRun,
    Rehearsal,
    Waypoint,
    Where,
)
from so101_motion.tasks.program.loops import Visit

from ..page import markup, texts
from ..page.screen_state import Sentence, Tone
from .cell_rehearsal_time import CellRehearsalTime
from .rehearsal_time import RehearsalTime

WELCOME = Sentence(text="Record the arm or the target as the first waypoint.")
PRESS_PLAN = Sentence(text="Press Plan program to check all of it; nothing moves.")
PLANNING = Sentence(text="Planning all waypoints …")
PLANNED = Sentence(
    text="Planned, no collisions. Press Run program to move the arm.", tone=Tone.GOOD
)
PLANNED_PART = Sentence(
    text="Planned, no collisions. Loops that begin earlier run once. Press Run program.",
    tone=Tone.GOOD,
)
ARM_MOVED = Sentence(text="The arm has moved. Press Plan program again.")
JAW_MOVED = Sentence(text="The gripper has moved. Press Plan program again.")
THINGS_CHANGED = Sentence(
    text="Speed limits or surroundings have changed. Press Plan program again."
)
PAUSE_STOPS = Sentence(text="A pause needs a stop, so this waypoint is no longer passed.")
JAW_STOPS = Sentence(text="The gripper needs a stop, so this waypoint is no longer passed.")
HELD_AGAIN = Sentence(text="Hand guiding has timed out. The arm holds where it is.")

CELL_WELCOME = Sentence(
    text="Record where the arms stand, or the targets of the Move tab, as the first step."
)
CELL_PLANNING = Sentence(text="Planning all steps …")
CELL_PLANNED = Sentence(
    text="Planned, no collisions. Press Run program to move the arms.", tone=Tone.GOOD
)
CELL_STOPPED = Sentence(text="Stopped. All arms hold where they are; the rest was not run.")

deleted = texts.deleted


def recorded(number: int) -> Sentence:
    """A waypoint was added."""
    return Sentence(text=f"Recorded waypoint {number}. Record more, or press Plan program.")


def passing(before: Waypoint, *, is_last: bool) -> Sentence:
    """A waypoint is passed without a stop now."""
    if is_last:
        return Sentence(text="The arm stops at the last waypoint, until another follows it.")
    if before.pause > 0.0 or before.aperture is not None:
        text = "Passed without stopping. Its pause and its gripper setting are removed."
        return Sentence(text=text)
    return Sentence(text="Passed without stopping.")


def saved(file: Path) -> Sentence:
    """The program was saved."""
    return Sentence(text=f"Saved as {file.stem}: {file}", tone=Tone.GOOD)


def loaded(name: str, count: int) -> Sentence:
    """A program was loaded."""
    return Sentence(text=f"Loaded {name}, {_waypoints(count)}. Press Plan program.")


def recorded_step(number: int) -> Sentence:
    """A step of several arms was added."""
    return Sentence(text=f"Recorded step {number}. Record more, or press Plan program.")


def loaded_steps(name: str, count: int) -> Sentence:
    """A program of several arms was loaded."""
    return Sentence(text=f"Loaded {name}, {count} step{'s'[: count > 1]}. Press Plan program.")


def guided(left: float | None) -> Sentence:
    """Guide by hand is on, for ``left`` more seconds if that is limited.

    The bar says whether this arm can be moved by hand: a simulated one cannot.
    """
    end = "" if left is None else f" It holds again in {max(math.ceil(left), 0)} s."
    return Sentence(text=f"Record keeps where the arm stands now.{end}", tone=Tone.WARM)


def cell_guided(names: Sequence[str]) -> Sentence:
    """Guide by hand is on for these arms."""
    stand = "stands" if len(names) == 1 else "stand"
    text = f"Record keeps where {' and '.join(names)} {stand} now."
    return Sentence(text=text, tone=Tone.WARM)


def running(run: ProgramRun, first: int = 0) -> Sentence:
    """The progress of a run that began with the waypoint of index ``first``."""
    where, program = run.where, run.program
    index = min(where.index, len(program) - 1)
    doing = {"moving": "Going to", "jaw": "Gripper at", "pausing": "Pausing at"}[where.doing]
    called = f"waypoint {first + index + 1} ({program.waypoints[index].name})"
    return _running(f"{doing} {called}.", where, program.loops_around(index), program.rounds)


def running_step(run: CellProgramRun) -> Sentence:
    """The progress of a run of several arms."""
    where, program = run.where, run.program
    index = min(where.index, len(program.steps) - 1)
    doing = f"Doing {program.called(index)}."
    return _running(doing, where, program.loops_around(index), program.rounds)


def _running(doing: str, where: Where, around: tuple[Loop, ...], rounds: int | None) -> Sentence:
    """What is being done, which time of each loop ``around`` it, and in which round."""
    loops = zip(where.laps, around, strict=False)
    laps = "".join(f" Time {lap + 1} of {loop.times}." for lap, loop in loops)
    of = "" if rounds is None else f" of {rounds}"
    said = "" if rounds == 1 else f" Round {where.round + 1}{of}."
    return Sentence(text=f"{doing}{laps}{said} Press Space or Stop to stop.")


def done(run: ProgramRun | CellProgramRun) -> Sentence:
    """A run has ended as planned."""
    rounds = run.program.rounds
    times = "" if rounds == 1 else f" {rounds} times"
    return Sentence(text=f"Done{times}. Press Plan program to run it again.", tone=Tone.GOOD)


def ended(error: BaseException) -> Sentence:
    """Why a plan or a run failed."""
    if isinstance(error, Interrupted) and error.by == "stop":
        return Sentence(text="Stopped. The arm holds where it is; the rest was not run.")
    return texts.ended(error)


def cell_ended(error: BaseException) -> Sentence:
    """Why a plan or a run of several arms failed."""
    return CELL_STOPPED if isinstance(error, Interrupted) else texts.ended(error)


def cell_facts(timeline: CellRehearsalTime | None) -> tuple[tuple[str, str], ...]:
    """The figures of a planned program of several arms."""
    if timeline is None:
        return (("One round", "–"),)
    pairs = (texts.between(each.first, each.second, each.least) for each in timeline.clearances)
    lasts = f"{timeline.rehearsal.duration:.1f} s plus gripper time and pauses"
    return (("One round", lasts), *pairs)


def cell_line(
    step: Mapping[str, Waypoint], clearance: float | None = None, loops: tuple[Loop, ...] = ()
) -> str:
    """What is special about a step of several arms.

    Args:
        step: The step.
        clearance: How near two arms come to each other [m], if it is planned.
        loops: The loops that end with it.
    """
    parts = ((name, ", ".join(_done_at(waypoint))) for name, waypoint in step.items())
    said = [f"{name}: {said}" for name, said in parts if said]
    if clearance is not None:
        said.append(f"{to_mm(clearance):.0f} mm between arms")
    return "; ".join([*said, *map(_repeats, loops)])


def cell_timeline(timeline: CellRehearsalTime) -> markup.Timeline:
    """A planned program of several arms on a line, in shares of its length."""
    program = timeline.rehearsal.program
    names = [f"{program.before + k + 1}" for k in range(len(program.steps))]
    return _timeline(timeline.spans(), names, program.loops_around, timeline.duration)


def facts(rehearsal: Rehearsal) -> tuple[tuple[str, str], ...]:
    """The figures of a planned program as pairs of name and value."""
    program = rehearsal.program
    has_jaw = any(waypoint.aperture is not None for waypoint in program.waypoints)
    round_ = f"{rehearsal.duration:.1f} s{' plus gripper time' if has_jaw else ''}"
    passed = sum(not program.stops_at(index) for index in range(len(program)))
    waypoints = f"{len(program)}, {passed} of them passed" if passed else f"{len(program)}"
    pairs = [("One round", round_), ("Waypoints", waypoints)]
    if program.rounds != 1:
        rounds = program.rounds
        pairs.append(("Rounds", "until stopped" if rounds is None else f"{rounds}"))
    return tuple(pairs)


def timeline(timeline: RehearsalTime) -> markup.Timeline:
    """A planned program on a line, in shares of its length."""
    program = timeline.rehearsal.program
    names = [each.name for each in program.waypoints]
    return _timeline(timeline.spans(), names, program.loops_around, timeline.duration)


def _timeline(
    spans: Sequence[tuple[Visit, int, float, float]],
    names: Sequence[str],
    loops_around: Callable[[int], tuple[Loop, ...]],
    duration: float,
) -> markup.Timeline:
    whole = max(duration, 1e-9)
    parts, loops = [], []
    for visit, index, begins, ends in spans:
        parts.append(markup.Span(names[index], begins / whole, ends / whole))
        for depth, loop in enumerate(loops_around(index)):
            same = [
                (begin, end)
                for other, at, begin, end in spans
                if at in loop
                and other.round == visit.round
                and other.laps[:depth] == visit.laps[:depth]
            ]
            span = markup.Span(f"{loop.times}×", same[0][0] / whole, same[-1][1] / whole, depth)
            loops += [] if span in loops else [span]
    return markup.Timeline(tuple(parts), tuple(loops), duration)


NO_FACTS = (("One round", "–"), ("Waypoints", "–"))
"""The figures while there is no plan."""


def line(program: Program, index: int, clearance: float | None = None) -> str:
    """What is special about a step.

    Args:
        program: The program.
        index: Which step.
        clearance: How near it comes to anything [m], if it is planned.
    """
    parts = _done_at(program.waypoints[index])
    if clearance is not None:
        parts.append(f"{to_mm(clearance):.0f} mm clear")
    parts += map(_repeats, ending_at(program.loops, index))
    return ", ".join(parts)


def ending_at(loops: tuple[Loop, ...], index: int) -> tuple[Loop, ...]:
    """The loops that end with a step, the inner one first."""
    return tuple(loop for loop in reversed(loops) if loop.last == index)


def _repeats(loop: Loop) -> str:
    """What a loop does, said at its last step."""
    if loop.first == loop.last:
        return f"runs {loop.times}×"
    return f"{loop.called} run {loop.times}×"


def _done_at(waypoint: Waypoint) -> list[str]:
    parts = [f"{100.0 * waypoint.speed:.0f} % speed"] if waypoint.speed < 1.0 else []
    parts += ["passed"] if waypoint.passes else []
    if waypoint.aperture is not None:
        parts.append(
            {0.0: "close", 1.0: "open"}.get(
                waypoint.aperture, f"{100.0 * waypoint.aperture:.0f} % open"
            )
        )
    if waypoint.pause > 0.0:
        parts.append(f"{waypoint.pause:g} s")
    return parts


def _waypoints(count: int) -> str:
    return f"{count} waypoint{'' if count == 1 else 's'}"
