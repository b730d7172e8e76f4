"""Check this computer for disturbances of serial ports: programs, udev rule, latency timer (Linux).

Nothing here opens a port.
"""

from __future__ import annotations

import os
from pathlib import Path

from so101_motion.drivers.port.port_list import ADAPTERS

RULES = Path("/etc/udev/rules.d/70-so101.rules")
"""Path of our udev rule. Its number is below 73, the rule that carries out ``uaccess``."""

_PROCESSES = Path("/proc")
_TTYS = Path("/sys/class/tty")

_INTERFERING = {
    "ModemManager": (
        "ModemManager probes every new serial port for a modem, which disturbs the servos for half"
        " a minute after the adapter was plugged in"
    ),
    "brltty": (
        "brltty, which drives Braille displays, may take adapters with a CH340 chip for such a"
        " display; then they have no serial port"
    ),
}


def udev_rules() -> str:
    lines = [
        "# Servo adapters of the SO-101: usable without root, and ignored by ModemManager.",
        "# Written by: so101 install-udev",
    ]
    for (vendor, product), chip in ADAPTERS.items():
        match = f'ATTRS{{idVendor}}=="{vendor:04x}", ATTRS{{idProduct}}=="{product:04x}"'
        lines += [
            f"# {chip}",
            f'SUBSYSTEM=="tty", {match}, GROUP="dialout", MODE="0660", TAG+="uaccess",'
            ' ENV{ID_MM_PORT_IGNORE}="1"',
        ]
    return "\n".join(lines) + "\n"


def is_rule_installed(rules: Path = RULES) -> bool:
    """Whether our udev rule is installed in its present version."""
    try:
        return rules.read_text(encoding="utf-8") == udev_rules()
    except OSError:
        return False


def interfering_programs(processes: Path = _PROCESSES) -> dict[str, str]:
    """Running programs that are known to interfere with serial ports, each with its effect."""
    running = set()
    for comm in processes.glob("[0-9]*/comm"):
        try:
            running.add(comm.read_text().strip())
        except OSError:
            continue  # it has ended
    return {name: harm for name, harm in _INTERFERING.items() if name in running}


def latency_timer(port: str, ttys: Path = _TTYS) -> float | None:
    """How long an FTDI adapter holds bytes back [s]; None for others, which have no such timer.

    Opening the port with this package sets it to 1 ms where that is allowed.
    """
    device = os.path.basename(os.path.realpath(port))
    try:
        return float((ttys / device / "device" / "latency_timer").read_text()) / 1000.0
    except (OSError, ValueError):
        return None
