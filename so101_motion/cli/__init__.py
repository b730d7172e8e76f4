"""`so101 …`: parse, call, print. Degrees and millimetres live here.

Each verb is a function in a module of its own; ``shared.py`` has what they have in common: where
the arm comes from (``--sim`` or ``--port``), how results are printed, and the exit codes. What a
person reads while it works goes to stderr, what was asked for goes to stdout. Heavy libraries are
imported by the verbs that need them, so that ``--help`` is there at once.
"""

from __future__ import annotations

import click

from so101_motion import __version__
from so101_motion.cli.calibrate import calibrate
from so101_motion.cli.calibration import calibration
from so101_motion.cli.demo import demo
from so101_motion.cli.discover import discover
from so101_motion.cli.doctor import doctor
from so101_motion.cli.emulate import emulate
from so101_motion.cli.moving import move, plan
from so101_motion.cli.ports import ports
from so101_motion.cli.setup import setup
from so101_motion.cli.teleop import teleop
from so101_motion.cli.udev import install_udev


class _InOrder(click.Group):
    """Lists the verbs in the order in which a newcomer needs them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


@click.group(cls=_InOrder, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="so101")
def main() -> None:
    """Motion for the SO-101 arm: planned, timed, stoppable."""


for _verb in (
    demo, install_udev, ports, setup, calibrate, calibration, discover, doctor,
    plan, move, teleop, emulate,
):  # fmt: skip
    main.add_command(_verb)
