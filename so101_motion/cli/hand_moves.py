"""``so101 gripper``, ``so101 home`` and ``so101 jog``: the jaw, all joints to zero, and keys."""

from __future__ import annotations

from contextlib import closing, suppress

import click

from so101_motion.cli.options import JSON, YES, argument, verb
from so101_motion.cli.plan_move import planned_move
from so101_motion.cli.shared import (
    CHECK_FAILED,
    answer,
    aside,
    have_agreed,
    quietly,
    state_of_opened_arms,
    stops_on_ctrl_c,
)
from so101_motion.cli.sources import ANY_SOURCE, SOURCE, AnySource, Source, paced
from so101_motion.common.errors import BusError


@verb()
def gripper(
    what: str = argument(click.Choice(("open", "close", "grab"))),
    source: AnySource = ANY_SOURCE,
    yes: bool = YES,
    as_json: bool = JSON,
) -> None:
    """Open or close the jaw; close and grab grip what is in between, and tell whether it is held.

    The exit code of a grab that holds nothing is 6. A simulated jaw never holds anything.

    \b
    so101 gripper open --port /dev/ttyACM0
    so101 gripper grab --sim --yes
    """  # noqa: D301
    with quietly(), closing(source.open()) as rig:
        have_agreed(f"{what.capitalize()} the jaw of the {source.what}?", yes)
        jaw = rig.gripper
        motion = jaw.move(1.0, wait=False) if what == "open" else jaw.grab(wait=False)
        with stops_on_ctrl_c(jaw):
            motion.result()
        if getattr(jaw, "is_silent", False):
            raise BusError("gripper is silent, so what it holds is not known; check its cable")
        percent, holds = round(100.0 * jaw.aperture), jaw.is_holding
        told = "" if what == "open" else f"; it holds {'something' if holds else 'nothing'}"
        facts = {"source": source.what, "jaw_percent": percent, "holds": holds}
        answer(as_json, "gripper", facts, f"the jaw is {percent} % open{told}")
        if what == "grab" and not holds and getattr(jaw, "feels", True):
            raise SystemExit(CHECK_FAILED)


@verb()
def home(source: AnySource = paced(ANY_SOURCE), yes: bool = YES, as_json: bool = JSON) -> None:
    """Move all joints to zero, along a planned path. Ctrl-C stops the arm.

    \b
    so101 home --port /dev/ttyACM0
    so101 home --sim --yes
    """  # noqa: D301
    planned_move(source, "home", None, 16, yes, as_json)


@verb()
def jog(source: Source = paced(SOURCE)) -> None:
    """Move the tool with the keys, in steps of 1, 10 or 50 mm.

    It keeps clear of itself and the table. The arm holds while this runs, and after q or Ctrl-C.

    \b
    w s   ahead, back     a d   left, right     r f   up, down
    o c   open the jaw, close it                Enter   the next size of step
    x     stop the motion                       q   quit

    \b
    so101 jog --port /dev/ttyACM0
    so101 jog --sim
    """  # noqa: D301
    from so101_motion.cli.operation_terminal import OperationTerminal
    from so101_motion.cli.terminal import Quit, Terminal
    from so101_motion.tasks.jog_operation import JogOperation

    with Terminal() as terminal, quietly():
        if not terminal.is_manned:
            raise click.UsageError("jogging takes keys; run it in a terminal")
        with (
            closing(source.open()) as rig,
            stops_on_ctrl_c(rig.arm),
            closing(JogOperation(rig)) as operation,
            suppress(Quit),
        ):
            OperationTerminal(operation, terminal).go()
    aside(state_of_opened_arms())
