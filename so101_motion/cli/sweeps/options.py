"""Options that verbs of ``so101 sweep`` share: caps, load, processes and result folder."""

from __future__ import annotations

from pathlib import Path

import click

from so101_motion.cli.param_types import Finite
from so101_motion.cli.shared import F
from so101_motion.common import attributes

payload_option = click.option(
    "--payload-g", type=Finite(0.0, 1e3 * attributes.HEAVIEST), default=0.0,
    help="Mass in the hand [g].",
)  # fmt: skip
voltage_option = click.option(
    "--servo-voltage", type=click.Choice([f"{each:g}" for each in attributes.SERVO_VOLTAGES]),
    default=f"{attributes.SERVO_VOLTAGES[0]:g}", show_default=True,
    help="The servos' rated voltage.",
)  # fmt: skip


def caps_options(verb: F) -> F:
    """Add ``--speed`` [deg/s] and ``--acceleration`` [deg/s^2]."""
    acceleration = click.option(
        "--acceleration", type=Finite(*attributes.ACCELERATION_RANGE_DEG), default=430.0,
        show_default=True, metavar="DEG/S2", help="Joint acceleration cap.",
    )  # fmt: skip
    return click.option(
        "--speed", type=Finite(*attributes.SPEED_RANGE_DEG), default=170.0, show_default=True,
        metavar="DEG/S", help="Joint speed cap.",
    )(acceleration(verb))  # fmt: skip


def computing_options(verb: F) -> F:
    """Add ``--out``, ``--workers`` and ``--dask``."""
    for option in (
        click.option("--dask", metavar="ADDRESS", help="A Dask scheduler: tcp://scheduler:8786."),
        click.option("--workers", type=click.IntRange(1, 256), help="Number of processes."),
        click.option(
            "--out", type=click.Path(path_type=Path, file_okay=False), required=True,
            help="Folder of the result.",
        ),
    ):  # fmt: skip
        verb = option(verb)
    return verb
