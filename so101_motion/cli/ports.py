"""``so101 ports``: list the serial ports and what is connected to each."""

from __future__ import annotations

import os
import sys

import click

from so101_motion.cli.options import JSON, option, verb
from so101_motion.cli.param_types import PORT
from so101_motion.cli.shared import NO_DEVICE, busy_message, print_json, quietly

FURTHER_PORTS = option(
    "Search this one as well, such as /dev/ttyAMA0 (or SO101_PORT); repeatable.",
    PORT, name="--port", multiple=True, envvar="SO101_PORT",
)  # fmt: skip
"""The option of verbs that search all ports."""


@verb()
def ports(extra: tuple[str, ...] = FURTHER_PORTS, as_json: bool = JSON) -> None:
    """List the serial ports, which of them have an arm, and why one cannot be used.

    Servos are read, nothing is written to them. A port that another program uses is left alone.
    Exit code 3 if there is no port at all.
    """
    from so101_motion.cli.terminal import echo
    from so101_motion.setup.discovery import discover

    with quietly(), busy_message("searching the serial ports"):
        found = discover(extra)
    if as_json:
        reports = [report.to_json() for report in found.reports]
        print_json("ports", {"ports": reports, "notes": list(found.notes)})
    else:
        for report in found.reports:
            port = report.port
            click.echo(click.style(port.name, bold=True))
            names = ", ".join(
                name for name in (port.device, port.description) if name not in (port.name, "")
            )
            if names:
                echo(names, indent="  ")
            echo(report.sentence, indent="  ")
            if report.because:
                echo(f"{report.role}: {report.because}", indent="  ")
    for note in found.notes:
        echo(f"note: {note}", err=True)
    if not any(
        sys.platform == "win32" or os.path.exists(report.port.device) for report in found.reports
    ):
        raise SystemExit(NO_DEVICE)
