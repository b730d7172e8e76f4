"""``so101 run``: plan a program of waypoints as a whole, and run it."""

from __future__ import annotations

import sys
from concurrent.futures import wait
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

import click

from so101_motion.cli.completion import completed_programs
from so101_motion.cli.options import JSON, YES, argument, option, verb
from so101_motion.cli.param_types import SCENE
from so101_motion.cli.shared import answer, aside, busy_message, quietly, stops_on_ctrl_c
from so101_motion.cli.sources import ANY_SOURCE, AnySource, ending, paced
from so101_motion.common.units import to_deg

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from so101_motion.planning.collision.scene import Scene
    from so101_motion.planning.request import Plan
    from so101_motion.tasks.program import Arms, Program, ProgramRun, Rehearsal


ROUNDS = option("Number of rounds; by default as saved.", click.IntRange(1, 10_000))


@verb()
def run(
    program: str = argument(metavar="PROGRAM", shell_complete=completed_programs),
    source: AnySource = ending(paced(ANY_SOURCE)),
    rounds: int | None = ROUNDS,
    scene: Scene | None = SCENE,
    yes: bool = YES,
    as_json: bool = JSON,
) -> None:
    """Run PROGRAM: the name of one saved on the page, or a .json file.

    Everything is planned and checked for collisions before anything moves. Where "Pass through"
    is ticked the arm does not stop, and each joint comes within 3 degrees of the waypoint. Ctrl-C
    stops the arm.

    \b
    so101 run "stack cubes" --port /dev/ttyACM0
    so101 run --sim wave.json --rounds 3 --scene examples/table.json --yes
    """  # noqa: D301
    from so101_motion.tasks.program import ARM, Solo, files

    files.read(files.find(program))  # refuses a wrong file before the arm is opened
    with quietly(), closing(source.open()) as rig:
        made = files.read(files.find(program), {ARM: rig.connection.encoder_zeros})
        if scene is not None:
            rig.arm.scene = scene
        made = made if rounds is None else made.with_rounds(rounds)
        agree = partial(source.have_agreed, rig, f"Move the {source.what}?", yes)
        carry_out(Solo.of(rig), made, agree, quiet=as_json)
        facts = {
            "source": source.what,
            "waypoints": [each.name for each in made.waypoints],
            "rounds": made.rounds,
            "loops": files.loops_to(made.loops),
            "arrived": {"q_deg": to_deg(rig.arm.state.q).tolist()},
        }
        answer(as_json, "run", facts, "done")


def carry_out(
    arms: Arms, program: Program, agree: Callable[[], None], *, quiet: bool = False
) -> None:
    """Plan a program as a whole, print the plan unless ``quiet``, ask (``agree``), and run it.

    Ctrl-C stops all arms.
    """
    from so101_motion.tasks.program import rehearse, start_program

    with busy_message("planning the program ..."):
        rehearsal = rehearse(arms, program)
    if not quiet:
        aside(_planned(rehearsal))
    agree()
    with stops_on_ctrl_c(arms):
        await_end(start_program(arms, rehearsal))


def await_end(run: ProgramRun) -> None:
    """Wait for the end, and print the present round and step on a terminal."""
    shown = ""
    while not wait((run.future,), 0.1).done:
        where = run.where
        if where.index < len(run.program) and sys.stderr.isatty():
            laps = "".join(f", time {lap + 1}" for lap in where.laps)
            now = f"round {where.round + 1}{laps}, {run.program.called(where.index)}"
            if now != shown:
                aside(now)
            shown = now
    run.future.result()


def _planned(rehearsal: Rehearsal) -> str:
    program = rehearsal.program
    times = "until it is stopped" if program.rounds is None else f"{program.rounds} time(s)"
    lines = []
    for visit, leg, _ in rehearsal.first_round:
        if any(visit.laps):
            continue
        for index, begin, end in zip(leg.indices, (0.0, *leg.at), leg.at, strict=False):
            passed = "" if index == leg.indices[-1] else "  passed"
            lines.append(
                f"  {index + 1:>3}  {program.goals(index):<24}{end - begin:6.2f} s{passed}"
            )
            if not passed:
                lines += said_for_others(leg.plans)
                lines += (
                    f"       with {each.item:<19}{each.duration:6.2f} s"
                    for each in leg.picks.values()
                )
            ending = (loop for loop in reversed(program.loops) if loop.last == index)
            lines += (f"       steps {loop.called} {loop.times} times in all" for loop in ending)
    return "\n".join((*lines, f"{rehearsal.duration:.1f} s a round with its pauses, {times}"))


def said_for_others(plans: Mapping[str, Plan]) -> Iterator[str]:
    """A line for each arm whose plan waits for another, or lacks drive."""
    for name, plan in plans.items():
        if remark := plan.report.for_others or plan.report.short_of_drive:
            yield f"  {name} {remark}"
