"""Stop and the torque, beside a setup that has no preview around it."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ..desk import Counter
from . import cards
from .torque import Torque
from .workshop import Workshop

_WIDTH = 250


class StopPanel:
    """The panel on the left. Stop is the only thing to press in it, so no click can be lost.

    Args:
        desk: Where to make it.
        shop: What is worked on.
        drop: Forgets every command still waiting.

    Attributes:
        widgets: What stops the arm.
    """

    def __init__(self, desk: Counter, shop: Workshop, *, drop: Callable[[], None]) -> None:
        self._shop, self._drop = shop, drop
        self._shown: Torque | None = None
        gui = desk.gui
        panel = gui.add_panel()
        with panel.add_tab("Arm", viser.Icon.ROBOT):
            self._torque = gui.add_html("")
            icon = viser.Icon.HAND_STOP
            button = gui.add_button(
                "STOP", color="red", icon=icon, hint="Space or Escape does the same"
            )
        panel.dock_left()
        panel.set_width(_WIDTH)
        keys = (
            gui.add_command("Stop the arm (Space)", hotkey="space", icon=icon),
            gui.add_command("Stop the arm (Escape)", hotkey="escape", icon=icon),
        )
        self.widgets = (button, *keys)
        button.on_click(lambda _event: self._stop())
        for key in keys:
            key.on_trigger(lambda _event: self._stop())

    def refresh(self) -> bool:
        """Whether the torque has changed."""
        before, self._shown = self._shown, self._shop.torque.told
        return self._shown != before

    def show(self) -> None:
        """Tell the torque."""
        self._torque.content = cards.torque(self._shop.torque.told)

    def close(self) -> None:
        """Nothing is held."""

    def _stop(self) -> None:
        self._drop()
        bench = self._shop.bench
        if bench is not None and bench.rig is not None:
            bench.rig.arm.stop()
            bench.rig.gripper.stop()
