"""All verbs of the command line, under the headings of ``so101 --help``."""

from __future__ import annotations

from typing import Any

import click

from so101_motion import __version__
from so101_motion.cli.arms import arms
from so101_motion.cli.calibrate import calibrate
from so101_motion.cli.calibration import calibration
from so101_motion.cli.cell import cell
from so101_motion.cli.completion import completion
from so101_motion.cli.dataset import dataset
from so101_motion.cli.doctor import doctor
from so101_motion.cli.emulate import emulate
from so101_motion.cli.error_exit import reports_errors
from so101_motion.cli.guide import guide
from so101_motion.cli.hand_moves import gripper, home, jog
from so101_motion.cli.measuring import identify, move_test, report_arm
from so101_motion.cli.pick import pick
from so101_motion.cli.plan_move import move, plan
from so101_motion.cli.ports import install_udev, ports
from so101_motion.cli.program import run
from so101_motion.cli.setup import setup
from so101_motion.cli.shared import in_lines, opened
from so101_motion.cli.status import status, stop
from so101_motion.cli.sweep import sweep
from so101_motion.cli.teleop import teleop
from so101_motion.cli.viam import viam
from so101_motion.cli.view import demo, view
from so101_motion.common import interrupts

_SECTIONS: dict[str, tuple[click.Command, ...]] = {
    "Try it": (demo,),
    "Put an arm together": (
        *(install_udev, ports, arms, setup, calibrate, calibration, doctor, move_test, identify),
        *(report_arm, cell),
    ),
    "Move": (view, status, plan, move, home, jog, gripper, pick, run, stop, guide, teleop),
    "Data sets and sweeps": (dataset, sweep),
    "Viam": (viam,),
    "Tools": (emulate, completion),
}
"""The verbs, in the order in which a newcomer needs them."""

_AS_JSON = f"{__name__}.as_json"  # in the context: whether a program reads stdout


class _So101(click.Group):
    """The group of all verbs: lists them under headings, and reports their errors."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.meta[_AS_JSON] = "--json" in args  # known even if the verb's options are wrong
        if args[:1] == ["help"]:
            args = [*args[1:], "--help"]
        with reports_errors(as_json=ctx.meta[_AS_JSON]):
            return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        opened.clear()  # a verb begins: no arm is open
        with reports_errors(as_json=ctx.meta[_AS_JSON]), in_lines(), interrupts.raised():
            return super().invoke(ctx)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for title, verbs in _SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([(str(v.name), v.get_short_help_str(200)) for v in verbs])


@click.group(
    cls=_So101,
    commands=[each for verbs in _SECTIONS.values() for each in verbs],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, "-v", "--version", prog_name="so101")
def main() -> None:
    """Motion for the SO-101 arm: planned, timed, stoppable.

    Most verbs need an arm: --sim (no hardware needed), --port and its serial port, or --machine and
    the address of a running Viam machine. "so101 VERB --help" has examples.

    \b
    so101 demo                                a simulated arm in the browser
    so101 move --sim --xyz 250,0,60           a move without hardware
    so101 doctor                              what is wrong, and what to do about it
    """  # noqa: D301
