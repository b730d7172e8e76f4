"""Choose the port and the calibration file when nobody names them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from so101_motion.common.errors import PortUnavailable

if TYPE_CHECKING:
    from so101_motion.setup.discovery import Discovery
    from so101_motion.setup.port_report import PortReport


def look_at(port: str) -> PortReport:
    """What is on this port; no other is touched."""
    from so101_motion.drivers.port.port_list import find_ports, port_problem
    from so101_motion.setup.discovery import discover

    (report,) = discover((port,), find=lambda extra: find_ports(extra)[:1]).reports
    reason = port_problem(port)
    if reason is not None:
        raise PortUnavailable(port, reason)
    return report


def find_arm(port: str | None) -> PortReport:
    """The port to use: the one that is named, else the only one with an arm.

    Raises:
        PortUnavailable: There is none, or it cannot be used.
        click.UsageError: There are several.
    """
    if port is not None:
        return look_at(port)
    from so101_motion.setup.discovery import discover

    found = discover()
    arms = [report for report in found.reports if report.has_arm]
    if not arms:
        raise PortUnavailable("no arm", _why_none(found))
    return _only(arms)


def find_patient(port: str | None) -> PortReport:
    """The port to look at when something may be wrong: an arm's, else the only servo adapter's.

    Raises:
        PortUnavailable: There is none, or it cannot be used.
        click.UsageError: There are several.
    """
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
    """The port to set servos up on: the one that is named, else the only servo adapter.

    Raises:
        PortUnavailable: There is none, or it cannot be used.
        click.UsageError: There are several.
    """
    from so101_motion.drivers.port.port_list import port_problem
    from so101_motion.setup.discovery import discover

    if port is not None:
        return look_at(port)
    found = discover()
    adapters = [
        report
        for report in found.reports
        if report.port.is_servo_adapter and port_problem(report.port.name) is None
    ]
    if not adapters:
        raise PortUnavailable("no servo adapter", _why_none(found))
    return _only(adapters)


def calibration_file(given: str | None, report: PortReport) -> Path:
    """Where the calibration of what is on a port is saved: what is given, else see ``adapters``.

    Raises:
        CalibrationError: It cannot be a path, or this user has no home.
    """
    from so101_motion.calib.record import store
    from so101_motion.setup import port_selection as adapters

    return store.resolve(given) if given is not None else adapters.calibration_file(report)


def _why_none(found: Discovery) -> str:
    said = [f"{report.port.name}: {report.sentence}" for report in found.reports]
    return ". ".join((*said, *found.notes))


def _only(reports: list[PortReport]) -> PortReport:
    if len(reports) > 1:
        named = ", or ".join(f"--port {report.port.name} ({report.sentence})" for report in reports)
        raise click.UsageError(f"which of these is meant? give {named}")
    return reports[0]
