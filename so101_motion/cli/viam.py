"""``so101 viam …``: print a machine's configuration, or migrate one from the published module."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, BinaryIO

import click

from so101_motion.cli.options import JSON, argument, verb
from so101_motion.cli.ports import FURTHER_PORTS
from so101_motion.cli.shared import (
    CHECK_FAILED,
    NO_DEVICE,
    Verbs,
    aside,
    busy_message,
    echo,
    print_json,
    quietly,
)

if TYPE_CHECKING:
    from so101_motion.viam.migration import Migration


@click.group(cls=Verbs)
def viam() -> None:
    """Print a machine's configuration, or migrate one from the published module."""


@verb(viam, "import")
def import_(file: BinaryIO = argument(click.File("rb")), as_json: bool = JSON) -> None:
    """Read a machine's configuration and print it rewritten for this module.

    FILE is the machine's JSON (Configure, then JSON, in Viam's app; or /etc/viam.json), or - to
    read it from stdin. It is never changed, and keys in it are not printed. The components and
    services to paste are printed on stdout; notes on stderr. Exit code 6 if a part of it cannot be
    used.

    \b
    so101 viam import machine.json
    so101 viam import machine.json > new.json
    """  # noqa: D301
    from so101_motion.common.errors import ConfigError
    from so101_motion.files.json_file import content
    from so101_motion.viam.migration import migrate

    try:
        machine = content(file.read())
    except ValueError as error:
        name = getattr(file, "name", "-")
        raise ConfigError("configuration", name, str(error)) from error
    migration = migrate(machine)
    if as_json:
        told = ("name", "model", "problem", "notes")
        facts = {
            "parts": [{key: getattr(part, key) for key in told} for part in migration.parts],
            "notes": migration.notes,
            "configuration": migration.configuration(),
        }
        print_json("viam-import", facts)
    else:
        _tell(migration)
        click.echo(json.dumps(migration.configuration(), indent=2))
    if any(part.problem for part in migration.parts):
        raise SystemExit(CHECK_FAILED)


@verb(viam)
def config(extra: tuple[str, ...] = FURTHER_PORTS, as_json: bool = JSON) -> None:
    """Print a complete Viam configuration for the arms that are plugged in.

    Paste it into the machine's configuration (Configure, then JSON), beside the other entries. The
    result of the search is printed on stderr, so the output can go into a file. Exit code 3 if
    there is nothing to configure.

    \b
    so101 viam config > arm.json
    """  # noqa: D301
    from so101_motion.setup.discovery import configuration, discover

    with quietly(), busy_message("searching the serial ports"):
        found = discover(extra)
    suggested = configuration(found.reports)
    if as_json:
        reports = [report.to_json() for report in found.reports]
        suggestion = {"ports": reports, "notes": list(found.notes), "configuration": suggested}
        print_json("viam-config", suggestion)
    else:
        for report in found.reports:
            echo(f"{report.port.name}: {report.sentence}", err=True)
        for note in found.notes:
            echo(f"note: {note}", err=True)
        if suggested["components"]:
            click.echo(json.dumps(suggested, indent=2))
    if not suggested["components"]:
        raise SystemExit(NO_DEVICE)


def _tell(migration: Migration) -> None:
    for part in migration.parts:
        for word, lines in (("error", (part.problem,)), ("note", part.notes)):
            for line in filter(None, lines):
                echo(f"{word}: {part.name or part.model}: {line}", err=True)
    for note in migration.notes:
        echo(f"note: {note}", err=True)
    aside("what behaves differently here, and how to go back: docs/migrating.md")
    aside("replace the entries of these names with the following; leave the rest:")
