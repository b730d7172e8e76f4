"""List the serial ports by their lasting names; find what keeps one from being used (Linux).

``/dev/ttyACM0`` is whichever adapter came first; macOS shows a device as ``cu``, as ``tty`` and
perhaps once more by a vendor's driver. Each adapter is listed once, under the name that stays:
Linux keeps links by serial number and, for the cheap adapters without one, by the USB socket.

Only USB adapters are listed, those of servo boards first. The user has to name any other port, such
as a Raspberry Pi's own or one on the network.

Nothing here opens a port: that may reset the device behind it, and root would disturb another
program that is using the port.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import sys
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from serial.tools import list_ports

ADAPTERS = {
    (0x1A86, 0x55D3): "CH343, as on the boards of the SO-101 kits",
    (0x1A86, 0x7523): "CH340, as in the FE-URT-1",
    (0x1A86, 0x55D4): "CH9102",
    (0x10C4, 0xEA60): "CP210x",
    (0x0403, 0x6001): "FT232R",
    (0x0403, 0x6014): "FT232H",
}
"""USB ids of adapters that servo boards have, the likeliest first. The first two: users' reports;
the others are the usual chips of such boards (Linux USB id list)."""

_LINKS = Path("/dev/serial")
_USB = Path("/sys/bus/usb/devices")
_PROCESSES = Path("/proc")
_TTYS = Path("/sys/class/tty")

RULES = Path("/etc/udev/rules.d/70-so101.rules")
"""Path of our udev rule. Its number is below 73, the rule that carries out ``uaccess``."""

_MAC = re.compile(r"/dev/(?:cu|tty)\.(usbmodem|usbserial-?|wchusbserial)(.+)")
_MAC_DRIVERS = ("usbmodem", "usbserial", "usbserial-", "wchusbserial")
_USUAL_GROUP = "dialout"  # Debian's; Arch's is uucp
_LONGEST_KEY = 40  # a resource's name has at most 60 characters


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundPort:
    """A serial port."""

    name: str  # the name for a configuration: the one that stays, or the user's
    device: str  # the system's name for it today
    # a short name that stays, for components on this port: letters, digits, ``-``, ``_``, of the
    # serial number, else of the socket, else of the port's name
    key: str
    aliases: tuple[str, ...] = ()  # its other names
    description: str = ""  # the adapter's own description, or its chip
    # the adapter's own; None if it has none or shares it with others
    serial_number: str | None = None
    is_servo_adapter: bool = False  # whether its chip is one that servo boards have


def find_ports(extra: Collection[str] = (), *, links: Path = _LINKS) -> tuple[FoundPort, ...]:
    """List the ports an arm may be connected to, the likeliest first.

    Ports named in ``extra``, by any name, come before them. Linux keeps the lasting names in
    ``links``.
    """
    listed = [port for port in list_ports.comports() if port.vid is not None]
    serial_numbers = Counter((port.vid, port.pid, port.serial_number) for port in listed)
    shares = {id(port): _shares_serial_number(port, serial_numbers) for port in listed}
    found = [_describe(group, shares, links) for group in _merge(listed)]
    found.sort(key=_rank)
    return tuple(_named_by_user(extra, found)) + tuple(
        port for port in found if not _is_among(port, extra)
    )


def device_of(name: str) -> str:
    """The device behind a port's name, the same for all its names: links, and tty. and cu."""
    on_mac = _MAC.fullmatch(name)
    return on_mac[2] if on_mac else os.path.realpath(name)


_NO_PORT = "is not a serial port; list the ports with: so101 ports"


def port_problem(name: str) -> str | None:
    """The reason why a port cannot be opened and what to do, found without opening it; or None."""
    if sys.platform == "win32":
        return None  # ports are no files there; opening will tell
    if not os.path.exists(name):
        return open_error_text(name, FileNotFoundError(errno.ENOENT, "no such port"))
    if os.path.isdir(name):
        return _NO_PORT
    if not os.access(name, os.R_OK | os.W_OK):
        return open_error_text(name, PermissionError(errno.EACCES, "permission denied"))
    # A pseudo-terminal is also open in the program behind it, say an emulator; opening will tell.
    if not os.path.realpath(name).startswith("/dev/pts/") and programs_using(name):
        return open_error_text(name, OSError(errno.EBUSY, "in use"))
    return None


