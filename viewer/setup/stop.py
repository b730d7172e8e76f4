"""The panel with Stop and the torque, for a setup that is served without a preview."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ..page.page_context import PageContext
from ..page.part import Part
from ..page.stop_button import add_stop
from . import cards
from .setup_context import SetupContext
from .torque import TorqueText

_WIDTH = 250


class StopPanel(Part):
    """The panel on the left. Stop is its only button, so no click can miss it."""

    def __init__(
        self, context: PageContext, setup: SetupContext, *, drop: Callable[[], None]
    ) -> None:
        self._setup, self._drop = setup, drop
        self._shown: TorqueText | None = None
        gui = context.gui
        panel = gui.add_panel()
        with panel.add_tab("Arm", viser.Icon.ROBOT):
            self._torque = gui.add_html("")
            self.widgets = add_stop(gui, self._stop)
        panel.dock_left()
        panel.set_width(_WIDTH)

    def refresh(self) -> bool:
        """Return whether the torque has changed."""
        before, self._shown = self._shown, self._setup.torque.shown
        return self._shown != before

    def show(self) -> None:
        """Show the torque."""
        self._torque.content = cards.torque(self._setup.torque.shown)

    def _stop(self) -> None:
        self._drop()
        target = self._setup.target
        if target is not None and target.rig is not None:
            target.rig.arm.stop()
            target.rig.gripper.stop()
