"""Serve the setup on a page of its own: ``so101 setup --web``. No arm is needed yet."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.calib.procedure.steps import State
from so101_motion.common.errors import MotionError, So101Error
from so101_motion.common.modes import Mode
from so101_motion.drivers.bus.bus import REPLY_TIMEOUT
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
        progress_file: Path | None,
    ) -> None:
        super().__init__(server)
        context = self.page_context()
        set_up_view(context.server, _SIGHT)
        part = SetupPart(context, source=source, progress_file=progress_file, preview=serve)
        self._setup = part.setup
        self.say = partial(setattr, part.setup, "trouble")
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
    server = start_guarded(label="SO-101 setup", **where)
    try:
        return SetupApp(server, source=source, progress_file=progress_file)
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
    now, mode = target.situation, target.rig.arm.state.mode
    waits = f"Wait for the end of this: {doing}." if doing else None
    waits = waits or (None if now.view.state is State.IDLE else _CALIBRATED)
    is_silent = any(joint.ticks is None for joint in now.joints.values())
    hold = {**texts.CANNOT_HOLD, Mode.LIMP: _SILENT if is_silent else None}.get(mode)
    guide = {**texts.CANNOT_GUIDE, Mode.LIMP: texts.HOLD_FIRST}.get(mode)
    let_go = None if now.holds else texts.LIMP_ALREADY  # at any moment
    return (
        waits or hold,
        waits or (guide if now.saved is not None else _NOT_CALIBRATED),
        let_go if now.holds is not None else "No motor answers.",
    )


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
        self._guiding: Guiding | None = None
        self._guided: SetupTarget | None = None
        bar = self._bar = context.bar
        self.button = add_stop(context.gui, self._stop)
        bar.stop, bar.title = self.button, "SO-101 setup"
        bar.buttons = (
            self._button("Hold", self._hold),
            self._button("Guide by hand", self._guide),
            self._button("Let go", self._let_go),
        )
        bar.buttons[2].asks = texts.SINKS

    def _button(self, label: str, command: Callable[[SetupTarget], object]) -> BarButton:
        def press() -> None:
            target = self._setup.target
            if target is not None and shown.why_not is None:
                command(target)

        button = self._context.button(label, press, visible=False)
        shown = BarButton(label=label, button=button)
        return shown

    def refresh(self) -> bool:
        target = self._setup.target
        shown = self._setup.torque.shown
        self._bar.state = "Not connected yet" if target is None else shown
        self._bar.alert("servos", alarms(target))
        why_not = reasons(target, self._setup.doing)
        for button, why in zip(self._bar.buttons, why_not, strict=True):
            button.why_not = why
        try:
            if self._guiding is not None and self._guided is target:
                self._guiding.refresh()
        except So101Error as error:
            self._setup.trouble = error
        return False

    def _hold(self, target: SetupTarget) -> None:
        self._setup.do("holding the joints", partial(target.set_torque, True), self._held)

    def _held(self, ended: object) -> None:
        if isinstance(ended, StepResult) and ended.trouble:
            self._setup.trouble = MotionError(ended.trouble)

    def _let_go(self, target: SetupTarget) -> None:
        """Let go at once, not on the setup's worker, which may be busy."""
        done = self._context.in_background(partial(target.set_torque, False))

        def tell() -> None:
            done.result()  # raises what it failed with, for the page to say

        done.add_done_callback(lambda _done: self._context.post(tell))

    def _guide(self, target: SetupTarget) -> None:
        if target.rig is not None and target is not self._guided:
            rig, self._guided = target.rig, target
            self._guiding = Guiding(rig.arm, rig.clock, self._context.in_background)
        if self._guiding is not None:
            self._guiding.start()

    def _stop(self) -> None:
        self._drop()
        target = self._setup.target
        if target is not None and target.rig is not None:
            target.rig.arm.stop()
            target.rig.gripper.stop()
