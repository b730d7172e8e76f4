"""``so101 ports`` and ``so101 install-udev``: the serial ports, and access to them on Linux."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import click

from so101_motion.cli.options import JSON, flag, option, verb
from so101_motion.cli.param_types import PORT
from so101_motion.cli.shared import NO_DEVICE, aside, busy_message, echo, print_json, quietly
from so101_motion.common.errors import PortUnavailable

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


_EXPLANATION = """\
Why: a serial port belongs to root and to a group, dialout on Debian and Ubuntu, uucp on Arch. The
rule gives access to servo adapters to the user at the screen and to the group dialout. Over SSH, or
for a program that starts by itself, join that group:
    sudo usermod -aG dialout $USER      and log in again
The rule also keeps ModemManager from asking new adapters whether they are modems.
"""

_BRLTTY = """\
brltty, which drives Braille displays, mistakes adapters with a CH340 chip (1a86:7523) for one;
before its version 6.5 they then have no port at all. Unless you use a Braille display:
    sudo apt remove brltty              and plug the adapter in again
"""


@verb()
def install_udev(
    install: bool = flag("Write the rule; needs root."),
) -> None:
    """Give users of this Linux computer access to servo adapters, without root.

    Prints the udev rule on stdout, and its purpose on stderr; --install writes it to
    /etc/udev/rules.d and activates it.
    """
    from so101_motion.drivers.port import port_list

    if sys.platform != "linux":
        raise click.UsageError("udev is only on Linux; no rule is needed on this computer")
    if install:
        write_rule(port_list.RULES)
        return
    click.echo(port_list.udev_rules(), nl=False)
    aside(f"\n{_EXPLANATION}\n{_BRLTTY}")
    if port_list.is_rule_installed():
        aside(f"It is installed: {port_list.RULES}")
    else:
        aside(f"To install it:\n    {_as_root()}")


def write_rule(path: Path) -> None:
    from so101_motion.drivers.port import port_list
    from so101_motion.files import atomic

    try:
        atomic.write(path, port_list.udev_rules().encode())
    except OSError as error:
        reason = f"{error.strerror}; do it as root: {_as_root()}"
        raise PortUnavailable(str(path), reason) from error
    click.echo(f"written to {path}")
    udevadm = shutil.which("udevadm")
    commands = (("control", "--reload"), ("trigger", "--subsystem-match=tty"))
    if udevadm is not None and all(
        subprocess.run([udevadm, *command], capture_output=True, check=False).returncode == 0
        for command in commands
    ):
        aside("active now; if a port is still refused, plug the adapter in again")
    else:
        aside("active from the next start of this computer")


def _as_root() -> str:
    """The command to run as root, with this program's full path."""
    own = shutil.which(sys.argv[0]) or os.path.abspath(sys.argv[0])
    return f"sudo {own} install-udev --install"
