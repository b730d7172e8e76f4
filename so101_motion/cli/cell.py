"""``so101 cell``: calibrate the bases of several arms, move them, run programs, pass objects on."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from so101_motion.cli.options import JSON, START, argument, flag, option, verb
from so101_motion.cli.param_types import IN_FILE, JOINTS, POINT
from so101_motion.cli.plan_move import is_still
from so101_motion.cli.program import ROUNDS, carry_out, said_for_others
from so101_motion.cli.shared import (
    Verbs,
    aside,
    busy_message,
    have_agreed,
    print_json,
    quietly,
    stops_on_ctrl_c,
)
from so101_motion.cli.sources import open_arms
from so101_motion.common.units import to_deg, to_m, to_mm, to_rad

if TYPE_CHECKING:
    from collections.abc import Mapping

    from so101_motion.arm.cell import Cell
    from so101_motion.arm.motion_handle import Motion
    from so101_motion.common.geometry import Array
    from so101_motion.rig.rig import Rig
    from so101_motion.setup.base_fit import BaseFit


@click.group(cls=Verbs)
def cell() -> None:
    """Work with several arms that share a space."""


@verb(cell)
def calibrate(
    file: Path = argument(IN_FILE),
    touches: int = option("Number of places.", click.IntRange(5, 50), 6),
    yes: bool = START,
    as_json: bool = JSON,
) -> None:
    """Measure where the arms of FILE stand, and write it to FILE.

    All arms yield to your hands. Let the tips of the fixed jaws of two arms touch at some places
    far apart, and press Enter at each. Touches that do not fit are refused, with their errors. The
    first arm of FILE keeps its position.

    \b
    so101 cell calibrate cell.json
    """  # noqa: D301
    from so101_motion.files.cell_file import read_cell, write_cell
    from so101_motion.setup.base_fit import measure_bases

    known = read_cell(file)
    first, *others = known.arms
    if not others:
        raise click.UsageError(f"{file} names one arm; add the others to measure where they stand")

    def touch(one: str, other: str, number: int) -> None:
        text = f"touch {number} of {touches}: let {one} and {other} meet, then press Enter"
        aside(text)
        if not (sys.stdin and sys.stdin.readline()):
            raise click.UsageError("there is no terminal to press Enter on; run it in one")

    with quietly(), open_arms(known) as opened:
        have_agreed("All arms will yield to your hands now. Are you holding each of them?", yes)
        arms = {name: rig.arm for name, rig in opened.rigs.items()}
        fits = measure_bases(arms, touches, touch)
    bases = {name: first.T_cell_base @ fit.T_first_second for name, fit in fits.items()}
    write_cell(known.with_bases(bases), file)
    if as_json:
        print_json("cell-calibrate", {name: _facts(fit) for name, fit in fits.items()})
    for name, fit in fits.items():
        facts = _facts(fit)
        aside(
            f"{name}: at {facts['position_mm']} mm, {facts['rpy_deg']} deg from {first.name};"
            f" errors of the touches {facts['residuals_mm']} mm"
        )


@verb(cell)
def move(
    file: Path = argument(IN_FILE),
    joints: tuple[tuple[str, Array], ...] = option(
        "Move the joints of an arm to these angles [deg].",
        (str, JOINTS),
        multiple=True,
        metavar="ARM ANGLES",
    ),
    xyz: tuple[tuple[str, Array], ...] = option(
        "Move the tool of an arm to this point [mm], in its base frame.",
        (str, POINT),
        multiple=True,
        metavar="ARM POINT",
    ),
    yes: bool = START,
    as_json: bool = JSON,
) -> None:
    """Move several arms of FILE in one motion, which they begin and end together.

    What runs is the motion that was planned before the question. If an arm has moved since, none
    moves.

    \b
    so101 cell move cell.json --xyz left 150,0,150 --joints right 60,0,0,30,0
    """  # noqa: D301
    from so101_motion.files.cell_file import read_cell
    from so101_motion.planning.goals import Goal, JointGoal, PoseGoal

    goals: dict[str, Goal] = {}
    for name, q_deg in joints:
        goals[name] = JointGoal(q=to_rad(q_deg))
    for name, p_mm in xyz:
        if name in goals:
            raise click.UsageError(f"{name} has two goals; give one")
        goals[name] = PoseGoal.at_point(to_m(p_mm))
    if not goals:
        raise click.UsageError("no goal; give --joints or --xyz, each with the name of an arm")
    with quietly(), open_arms(read_cell(file)) as opened:
        plans = opened.cell.plan_together(goals)
        duration = max(plan.duration for plan in plans.values())
        is_there = all(map(is_still, plans.values()))
        what = "already there" if is_there else f"one motion of {duration:.2f} s"
        aside(f"{' and '.join(plans)}: {what}")
        for line in said_for_others(plans):
            aside(line)
        if not is_there:
            have_agreed("Move all of them?", yes)
            _wait_for_all(opened.cell, opened.cell.move(plans, wait=False))
        reached = _joints_deg(opened.rigs)
    if as_json:
        print_json("cell-move", {"duration_s": duration, "joints_deg": reached})
    for name, values in reached.items():
        aside(f"{name}: {values} deg")


@verb(cell)
def run(
    file: Path = argument(IN_FILE),
    program: Path = argument(IN_FILE),
    rounds: int | None = ROUNDS,
    to_all: bool = flag("Let every arm of FILE run PROGRAM, which is of one arm.", name="--all"),
    yes: bool = START,
    as_json: bool = JSON,
) -> None:
    """Run PROGRAM, whose steps have goals for the arms of FILE.

    The arms of a step move together, in one motion. The whole program is planned before anything
    moves. Ctrl-C stops all arms.

    \b
    so101 cell run cell.json wave.json
    so101 cell run class.json wave.json --all
    """  # noqa: D301
    from so101_motion.files.cell_file import read_cell
    from so101_motion.tasks.program import files

    files.read(program)  # refuses a wrong file before the arms are opened
    with quietly(), open_arms(read_cell(file)) as opened:
        made = files.read(program, opened.zeros())
        made = made.for_all(opened.rigs) if to_all else made
        made = made if rounds is None else made.with_rounds(rounds)
        carry_out(opened.cell, made, lambda: have_agreed("Move the arms?", yes))
        reached = _joints_deg(opened.rigs)
    if as_json:
        print_json("cell-run", {"rounds": made.rounds, "joints_deg": reached})
    aside("done")


@verb(cell)
def handover(
    file: Path = argument(IN_FILE),
    giver: str = argument(),
    taker: str = argument(),
    thing: str | None = argument(required=False),
    yes: bool = START,
    as_json: bool = JSON,
) -> None:
    """Pass an object from the hand of GIVER to that of TAKER, two arms of FILE.

    THING is the object's name in FILE (in "attached" of GIVER); leave it out if GIVER holds only
    one. The program finds where the hands meet and how TAKER grips the object.

    \b
    so101 cell handover cell.json left right stick
    """  # noqa: D301
    from so101_motion.files.cell_file import read_cell
    from so101_motion.files.scene_file import attached_to

    known = read_cell(file)
    if thing is None:
        held = [each.name for arm in known.arms if arm.name == giver for each in arm.attached]
        if len(held) != 1:
            names = ", ".join(held) or "nothing"
            raise click.UsageError(f"name the THING; in {file}, {giver} holds: {names}")
        thing = held[0]
    with quietly(), open_arms(known) as opened:
        with busy_message("searching for a place where the hands can meet ..."):
            plan = opened.cell.plan_handover(giver, taker, thing)
        aside(f"{thing} from {giver} to {taker}: {plan.duration:.1f} s of motion")
        have_agreed(f"Is {thing} in the hand of {giver}, and may all arms move?", yes)
        _wait_for_all(opened.cell, opened.cell.start_handover(plan))
    if as_json:
        facts = {"duration_s": plan.duration, "taken": attached_to([plan.taken])[0]}
        print_json("cell-handover", facts)
    aside(f"{taker} holds {thing} now; in {file} it is still with {giver}")


def _joints_deg(rigs: Mapping[str, Rig]) -> dict[str, list[float]]:
    q = {name: rig.arm.state.q for name, rig in rigs.items()}
    return {name: [round(float(each), 1) for each in to_deg(values)] for name, values in q.items()}


def _wait_for_all(cell: Cell, motions: Mapping[str, Motion]) -> None:
    """Wait until all arms have arrived; Ctrl-C stops all of them."""
    from so101_motion.common.errors import Interrupted, So101Error

    problems = []
    for name, motion in motions.items():
        try:
            with stops_on_ctrl_c(cell):
                motion.result()
        except So101Error as error:
            problems.append(error if name in str(error) else error.about(name))
    if problems:  # the failure of one arm interrupts the others; its error has the reason
        raise next((each for each in problems if not isinstance(each, Interrupted)), problems[0])


def _facts(fit: BaseFit) -> dict[str, list[float]]:
    T = fit.T_first_second
    return {
        "position_mm": [round(float(each), 1) for each in to_mm(T.p)],
        "rpy_deg": [round(float(each), 2) for each in to_deg(T.rpy)],
        "residuals_mm": [round(float(each), 1) for each in to_mm(fit.residuals)],
    }
