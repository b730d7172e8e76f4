"""Choose the port and the calibration file that a verb uses, and open the port's bus."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from so101_motion.common.errors import PortUnavailable

if TYPE_CHECKING:
    from so101_motion.rig.bus_lease import BusLease
    from so101_motion.rig.hardware_rig import HardwareRig
    from so101_motion.setup.discovery import PortReport


def look_at(port: str) -> PortReport:
    """Report what is connected to this port; touches no other."""
    from so101_motion.drivers.port.port_list import find_ports, port_problem
    from so101_motion.setup.discovery import discover

    (report,) = discover((port,), find=lambda extra: find_ports(extra)[:1]).reports
    reason = port_problem(port)
    if reason is not None:
        raise PortUnavailable(port, reason)
    return report


def find_arm(port: str | None) -> PortReport:
    """Find the port to use: the named one, else the only one with an arm."""
    return _found(port, "arm", lambda report: report.has_arm)


def find_to_examine(port: str | None) -> PortReport:
    """Find the port to examine: the one with an arm, else the only servo adapter's."""
    try:
        return find_arm(port)
    except PortUnavailable as error:
        if port is not None:
            raise
        try:
            return find_adapter(None)
        except PortUnavailable:
            raise error from None


def find_adapter(port: str | None) -> PortReport:
    """Find the port to set up servos on: the named one, else the only servo adapter's."""
    from so101_motion.drivers.port.port_list import port_problem

    return _found(
        port,
        "servo adapter",
        lambda report: report.port.is_servo_adapter and port_problem(report.port.name) is None,
    )


def calibration_file(given: str | None, report: PortReport) -> Path:
    from so101_motion.calib.record import store
    from so101_motion.setup import connect

    return store.resolve(given) if given is not None else connect.calibration_file(report)


def _found(port: str | None, what: str, is_meant: Callable[[PortReport], bool]) -> PortReport:
    from so101_motion.setup.discovery import discover

    if port is not None:
        return look_at(port)
    found = discover()
    meant = [report for report in found.reports if is_meant(report)]
    if not meant:
        sentences = [f"{report.port.name}: {report.sentence}" for report in found.reports]
        raise PortUnavailable(f"no {what}", ". ".join((*sentences, *found.notes)))
    if len(meant) > 1:
        named = ", or ".join(f"--port {report.port.name} ({report.sentence})" for report in meant)
        raise click.UsageError(f"there are several {what}s; give {named}")
    return meant[0]


@contextmanager
def lent_bus(report: PortReport, purpose: str) -> Iterator[tuple[HardwareRig, BusLease]]:
    """Borrow the bus of a port; no joint moves, and an arm that holds goes on holding."""
    from so101_motion.rig.hardware_rig import open_hardware
    from so101_motion.rig.port_settings import ServoSettings

    asked = ServoSettings(port=report.port.name, baudrate=report.baudrate, timeout=None)
    with closing(open_hardware(asked)) as rig:
        lease = rig.lend_bus(purpose)
        try:
            yield rig, lease
        finally:
            lease.abandon()
