"""What all pages of the setup share: the arm, what is known of it, and one worker thread."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace

from so101_motion.calib.motors.setup_view import SetupProgress
from so101_motion.common.modes import Mode
from so101_motion.setup.checkup import Check, Findings
from so101_motion.setup.motor_operation import MotorOperation
from so101_motion.setup.setup_steps import SetupState

from ..page.operation_panel import Worker
from ..page.page_context import PageContext
from ..server.host import ServedPage
from .picture import Picture
from .setup_target import SetupTarget

SETTLED = 0.4
"""How long readings must be missing before the text changes [s]; chosen. A search for motors takes
the port through other baud rates, and a busy computer loses answers; for that moment the torque is
unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TorqueText:
    """The text and its tone."""

    text: str
    is_on: bool | None = None  # whether any motor drives its joint; None if that is not known


def torque(target: SetupTarget | None) -> TorqueText:
    if target is None:
        return TorqueText(text="Torque not known: no arm yet")
    now = target.situation
    if not now.is_connected:
        return TorqueText(text="Torque not known: no connection")
    if now.holds is None:
        return TorqueText(text="Torque not known yet")
    if target.rig is not None and target.rig.arm.state.mode is Mode.GUIDING:
        return TorqueText(text="Guided by hand", is_on=True)
    if now.holds:
        return TorqueText(text="Torque on: the joints are held", is_on=True)
    return TorqueText(text="Torque off: the joints are limp", is_on=False)


class TorqueWatch:
    """Keeps the text while readings are missing for a moment."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.shown = torque(None)
        self._now, self._known_at = now, now()

    def look(self, target: SetupTarget | None, *, is_blind: bool) -> bool:
        """Read the torque again, unless motors are searched for; return whether it changed."""
        seen, before, t = torque(target), self.shown, self._now()
        is_lost = target is not None and seen.is_on is None and before.is_on is not None
        if is_blind or not is_lost:
            self._known_at = t
        if not is_lost or t - self._known_at >= SETTLED:
            self.shown = seen
        return self.shown != before


ServesPreview = Callable[..., ServedPage]  # serves a preview of an arm: ``so101_viewer.serve``


@dataclass(slots=True, kw_only=True)
class SetupContext(Worker):
    """What all pages share. Its fields belong to the page's thread."""

    context: PageContext  # the page; presses go through it
    picture: Picture
    progress: SetupProgress
    # serves a preview of the arm; None where the page shows the arm already
    preview: ServesPreview | None = None
    target: SetupTarget | None = None  # the arm that is set up; None until the connection is made
    # what was found on the port, and about the motors of the finished chain
    seen: Findings = field(default_factory=Findings)
    saved: str | None = None  # where this setup has saved a calibration; None before
    # what else was opened, to be closed with the setup
    opened: ExitStack = field(default_factory=ExitStack)
    port: str | None = None  # the port of the last target on this computer; None before
    torque: TorqueWatch = field(default_factory=TorqueWatch)

    @property
    def tested(self) -> Check | None:
        report = None
        if self.target is not None and self.target.test is not None:
            report = self.target.test.report
        if report is None:
            return None
        return Check(name="test", verdict=report.verdict, sentence=report.sentence, fix=report.fix)

    @property
    def known(self) -> SetupState:
        if self.target is None:
            return SetupState(seen=self.seen, saved=self.saved)
        now = self.target.situation
        return SetupState(
            seen=replace(self.seen, servos=now.checked),
            setup=now.setup,
            view=now.view,
            saved=self.saved,
            tested=self.tested,
        )

    def work_on(self, target: SetupTarget) -> None:
        self.target = target
        if not target.is_remote:
            self.port = target.where
        self.progress.work_on(target.where)
        if isinstance(target.motors, MotorOperation):  # a machine remembers by itself
            target.motors.keep_in(self.progress)

    def put_away(self) -> None:
        target, self.target = self.target, None
        self.seen, self.saved = Findings(), None
        if target is not None:
            self._workers.submit(target.close)

    def close(self) -> None:
        self.opened.close()
        self.put_away()
        self.end()
