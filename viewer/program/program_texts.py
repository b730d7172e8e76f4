"""Sentences and figures of the Program tab, in degrees, percent and seconds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from so101_motion.common.errors import Interrupted, in_series
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_mm
from so101_motion.tasks.program import ARM, Loop, Program, ProgramRun, Waypoint
from so101_motion.tasks.program.program import MOST_NAMED

from ..page import markup, texts
from ..page.screen_state import Sentence, Tone
from .rehearsal_time import RehearsalTime

PRESS_PLAN = Sentence("Press Plan program to check all of it; nothing moves.")
PLANNED = Sentence("Planned, no collisions. Press Run program to move.", Tone.GOOD)
PLANNED_PART = Sentence(
    "Planned, no collisions. Loops that begin earlier run once. Press Run program.",
    Tone.GOOD,
)
PLANNING = Sentence("Planning all steps …")
MOVING = Sentence("Record when nothing moves.")
ARM_MOVED = Sentence("The arm has moved. Press Plan program again.")
JAW_MOVED = Sentence("The gripper has moved. Press Plan program again.")
THINGS_CHANGED = Sentence("Speed limits or surroundings have changed. Press Plan program again.")
PAUSE_STOPS = Sentence("A pause needs a stop, so this waypoint is no longer passed.")
JAW_STOPS = Sentence("The gripper needs a stop, so this waypoint is no longer passed.")
HELD_AGAIN = Sentence("Hand guiding has timed out. The arm holds where it is.")


def welcome(*, is_one: bool) -> Sentence:
    arms = "arm" if is_one else "arms"
    return Sentence(f"Move the {arms} to where the program begins, then press Record waypoint.")


def recorded(number: int) -> Sentence:
    return Sentence(f"Recorded waypoint {number}. Record more, or press Plan program.")


def loaded(name: str, count: int) -> Sentence:
    steps = f"{count} step{'' if count == 1 else 's'}"
    return Sentence(f"Loaded {name}, {steps}. Press Plan program.")


def facts(timeline: RehearsalTime | None) -> tuple[tuple[str, str], ...]:
    if timeline is None:
        return (("One round", "–"), ("Steps", "–"))
    rehearsal, program = timeline.rehearsal, timeline.rehearsal.program
    has_jaw = any(each.aperture is not None for step in program.steps for each in step.values())
    round_ = f"{rehearsal.duration:.1f} s{' plus gripper time' if has_jaw else ''}"
    passed = sum(not program.stops_at(index) for index in range(len(program)))
    steps = f"{len(program)}, {passed} of them passed" if passed else f"{len(program)}"
    pairs = [("One round", round_), ("Steps", steps)]
    if program.rounds != 1:
        rounds = program.rounds
        pairs.append(("Rounds", "until stopped" if rounds is None else f"{rounds}"))
    pairs += [texts.between(each.first, each.second, each.least) for each in timeline.between]
    return tuple(pairs)


def ended(error: BaseException, *, is_one: bool) -> Sentence:
    if isinstance(error, Interrupted) and (error.by == "stop" or not is_one):
        arms = "The arm" if is_one else "Every arm"
        return Sentence(f"Stopped. {arms} holds where it is; the rest was not run.")
    return texts.ended(error)


def passing(before: Waypoint, *, stops: bool) -> Sentence:
    """A waypoint is passed without a stop now, or where nothing follows it ``stops``."""
    if stops:
        return Sentence("The arm stops at the last waypoint, until another follows it.")
    if before.pause > 0.0 or before.aperture is not None:
        text = "Passed without stopping. Its pause and its gripper setting are removed."
        return Sentence(text)
    return Sentence("Passed without stopping.")


def saved(file: Path) -> Sentence:
    return Sentence(f"Saved as {file.stem}: {file}", Tone.GOOD)


def guided(names: Sequence[str], left: float | None) -> Sentence:
    """Guide by hand is on for these arms, for ``left`` more seconds if that is limited.

    The bar says whether an arm can be moved by hand: a simulated one cannot.
    """
    arms = "the arm" if [*names] == [ARM] else in_series(names)
    stand, hold = ("stands", "It holds") if len(names) == 1 else ("stand", "They hold")
    end = "" if left is None else f" {hold} again in {max(math.ceil(left), 0)} s."
    return Sentence(f"Record keeps where {arms} {stand} now.{end}", Tone.WARM)


def progress(run: ProgramRun) -> str:
    """How far a run has come, in so few words that a phone's bar has room for them."""
    before, last = run.program.before, len(run.program)
    return f"Running, step {before + min(run.where.index + 1, last)} of {before + last}"


