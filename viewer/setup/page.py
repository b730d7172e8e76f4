"""The pages of the setup's steps.

A page shows one step of ``so101_motion.setup.setup_steps``, most by the panel of the step's
operation. It never waits: calls to motors run on a worker thread, and ``refresh`` takes in the
result. All pages work for every browser at once and keep nothing in the browser, so a reload loses
nothing. All methods but ``abort`` run on the page's thread.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import viser

from so101_motion.calib.procedure.steps import State
from so101_motion.common.operation import Operation, View
from so101_motion.setup.checkup import Check
from so101_motion.setup.setup_steps import CHAIN, SetupStep

from ..page.operation_panel import OperationPanel
from .setup_context import SetupContext
from .setup_target import SetupTarget


class StepPage:
    """The page of one step.

    Args:
        setup: What all pages share.
        operation: Which of the target's operations does the step.
        left: How an abort leaves the arm when no calibration is under way, in words.
    """

    def __init__(
        self,
        setup: SetupContext,
        step: SetupStep,
        operation: Callable[[SetupTarget], Operation | None] = lambda _target: None,
        left: str = "nothing was changed, and nothing was moved",
    ) -> None:
        self._setup, self._step, self._of, self._left = setup, step, operation, left
        self._checked: Check | None = None
        self._panel = OperationPanel(
            setup.context, lambda: self.operation, worker=setup, draw=self._draw, hides_cancel=True
        )

    @property
    def operation(self) -> Operation | None:
        """The operation that does the step; None without an arm."""
        target = self._setup.target
        return None if target is None else self._of(target)

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets, once, where the caller has put the cursor."""
        self._panel.build(gui)

    def enter(self) -> None:
        """Start the step, also when it is entered again."""

    def leave(self) -> None:
        """Leave the step; nothing of it may continue."""

    def refresh(self) -> bool:
        """Take in changes since the last call; return whether there is anything new to show."""
        before, self._checked = self._checked, self.check()  # what keeps it from being left
        return self._panel.refresh() or self._checked != before

    def show(self) -> None:
        """Update widgets and picture."""
        self._panel.show()

    def check(self) -> Check:
        """The workflow's own check of this step."""
        return self._step.check(self._setup.known)

    def can_go_on(self) -> str | None:
        """Why Next is not allowed yet, as a sentence; None if it is."""
        check = self.check()
        return check.sentence if check.verdict == "fail" else None

    def next_label(self) -> str:
        """What Next says, unless the setup ends with it."""
        return "Next"

    def is_next_due(self) -> bool:
        """Whether Next is what to press now; else it is grey, though it may be pressed."""
        operation = self.operation
        return operation is None or operation.view.is_over or self.check().verdict == "ok"

    def abort(self) -> str:
        """Abort what was started, on a worker thread; return the result in words.

        Aborting on an earlier page restores the motors as well while a calibration is under way.

        Raises:
            So101Error: It cannot be ended now; the message says what to do.
        """
        target = self._setup.target
        if target is None or not target.is_under_way:
            return self._as_it_was()
        return str(target.calibration.ask("abort")["message"]).rstrip(".")

    def _as_it_was(self) -> str:
        return self._left

    def _ask(self, command: str, doing: str) -> None:
        if self.operation is not None:
            self._setup.do(doing, partial(self.operation.ask, command))

    def _draw(self, view: View) -> None:
        if view.picture is not None:
            self._setup.picture.draw(view.picture)


class CalibrationPage(StepPage):
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
        news, target = super().refresh(), self._setup.target
        if target is not None:
            view = target.calibration.view
            if view.state != State.IDLE.value:
                self._setup.saved = None
                if target.test is not None:
                    target.test.forget()
            elif view.is_over:
                self._setup.saved = view.facts["calibration_file"]
        return news

    def _as_it_was(self) -> str:
        target = self._setup.target
        return self._left if target is None else target.situation.untouched


class ChainPage(StepPage):
    """The page of the chain step."""

    def __init__(self, setup: SetupContext) -> None:
        super().__init__(setup, CHAIN, lambda target: target.chain)

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
