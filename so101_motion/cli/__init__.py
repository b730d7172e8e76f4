"""`so101 …`: parse, call, print. Degrees and millimetres live here.

Each verb is a function in a module of its own; ``shared.py`` has what they have in common: where
the arm comes from (``--sim`` or ``--port``), how results are printed, and the exit codes. What a
person reads while it works goes to stderr, what was asked for goes to stdout. Heavy libraries are
imported by the verbs that need them, so that ``--help`` is there at once.
"""

from __future__ import annotations

import click

from so101_motion import __version__
from so101_motion.cli.demo import demo
from so101_motion.cli.emulate import emulate
from so101_motion.cli.moving import move, plan


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="so101")
def main() -> None:
    """Motion for the SO-101 arm: planned, timed, stoppable."""


for _verb in (demo, plan, move, emulate):
    main.add_command(_verb)
