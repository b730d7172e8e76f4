"""The pages of motors, chain and calibration: the panels of their operations."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import viser

from so101_motion.calib.procedure.steps import State
from so101_motion.common.operation import Operation, View
from so101_motion.setup.checkup import Check
from so101_motion.setup.setup_steps import ASSEMBLY, CHAIN, MOTORS, SetupStep

from ..page.operation_panel import OperationPanel
from .page import StepPage
from .setup_context import SetupContext
from .setup_target import SetupTarget


class OperationPage(StepPage):
    """The page of a step that an operation does.

    Args:
        operation: Which of the target's operations.
        aborted: How the arm is left by an abort when no calibration is under way.
    """

    def __init__(
        self,
        setup: SetupContext,
        step: SetupStep,
        operation: Callable[[SetupTarget], Operation | None],
        aborted: str,
    ) -> None:
        super().__init__(setup, step)
        self._of, self._aborted = operation, aborted
        self._checked: Check | None = None
        self._panel = OperationPanel(
            setup.context, self._operation, worker=setup, draw=self._draw, hides_cancel=True
        )

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        self._panel.build(gui)

    def enter(self) -> None:
        """Do nothing; the panel shows the operation as it is."""

    def refresh(self) -> bool:
        """Look at the operation, and at what keeps its step from being left: it may come later."""
        before, self._checked = self._checked, self.check()
        return self._panel.refresh() or self._checked != before

    def show(self) -> None:
        """Show it."""
        self._panel.show()

    def is_next_due(self) -> bool:
        """Whether nothing is left to do here."""
        operation = self._operation()
        return operation is None or operation.view.is_over or self.check().verdict == "ok"

    def _operation(self) -> Operation | None:
        target = self._setup.target
        return None if target is None else self._of(target)

    def _ask(self, command: str, doing: str) -> None:
        operation = self._operation()
        if operation is not None:
            self._setup.do(doing, partial(operation.ask, command))

    def _draw(self, view: View) -> None:
        if view.picture is not None:
            self._setup.picture.draw(view.picture)

    def _as_it_was(self) -> str:
        return self._aborted


class CalibrationPage(OperationPage):
    """The page of one step of the calibration."""

    def __init__(self, setup: SetupContext, step: SetupStep) -> None:
        super().__init__(setup, step, lambda target: target.calibration, "nothing was changed")

    def enter(self) -> None:
        """Start recording, if it is time, because that writes nothing."""
        target = self._setup.target
        if target is None:
            return
        now = target.situation
        if self._step.name == "record" and now.view.state is State.HOMED:
            self._ask("start_range_recording", "beginning to record")
        if self._step.name == "save" and self._setup.saved is None:
            self._setup.saved = now.saved

    def refresh(self) -> bool:
        """Look at the calibration; note what it has saved."""
        news, operation = super().refresh(), self._operation()
        if operation is not None:
            view = operation.view
            if view.state != State.IDLE.value:
                self._setup.saved = None
                if self._setup.target is not None and self._setup.target.test is not None:
                    self._setup.target.test.forget()
            elif view.is_over:
                self._setup.saved = view.facts["calibration_file"]
        return news

    def _as_it_was(self) -> str:
        target = self._setup.target
        return self._aborted if target is None else target.situation.untouched


def motors_page(setup: SetupContext) -> OperationPage:
    """The page of the motor step; it looks for motors while it is shown."""
    left = "nothing moved; motors that got their ids keep them, the others are unchanged"
    return OperationPage(setup, MOTORS, lambda target: target.motors, left)


def assembly_page(setup: SetupContext) -> OperationPage:
    """The page of the assembly step."""
    left = "nothing was changed, and nothing was moved"
    return OperationPage(setup, ASSEMBLY, lambda target: target.assembly, left)


class ChainPage(OperationPage):
    """The page of the chain step."""

    def __init__(self, setup: SetupContext) -> None:
        left = "nothing was changed, and nothing was moved"
        super().__init__(setup, CHAIN, lambda target: target.chain, left)

    def enter(self) -> None:
        """Verify at once, which writes nothing; not while the chain is still to be made."""
        target = self._setup.target
        if target is None or target.is_under_way:
            return
        now = target.situation
        if now.checked is not None or now.setup.next_joint is not None:
            self._ask("verify", "looking at all six motors")

    def can_go_on(self) -> str | None:
        """Why the chain is not ready."""
        target = self._setup.target
        return None if target is not None and target.is_under_way else super().can_go_on()
