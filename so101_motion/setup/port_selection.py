"""List the ports that an arm may be on, with their problems, and choose its calibration file."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

from so101_motion.calib.record import versions
from so101_motion.common.errors import CalibrationError, ConfigError
from so101_motion.drivers.bus.bus import REPLY_TIMEOUT as REPLY_TIMEOUT
from so101_motion.drivers.port import port_list
from so101_motion.files import user_storage
from so101_motion.setup.checkup import Findings
from so101_motion.setup.discovery import PortReport, discover, file_name

_ARM_NAME = re.compile(r"\w[\w -]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A port that servos may be connected to."""

    report: PortReport
    findings: Findings

    @property
    def name(self) -> str:
        return self.report.port.name


@dataclass(frozen=True, slots=True, kw_only=True)
class PortsSeen:
    """The ports that are plugged in now."""

    # the ports with servo adapters and those that were named, the likeliest first
    candidates: tuple[Candidate, ...] = ()
    nothing: Findings = field(default_factory=Findings)  # findings to show if there is no candidate


def look(named: Collection[str] = (), *, reply_timeout: float = REPLY_TIMEOUT) -> PortsSeen:
    """Look at the named ports, or at all adapters; takes as long as ``discover``."""
    found = discover(named, reply_timeout=reply_timeout)
    lost = port_list.adapters_without_port()
    candidates = tuple(
        Candidate(report=report, findings=about(report))
        for report in found.reports
        if report.port.name in named or (not named and report.port.is_servo_adapter)
    )
    others = [f"{report.port.name}: {report.sentence}" for report in found.reports]
    return PortsSeen(
        candidates=candidates,
        nothing=Findings(
            port_trouble=". ".join((*others, *(note for note in found.notes if note not in lost))),
            lost_adapters=lost,
        ),
    )


def about(report: PortReport) -> Findings:
    name = report.port.name
    return Findings(
        port=name,
        baudrate=report.baudrate,
        agreeing_file=report.agreeing,
        adapter=report.port.description,
        port_trouble="" if report.in_use else port_list.port_problem(name) or "",
        supply_trouble=report.supply_trouble,
        interfering_programs={}
        if port_list.is_rule_installed()
        else port_list.interfering_programs(),
        lost_adapters=port_list.adapters_without_port(),
        latency_timer=port_list.latency_timer(name),
    )


def calibration_file(report: PortReport, name: str = "") -> Path:
    """The path of the calibration of the arm on a port.

    That is the arm's present file, if one agrees with its servos or has its name; else one in the
    user's data directory, named after the adapter.
    """
    if not name.strip():
        return report.calibration or own_folder() / file_name(report.port)
    name = user_storage.checked_name(name, what="arm")
    if not _ARM_NAME.fullmatch(name):
        raise ConfigError("arm name", name, "must be letters, digits, spaces and _ -")
    user_storage.refuse_reserved(name, what="arm name")
    file = own_folder() / f"{name}_calibration.json"
    if file.exists() and file != report.calibration:
        raise ConfigError("arm name", name, "is another arm's already; choose another name")
    return file


def own_folder() -> Path:
    try:
        return versions.root().parent
    except OSError as error:
        raise CalibrationError(
            None, f"there is no home directory: {error}", "name a file"
        ) from error
