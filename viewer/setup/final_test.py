"""The page of the final test: Stop, Back and Abort end it at any time, with the arm held."""

from __future__ import annotations

import viser

from so101_motion import __version__
from so101_motion.common.modes import HELD
from so101_motion.setup.move_test import MoveTest
from so101_motion.setup.setup_steps import TEST

from ..page import cards
from .page import StepPage
from .setup_context import SetupContext


class FinalTestPage(StepPage):
    """The page of the final test."""

    def __init__(self, setup: SetupContext) -> None:
        super().__init__(setup, TEST, lambda target: target.test)

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        text = "This arm cannot be moved from here. You may go on."
        self._unmoved = gui.add_html(cards.instruction(TEST.title, text), visible=False)
        super().build(gui)
        self._save = gui.add_button("Save the report", icon=viser.Icon.DOWNLOAD, color="gray")
        self._setup.context.on_asked(self._save, self._hand_over)

    def leave(self) -> None:
        """End a running test; the arm holds."""
        if self._test is not None:
            self._test.close()

    def show(self) -> None:
        """Show the test, and what there is to be saved."""
        super().show()
        test = self._test
        self._unmoved.visible = test is None
        self._save.visible = test is not None and test.report is not None and not test.is_running

    def next_label(self) -> str:
        """Next says what it does after a test that is missing or that has failed."""
        report = None if self._test is None else self._test.report
        if self._test is None or (report is not None and report.passed):
            return "Next"
        return "Skip the test" if report is None or report.ended_by else "Go on anyway"

    def is_next_due(self) -> bool:
        """Whether the test is passed and its question answered, or there can be none."""
        return self._test is None or self._test.view.is_over

    def can_go_on(self) -> str | None:
        """A running test keeps from going on; a skipped or failed one does not."""
        is_running = self._test is not None and self._test.is_running
        return "the test is running" if is_running else None

    def abort(self) -> str:
        """End the test; the arm holds where it is."""
        self.leave()
        return super().abort()

    def _as_it_was(self) -> str:
        rig = None if self._setup.target is None else self._setup.target.rig
        holds = rig is not None and rig.arm.state.mode in HELD
        where = "the arm is held where it stands" if holds else "the arm is limp, so support it"
        return f"what was saved stays, and {where}"

    @property
    def _test(self) -> MoveTest | None:
        return None if self._setup.target is None else self._setup.target.test

    def _hand_over(self, client: viser.ClientHandle) -> None:
        report = None if self._test is None else self._test.report
        if report is not None:
            name = f"so101-move-test-{report.began_at[:19].replace(':', '')}.json"
            content = report.file({"version": __version__})
            client.send_file_download(name, content, save_immediately=True)
