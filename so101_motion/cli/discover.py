"""``so101 discover``: a Viam configuration for the arms that are plugged in."""

from __future__ import annotations

import json

import click

from so101_motion.cli.ports import facts
from so101_motion.cli.shared import NO_DEVICE, json_option, print_json, reports_errors


@click.command()
@click.option(
    "--port",
    "extra",
    multiple=True,
    envvar="SO101_PORT",
    metavar="PORT",
    help="Look at this one as well (or SO101_PORT); repeatable.",
)
@json_option
@reports_errors
def discover(extra: tuple[str, ...], as_json: bool) -> None:
    """Print a complete Viam configuration for the arms that are plugged in.

    Paste it into the machine's configuration (Configure, then JSON), beside what is there. What was
    found, or not, is told on stderr, so the output can go into a file. Exit code 3 if there is
    nothing to configure.

    \b
    so101 discover > arm.json
    """  # noqa: D301
    from so101_motion.cli.shared import patience, quietly
    from so101_motion.cli.terminal import echo
    from so101_motion.configuration import configuration
    from so101_motion.discovery import discover as look

    with quietly(), patience("looking at the serial ports"):
        found = look(extra)
    suggested = configuration(found.reports)
    if as_json:
        reports = [facts(report) for report in found.reports]
        told = {"ports": reports, "notes": list(found.notes), "configuration": suggested}
        print_json("discover", told)
    else:
        for report in found.reports:
            echo(f"{report.port.name}: {report.sentence}", err=True)
        for note in found.notes:
            echo(f"note: {note}", err=True)
        if suggested["components"]:
            click.echo(json.dumps(suggested, indent=2))
    if not suggested["components"]:
        raise SystemExit(NO_DEVICE)