def running(run: ProgramRun) -> Sentence:
    where, program = run.where, run.program
    index = min(where.index, len(program) - 1)
    doing = "Doing"
    if program.steps[index].keys() == {ARM}:
        doing = {"moving": "Going to", "jaw": "Gripper at", "pausing": "Pausing at",
                 "picking": "Moving an item at"}[where.doing]  # fmt: skip
    loops = zip(where.laps, program.loops_around(index), strict=False)
    laps = "".join(f" Time {lap + 1} of {loop.times}." for lap, loop in loops)
    of = "" if program.rounds is None else f" of {program.rounds}"
    said = "" if program.rounds == 1 else f" Round {where.round + 1}{of}."
    text = f"{doing} {program.called(index)}.{laps}{said} Press Space or Stop to stop."
    return Sentence(text)


def done(run: ProgramRun) -> Sentence:
    rounds = run.program.rounds
    times = "" if rounds == 1 else f" {rounds} times"
    return Sentence(f"Done{times}. Press Plan program to run it again.", Tone.GOOD)


def timeline(timeline: RehearsalTime) -> markup.Timeline:
    program, pieces = timeline.rehearsal.program, timeline.pieces()
    whole = max(timeline.duration, 1e-9)
    parts, loops = [], []
    for visit, index, begins, ends in pieces:
        if ends <= begins:
            continue  # the arm is there already
        parts.append(markup.Span(_short(program, index), begins / whole, ends / whole))
        for depth, loop in enumerate(program.loops_around(index)):
            same = [
                (begin, end)
                for other, at, begin, end in pieces
                if at in loop
                and other.round == visit.round
                and other.laps[:depth] == visit.laps[:depth]
            ]
            span = markup.Span(f"{loop.times}×", same[0][0] / whole, same[-1][1] / whole, depth)
            loops += [] if span in loops else [span]
    return markup.Timeline(tuple(parts), tuple(loops), timeline.duration)


def _short(program: Program, index: int) -> str:
    step = program.steps[index]
    return step[ARM].name if step.keys() == {ARM} else f"{program.before + index + 1}"


def title(program: Program, index: int) -> str:
    step = program.steps[index]
    if len(step) > MOST_NAMED:
        return program.goals(index)
    return step[ARM].name if step.keys() == {ARM} else ", ".join(step)


def place(p_base: Array) -> str:
    return ", ".join(f"{value:.0f}" for value in to_mm(p_base).round() + 0.0) + " mm"


def line(program: Program, index: int, clearance: float | None = None) -> str:
    """What is special about a step, and how near it comes to anything [m], if it is planned."""
    step = program.steps[index]
    ending = [_repeats(loop) for loop in reversed(program.loops) if loop.last == index]
    if step.keys() == {ARM}:
        near = [] if clearance is None else [f"{to_mm(clearance):.0f} mm clear"]
        return ", ".join([*_done_at(step[ARM]), *near, *ending])
    near = [] if clearance is None else [f"{to_mm(clearance):.0f} mm between arms"]
    parts = {name: ", ".join(_done_at(waypoint)) for name, waypoint in step.items()}
    said, *others = dict.fromkeys(parts.values())
    each = [f"{name}: {words}" for name, words in parts.items() if words] if others else [said]
    return "; ".join(filter(None, [*each, *near, *ending]))


def _repeats(loop: Loop) -> str:
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
    if waypoint.item is not None:
        parts.append(f"{waypoint.item} to {waypoint.place}" if waypoint.place
                     else f"pick {waypoint.item}")  # fmt: skip
    if waypoint.pause > 0.0:
        parts.append(f"{waypoint.pause:g} s")
    return parts
