"""Serve the setup on a page of its own: ``so101 setup --web``. No arm is needed yet."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.calib.motors.setup_view import PROGRESS_FILE, SetupProgress
from so101_motion.calib.procedure.steps import State
from so101_motion.common.errors import MotionError, So101Error
from so101_motion.common.modes import Mode
from so101_motion.drivers.bus.bus import REPLY_TIMEOUT
from so101_motion.files import user_storage
from so101_motion.rig.protocols import RigLike
from so101_motion.setup.calibrator import StepResult
from so101_motion.viam.client import Machine

from .app import serve
from .page import texts
from .page.bar import BarButton, add_stop
from .page.guiding import Guiding
from .page.page_context import PageContext, Part
from .page.screen_state import Sentence
from .panels.health_panel import SILENCE, read_health, servo_alarms
from .scene.camera_and_lights import Sight, set_up_view
from .server.guarded_server import GuardedServer, start_guarded
from .server.host import ServedPage
from .setup.part import SetupPart
from .setup.setup_context import ArmSource, SetupContext, SetupTarget, known_arm
from .setup.setup_context import ports as ports_of

_SIGHT = Sight(middle=np.array([0.1, 0.0, 0.17]))
"""Higher than for other pages, so that an arm stretched upwards is in the picture."""

_CALIBRATED = "A calibration is under way: the joints stay limp until you save or abort it."
_SILENT = "Not all six motors answer yet."
_NOT_CALIBRATED = "Only a calibrated arm can carry its weight: save a calibration first."


class SetupApp(ServedPage):
    """A served setup; closing it undoes a running calibration."""

    def __init__(
        self,
        server: GuardedServer,
        *,
        source: ArmSource,
        progress: SetupProgress,
    ) -> None:
        super().__init__(server)
        context = self.page_context()
        set_up_view(context.server, _SIGHT)
        part = SetupPart(context, source=source, progress=progress, preview=serve, resumes=True)
        self._setup = part.setup
        bar = SetupBar(context, self._setup, drop=self.drop_commands)
        self.windows.leave_open_as_stop(bar.button)
        self.add_parts(part, bar)
        self.start()

    @property
    def last_port(self) -> str | None:
        """The port of the last arm that was connected; None without one, or on a machine."""
        return self._setup.port


def serve_setup(
    *,
    ports: Collection[str] = (),
    reply_timeout: float = REPLY_TIMEOUT,
    machine: Machine | None = None,
    progress_file: Path | None = None,
    **where: Any,
) -> SetupApp:
    """Serve the setup app.

    Only ``ports`` are looked at, if any are given; a motor may take ``reply_timeout`` [s] to answer
    beyond the time on the wire. A ``machine`` needs a calibration sensor; its owner closes it.
    ``progress_file`` keeps the progress, by default the terminal's file. Other arguments and errors
    are those of ``start_guarded``; ``CalibrationError`` if this user has no place for files.
    """
    known = None if machine is None else known_arm(machine)
    source = known or ports_of(tuple(ports), reply_timeout)
    kept = SetupProgress(progress_file or user_storage.folder() / PROGRESS_FILE, source.where)
    server = start_guarded(label="SO-101 setup", **where)
    try:
        return SetupApp(server, source=source, progress=kept)
    except BaseException:
        server.close()
        raise


def reasons(target: SetupTarget | None, doing: str) -> tuple[str | None, str | None, str | None]:
    """Why the joints cannot be held, guided by hand, and let go of now; None if they can."""
    if target is None:
        return ("No arm is connected yet.",) * 3
    if target.rig is None:
        return ("The machine has no arm yet, so its joints cannot be held from here.",) * 3
    if not target.situation.is_connected:
        return ("There is no connection to the arm.",) * 3
    waits = f"Wait for the end of this: {doing}." if doing else None
    return (
        waits or _hold(target, target.rig),
        waits or _guide(target, target.rig),
        _let_go(target),  # at any moment
    )


def _hold(target: SetupTarget, rig: RigLike) -> str | None:
    now, mode = target.situation, rig.arm.state.mode
    if now.view.state is not State.IDLE:
        return _CALIBRATED
    if mode in (Mode.GUIDING, Mode.FAULT):
        return None
    if mode is not Mode.LIMP:
        return texts.HELD_ALREADY
    return _SILENT if any(joint.ticks is None for joint in now.joints.values()) else None


def _guide(target: SetupTarget, rig: RigLike) -> str | None:
    now = target.situation
    if now.view.state is not State.IDLE:
        return _CALIBRATED
    if now.saved is None:
        return _NOT_CALIBRATED
    return {**texts.CANNOT_GUIDE, Mode.LIMP: texts.HOLD_FIRST}.get(rig.arm.state.mode)


def _let_go(target: SetupTarget) -> str | None:
    holds = target.situation.holds
    return "No motor answers." if holds is None else None if holds else texts.LIMP_ALREADY


def alarms(target: SetupTarget | None) -> Iterator[Sentence]:
    """What is wrong with the servos; one may be silent until all six were seen together."""
    if target is not None and target.rig is not None:
        is_whole = target.situation.checked is not None
        for alarm in servo_alarms(read_health(target.rig).servos):
            if is_whole or alarm.cause != SILENCE:
                yield alarm.sentence


class SetupBar(Part):
    """Fills the bar of a setup."""

    def __init__(
        self, context: PageContext, setup: SetupContext, *, drop: Callable[[], None]
    ) -> None:
        self._context, self._setup, self._drop = context, setup, drop
        self._guiding: tuple[SetupTarget, Guiding] | None = None
        self._letting_go: Future[object] | None = None
        bar = self._bar = context.bar
        self.button = add_stop(context.gui, self._stop)
        bar.stop, bar.title = self.button, "SO-101 setup"
        bar.buttons = (
            self._button("Hold", self._hold),
            self._button("Guide by hand", self._guide),
            self._button("Let go", self._let_go),
        )
        bar.buttons[2].asks = texts.SINKS

    def _button(self, label: str, command: Callable[[], None]) -> BarButton:
        button = self._context.gui.add_button(label, visible=False)
        self._context.on_press(button, command)
        return BarButton(label=label, button=button)

    def refresh(self) -> bool:
        target = self._setup.target
        shown = self._setup.torque.shown.text
        self._bar.state = "Not connected yet" if target is None else shown
        self._bar.alert("servos", alarms(target))
        why_not = reasons(target, self._setup.doing)
        for button, why in zip(self._bar.buttons, why_not, strict=True):
            button.why_not = why
        try:
            if self._guiding is not None and self._guiding[0] is target:
                self._guiding[1].refresh()
            if self._letting_go is not None and self._letting_go.done():
                letting_go, self._letting_go = self._letting_go, None
                letting_go.result()
        except So101Error as error:
            self._setup.trouble = error
            return True
        return False

    def _hold(self) -> None:
        target = self._can(0)
        if target is not None:
            self._setup.do("holding the joints", partial(target.set_torque, True), self._held)

    def _held(self, ended: object) -> None:
        if isinstance(ended, StepResult) and ended.trouble:
            self._setup.trouble = MotionError(ended.trouble)

    def _let_go(self) -> None:
        target = self._can(2)
        if target is not None and self._letting_go is None:  # not on the setup's worker: at once
            self._letting_go = self._context.in_background(partial(target.set_torque, False))

    def _guide(self) -> None:
        target = self._can(1)
        if target is None or target.rig is None:
            return
        if self._guiding is None or self._guiding[0] is not target:
            rig = target.rig
            guiding = Guiding(rig.arm, rig.clock, self._context.in_background)
            self._guiding = (target, guiding)
        self._guiding[1].start()

    def _can(self, place: int) -> SetupTarget | None:
        target = self._setup.target
        return target if reasons(target, self._setup.doing)[place] is None else None

    def _stop(self) -> None:
        self._drop()
        target = self._setup.target
        if target is not None and target.rig is not None:
            target.rig.arm.stop()
            target.rig.gripper.stop()
