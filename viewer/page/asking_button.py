"""A button that asks first and acts at the second press."""

from __future__ import annotations

import time
from collections.abc import Callable

import viser

from .page_context import PageContext

ASKED_FOR = 5.0
"""How long the question stands [s]; chosen."""


class AskingButton:
    """A gray button that says ``question`` when it is pressed, and acts if it is again in time."""

    def __init__(
        self,
        context: PageContext,
        label: str,
        question: str,
        command: Callable[[], object],
        icon: viser.IconName = viser.Icon.RESTORE,
    ) -> None:
        self._label, self._question, self._command = label, question, command
        self._until = 0.0
        self._button = context.button(label, self._press, icon=icon, color="gray")

    @property
    def order(self) -> float:
        return self._button.order

    @order.setter
    def order(self, order: float) -> None:
        self._button.order = order

    def refresh(self) -> bool:
        if self._until and time.monotonic() > self._until:
            self._until = 0.0
            return True
        return False

    def show(self, *, shown: bool = True, can: bool = True, label: str = "") -> None:
        """Update it; ``can`` tells whether it may be pressed; ``label`` is a new one."""
        self._button.visible, self._label = shown, label or self._label
        self._button.label = self._question if self._until else self._label
        self._button.disabled = not can

    def _press(self) -> None:
        asked, self._until = self._until, 0.0
        if time.monotonic() <= asked:
            self._command()
        else:
            self._until = time.monotonic() + ASKED_FOR