def programs_using(name: str) -> list[str]:
    """The programs that have the port open, e.g. ``python3 (process 4711)``, where permitted.

    The program behind a pseudo-terminal, such as an emulator, is not one of them.
    """
    device = os.path.realpath(name)
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            opened = {os.path.realpath(link) for link in (process / "fd").iterdir()}
            is_own = int(process.name) == os.getpid()
            if device in opened and (is_own or not opened & {"/dev/ptmx", "/dev/pts/ptmx"}):
                command = (process / "comm").read_text().strip()
                own = ", this program" if is_own else ""
                found.append(f"{command} (process {process.name}{own})")
    return found


def open_error_text(name: str, error: Exception) -> str:
    """The reason and what to do, as text, for an error of opening a port."""
    number = error.errno if isinstance(error, OSError) else None
    if hidden := re.search(r"Error\((\d+), ", str(error)):  # pyserial on Windows has it in the text
        number = int(hidden[1])
    if remote := re.fullmatch(r"\w+://([^/?#]+).*", name):
        return (
            "a port must be a device of this computer; serve that one as raw TCP, bridge it:"
            f" socat pty,link=/tmp/so101,rawer tcp:{remote[1]},nodelay (docs/hardware.md)"
        )
    is_other = "Inappropriate ioctl" in str(error)  # pyserial hides the number
    if is_other or number in (errno.ENOTTY, errno.EISDIR):
        return _NO_PORT
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        lost = adapters_without_port()
        if sys.platform != "win32" and re.fullmatch(r"COM\d+", name, re.IGNORECASE):
            lost = ("in WSL2 it is a /dev/ttyACM0, once usbipd attach --wsl has handed it over",)
        return "there is no such port; " + (lost[0] if lost else "check the USB cable and the name")
    if number in (errno.EACCES, errno.EPERM):
        return _not_allowed(name)
    if number in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK):
        by = ", ".join(programs_using(name)) or "another program"
        return f"in use by {by}; end that program first"
    return f"cannot be opened: {error}"


def _not_allowed(name: str) -> str:
    if sys.platform == "win32":  # which says this of a port that is open elsewhere
        return "in use by another program; end that program first"
    group = _USUAL_GROUP
    with contextlib.suppress(OSError, KeyError):
        import grp

        group = grp.getgrgid(os.stat(name).st_gid).gr_name
    if group == "root":  # no rule of the system has given it to a group
        return "not allowed, it belongs to root alone; install the udev rule: so101 install-udev"
    return (
        f"not allowed; add yourself to the group that owns it (sudo usermod -aG {group} $USER) and"
        " log in again"
    )


def adapters_without_port(*, usb: Path = _USB, processes: Path = _PROCESSES) -> tuple[str, ...]:
    """List servo adapters that are plugged in but have no serial port, and what to do about each.

    Linux only; elsewhere there are none.
    """
    found = []
    why = "its driver is missing (try sudo modprobe ch341 cdc_acm cp210x ftdi_sio)"
    if "brltty" in _running(processes):
        why = (
            "brltty, which drives Braille displays, has taken it for one. Unless you use one,"
            " remove it (sudo apt remove brltty) and plug the adapter in again"
        )
    for device in sorted(usb.glob("*")):
        try:
            ids = tuple(int((device / name).read_text(), 16) for name in ("idVendor", "idProduct"))
        except (OSError, ValueError):
            continue
        if ids in ADAPTERS and not any(device.glob("*/tty*")):
            chip = f"a {ADAPTERS[ids]} adapter ({ids[0]:04x}:{ids[1]:04x})"
            found.append(f"{chip} is plugged in, but there is no serial port for it: {why}")
    return tuple(found)


# This computer


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
    running = _running(processes)
    return {name: harm for name, harm in _INTERFERING.items() if name in running}


