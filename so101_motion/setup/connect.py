"""The choice of the port as an operation; all ports are looked at again and again."""

from __future__ import annotations

import time
from collections.abc import Callable

from so101_motion.common.errors import ConfigError
from so101_motion.common.operation import LocalOperation, Offer, Row, View
from so101_motion.setup.checkup import Check, Findings, fail
from so101_motion.setup.port_selection import Candidate, PortsSeen
from so101_motion.setup.setup_steps import CONNECT, SetupState

PERIOD = 1.0
"""How long to wait between two looks [s]; chosen: soon enough for somebody who plugs a cable in."""

_MOST_PORTS = 6  # to choose from; chosen: nobody has more arms on one computer
_BARE = (
    "With a new kit this is fine: its motors are connected later, one at a time. With an assembled"
    " arm, first do what is said above."
)


class ConnectOperation(LocalOperation):
    """Has a person choose the port of the arm."""

    def __init__(
        self, look: Callable[[], PortsSeen], now: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__()
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
            text=CONNECT.instruction,
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
    about = " · ".join(filter(None, (candidate.name, report.port.description)))
    return Row(
        label=report.port.device[-24:],
        cells=volts,
        text=f"{report.sentence}. {about}",
        mark="●" if is_chosen else "○",
        tone="bad" if report.supply_trouble else "good" if is_chosen else "dim",
    )
