"""Fill the bar of a setup page without a preview: Stop, Hold, Guide by hand, Let go.

The buttons are those of every page, at the same places. Each says why it cannot be pressed.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

from so101_motion.calib.procedure.steps import State
from so101_motion.common.errors import MotionError, So101Error
from so101_motion.common.modes import Mode
from so101_motion.rig.protocols import RigLike
from so101_motion.setup.calibrator import StepResult

from ..page import texts
from ..page.bar import BarButton, add_stop
from ..page.guiding import Guiding
from ..page.page_context import PageContext
from ..page.part import Part
from .setup_context import SetupContext
from .setup_target import SetupTarget

_CALIBRATED = "A calibration is under way: the joints stay limp until you save or abort it."
_SILENT = "Not all six motors answer yet."
_NOT_CALIBRATED = "Only a calibrated arm can carry its weight: save a calibration first."


def reasons(target: SetupTarget | None, doing: str) -> tuple[str | None, str | None, str | None]:
    """Why the joints cannot be held, guided by hand, and let go of now; None if they can.

    Args:
        target: The arm; None before there is a connection.
        doing: What runs on the worker now; empty when nothing does.
    """
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


class SetupBar(Part):
    """Fills the bar of a setup.

    Attributes:
        button: What the bar's Stop presses.
    """

    def __init__(
        self, context: PageContext, setup: SetupContext, *, drop: Callable[[], None]
    ) -> None:
        self._context, self._setup, self._drop = context, setup, drop
        self._guiding: tuple[SetupTarget, Guiding] | None = None
        self._letting_go: Future[None] | None = None
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
        """Show the torque, and what can be pressed; end a guiding whose time is over."""
        target = self._setup.target
        shown = self._setup.torque.shown.text
        self._bar.state = "Not connected yet" if target is None else shown
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
            self._setup.do("holding the joints", target.hold, self._held)

    def _held(self, ended: object) -> None:
        if isinstance(ended, StepResult) and ended.trouble:
            self._setup.trouble = MotionError(ended.trouble)

    def _let_go(self) -> None:
        target = self._can(2)
        if target is not None and self._letting_go is None:  # not on the setup's worker: at once
            self._letting_go = self._context.in_background(target.let_go)

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
        """The arm, unless the button at ``place`` has just become grey."""
        target = self._setup.target
        return target if reasons(target, self._setup.doing)[place] is None else None

    def _stop(self) -> None:
        self._drop()
        target = self._setup.target
        if target is not None and target.rig is not None:
            target.rig.arm.stop()
            target.rig.gripper.stop()