def _running(processes: Path) -> set[str]:
    running = set()
    for comm in processes.glob("[0-9]*/comm"):
        with contextlib.suppress(OSError):  # it has ended
            running.add(comm.read_text().strip())
    return running


def latency_timer(port: str, ttys: Path = _TTYS) -> float | None:
    """How long an FTDI adapter holds bytes back [s]; None for others, which have no such timer.

    Opening the port with this package sets it to 1 ms where that is allowed.
    """
    device = os.path.basename(os.path.realpath(port))
    try:
        return float((ttys / device / "device" / "latency_timer").read_text()) / 1000.0
    except (OSError, ValueError):
        return None


# Names


def _describe(group: list[Any], shares: dict[int, bool], links: Path) -> FoundPort:
    port = group[0]
    serial_number = None if shares[id(port)] else port.serial_number
    by_id, by_path = (
        _links_to(port.device, links / "by-id"),
        _links_to(port.device, links / "by-path"),
    )
    lasting = by_id if serial_number else by_path
    name = lasting[0] if lasting else str(port.device)
    known = ADAPTERS.get((port.vid, port.pid))
    others = [str(other.device) for other in group] + by_id + by_path
    return FoundPort(
        name=name,
        device=str(port.device),
        key=_key(serial_number, port.location, str(port.device)),
        aliases=tuple(other for other in dict.fromkeys(others) if other != name),
        description=str(port.product or known or "USB serial port"),
        serial_number=serial_number,
        is_servo_adapter=known is not None,
    )


def _shares_serial_number(port: Any, serial_numbers: Counter[Any]) -> bool:
    same = serial_numbers[(port.vid, port.pid, port.serial_number)]
    return not port.serial_number or (same > 1 and _MAC.fullmatch(str(port.device)) is None)


def _merge(listed: Iterable[Any]) -> list[list[Any]]:
    """Group the entries of the same port, the best name first."""
    groups: dict[str, list[Any]] = {}
    for port in listed:
        groups.setdefault(device_of(str(port.device)), []).append(port)
    return [
        sorted(group, key=lambda port: _mac_rank(str(port.device))) for group in groups.values()
    ]


def _mac_rank(device: str) -> tuple[bool, int]:
    """``cu`` before ``tty``, which waits for a modem; the system's driver before a vendor's."""
    form = _MAC.fullmatch(device)
    return (device.startswith("/dev/tty."), _MAC_DRIVERS.index(form[1]) if form else 0)


def _links_to(device: str, folder: Path) -> list[str]:
    target = os.path.realpath(device)
    if not folder.is_dir():
        return []
    return sorted(str(link) for link in folder.iterdir() if os.path.realpath(link) == target)


def _key(serial_number: str | None, location: str | None, device: str) -> str:
    if serial_number:
        text = serial_number
    elif location:
        text = f"usb-{location}"
    else:
        text = re.sub(r"^(cu|tty)\.", "", os.path.basename(device))
    plain = re.sub(r"[^A-Za-z0-9_]+", "-", text).strip("-")
    return plain[-_LONGEST_KEY:].strip("-") or "port"


def _rank(port: FoundPort) -> tuple[bool, list[str | int]]:
    # "ttyACM10" after "ttyACM9"
    parts = re.split(r"(\d+)", port.device)
    return not port.is_servo_adapter, [int(p) if p.isdigit() else p for p in parts]


def _named_by_user(extra: Iterable[str], found: list[FoundPort]) -> Iterable[FoundPort]:
    for name in dict.fromkeys(extra):
        known = next((port for port in found if _is_among(port, (name,))), None)
        if known is None:
            yield FoundPort(name=name, device=os.path.realpath(name), key=_key(None, None, name))
            continue
        others = (known.name, known.device, *known.aliases)
        aliases = tuple(other for other in dict.fromkeys(others) if other != name)
        yield replace(known, name=name, aliases=aliases)


def _is_among(port: FoundPort, names: Iterable[str]) -> bool:
    own = {port.name, port.device, *port.aliases, os.path.realpath(port.device)}
    return any(name in own or os.path.realpath(name) in own for name in names)
