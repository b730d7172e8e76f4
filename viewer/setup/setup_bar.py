"""Fill the bar of a setup page without a preview: Stop, and whether the joints are held."""

from __future__ import annotations

from collections.abc import Callable

from ..page.page_context import PageContext
from ..page.part import Part
from ..page.stop_button import add_stop
from .setup_context import SetupContext


class SetupStop(Part):
    """Fills the bar of a setup.

    Attributes:
        button: What the bar's Stop presses.
    """

    def __init__(
        self, context: PageContext, setup: SetupContext, *, drop: Callable[[], None]
    ) -> None:
        self._bar, self._setup, self._drop = context.bar, setup, drop
        self.button = add_stop(context.gui, self._stop)
        self._bar.stop, self._bar.title = self.button, "SO-101 setup"

    def refresh(self) -> bool:
        """Show the torque."""
        is_open = self._setup.target is not None
        self._bar.state = self._setup.torque.shown.text if is_open else "Not connected yet"
        return False

    def _stop(self) -> None:
        self._drop()
        target = self._setup.target
        if target is not None and target.rig is not None:
            target.rig.arm.stop()
            target.rig.gripper.stop()
