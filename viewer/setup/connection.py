"""The page to choose the port, and to name the arm on it."""

from __future__ import annotations

import viser

from so101_motion.setup.checkup import Check
from so101_motion.setup.connect import ConnectOperation
from so101_motion.setup.setup_steps import CONNECT

from .page import StepPage
from .setup_context import SetupContext
from .setup_target import ArmSource, SetupTarget


class ConnectionPage(StepPage):
    """The page of the connection step."""

    def __init__(self, setup: SetupContext, source: ArmSource) -> None:
        self._source, self._connect = source, ConnectOperation(source.look)
        super().__init__(setup, CONNECT, left="nothing was changed")

    @property
    def operation(self) -> ConnectOperation:
        """The choice of the port."""
        return self._connect

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        super().build(gui)
        self._name = gui.add_text(
            "Name of this arm",
            self._setup.progress.arm,
            hint="Such as leader or follower; its calibration gets a file of that name",
            visible=False,
        )
        self._setup.context.on_entry(self._name, self._setup.progress.call)

    def refresh(self) -> bool:
        """Take in the last look."""
        news = super().refresh()
        self._setup.seen = self._connect.findings
        return news

    def show(self) -> None:
        """Show the ports."""
        super().show()
        chosen = self._connect.chosen
        self._name.visible = chosen is not None and chosen.report.calibration is None

    def check(self) -> Check:
        """Whether there is a usable port."""
        return self._connect.check

    def open(self) -> SetupTarget:
        """Open the target on the chosen port; in a worker's thread."""
        return self._source.open(self._connect.chosen, self._setup.progress.arm)
