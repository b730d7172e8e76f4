"""The choice of the port as an operation that looks again and again; the arm's calibration file."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path

from so101_motion.common.errors import ConfigError
from so101_motion.common.operation import LocalOperation, Offer, Row, View
from so101_motion.drivers.bus.bus import REPLY_TIMEOUT
from so101_motion.drivers.port import port_list
from so101_motion.files import user_storage
from so101_motion.setup.checkup import Check, Findings, fail
from so101_motion.setup.discovery import PortReport, discover, file_name
from so101_motion.setup.setup_steps import CONNECT, SetupState

PERIOD = 1.0
"""How long to wait between two looks [s]; chosen: soon enough for somebody who plugs a cable in."""

_MOST_PORTS = 6  # to choose from; chosen: nobody has more arms on one computer
_BARE = (
    "With a new kit this is fine: its motors are connected later, one at a time. With an assembled"
    " arm, first do what is said above."
)
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
        return report.calibration or user_storage.folder() / file_name(report.port)
    name = user_storage.checked_name(name, what="arm")
    if not _ARM_NAME.fullmatch(name):
        raise ConfigError("arm name", name, "must be letters, digits, spaces and _ -")
    user_storage.refuse_reserved(name, what="arm name")
    file = user_storage.folder() / f"{name}_calibration.json"
    if file.exists() and file != report.calibration:
        raise ConfigError("arm name", name, "is another arm's already; choose another name")
    return file


class ConnectOperation(LocalOperation):
    """Has a person choose the port of the arm."""

    def __init__(
        self,
        look: Callable[[], PortsSeen],
        instruction: str = CONNECT.instruction,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self._instruction = instruction
        self._look_at_ports, self._now, self._looked_at = look, now, now() - PERIOD
        self.seen: PortsSeen | None = None
        self.picked: str | None = None
        self.commands = {"look": self._look, "use": self._use}

    @property
    def chosen(self) -> Candidate | None:
        """The picked port, else the only one that can be used, or the only one there."""
        if self.seen is None:
            return None
        candidates = self.seen.candidates
        usable = [each for each in candidates if not each.findings.port_trouble]
        for few in ([each for each in candidates if each.name == self.picked], usable, candidates):
            if len(few) == 1:
                return few[0]
        return None

    @property
    def findings(self) -> Findings:
        chosen = self.chosen
        if chosen is not None:
            return chosen.findings
        return Findings() if self.seen is None else self.seen.nothing

    @property
    def check(self) -> Check:
        if self.seen is None:
            return Check(name="connect", verdict="fail", sentence="looking at the ports")
        count = len(self.seen.candidates)
        if self.chosen is None and count > 1:
            fix = "choose the port of the arm to set up"
            return fail("connect", f"there are {count} ports", fix)
        return CONNECT.check(SetupState(seen=self.findings))

    @property
    def view(self) -> View:
        seen, chosen, check = self.seen, self.chosen, self.check
        candidates = () if seen is None else seen.candidates[:_MOST_PORTS]
        is_wrong = seen is not None and check.verdict == "fail"
        rows = [_row(each, is_chosen=each is chosen) for each in candidates]
        if seen is not None and check.verdict == "warn":
            text = f"{check.sentence}. {check.fix}"
            rows.append(Row(label="Warning", mark="!", tone="warm", text=text))
        elif seen is not None and not is_wrong and not rows:
            rows.append(Row(label="Connected", mark="✓", tone="good", text=check.sentence))
        due = max(self._looked_at + PERIOD - self._now(), 0.0)
        others = [each.name for each in candidates if each is not chosen and len(candidates) > 1]
        return View(
            state="connect",
            title=CONNECT.title,
            text=self._instruction,
            rows=tuple(rows),
            trouble=check.sentence if is_wrong else "",
            fix=check.fix if is_wrong else "",
            note=_BARE if chosen is not None and not chosen.report.servo_ids else "",
            doing=check.sentence if seen is None else "",
            offers=(
                *(Offer(command="use", title=f"Use {n}", arguments={"port": n}) for n in others),
                Offer(command="look", title="Look again", due_in=due, is_look=True),
            ),
            is_over=check.verdict != "fail",
        )

    def _look(self) -> None:
        try:
            self.seen = self._look_at_ports()
        finally:
            self._looked_at = self._now()

    def _use(self, port: str) -> None:
        there = [] if self.seen is None else [each.name for each in self.seen.candidates]
        if port not in there:
            raise ConfigError("port", port, f"must be one of {', '.join(there)}")
        self.picked = port


def _row(candidate: Candidate, *, is_chosen: bool) -> Row:
    report = candidate.report
    volts: tuple[str, ...] = ()
    if report.volts is not None and report.nominal_volts is not None:
        volts = (f"{report.volts:.1f} V for a {report.nominal_volts:g} V arm",)
    about, is_arm = report.port.description, report.servo_ids or report.in_use
    return Row(
        label=(report.port.device if about else candidate.name)[-24:],
        cells=volts,
        text=f"{report.sentence}. {candidate.name} · {about}" if about else report.sentence,
        mark="●" if is_chosen else "○",
        tone="bad" if report.supply_trouble else "good" if is_chosen and is_arm else "dim",
    )
