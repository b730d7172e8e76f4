"""``so101 discover``: a Viam configuration for the arms that are plugged in."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from so101_motion.cli.ports import facts
from so101_motion.cli.shared import NO_DEVICE, json_option, print_json, reports_errors

if TYPE_CHECKING:
    from so101_motion.port_report import PortReport


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
    from so101_motion.cli.shared import quietly
    from so101_motion.cli.terminal import echo
    from so101_motion.discovery import discover as look

    with quietly():
        found = look(extra)
    configuration = _configuration(found.reports)
    if as_json:
        reports = [facts(report) for report in found.reports]
        told = {"ports": reports, "notes": list(found.notes), "configuration": configuration}
        print_json("discover", told)
    else:
        for report in found.reports:
            echo(f"{report.port.name}: {report.sentence}", err=True)
        for note in found.notes:
            echo(f"note: {note}", err=True)
        if configuration["components"]:
            click.echo(json.dumps(configuration, indent=2))
    if not configuration["components"]:
        raise SystemExit(NO_DEVICE)


def _configuration(reports: Iterable[PortReport]) -> dict[str, list[object]]:
    """What viam-server understands: the arms with their frames, and this module."""
    components: list[object] = []
    for report in reports:
        parent = "world"
        for one in report.suggestions:
            component = {
                "name": one.name,
                "api": one.api,
                "model": one.model,
                "attributes": dict(one.attributes),
            }
            if one.api in ("rdk:component:arm", "rdk:component:gripper"):
                component["frame"] = {"parent": parent}
                parent = one.name  # the gripper sits on the arm
            components.append(component)
    return {"components": components, "modules": _module()}


def _module() -> list[object]:
    """This installation as a local module; none if it is not one that viam-server can start."""
    start = Path(__file__).resolve().parents[2] / "run.sh"
    if not start.is_file():
        return []
    return [{"type": "local", "name": "so101-motion", "executable_path": str(start)}]
