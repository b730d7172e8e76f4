"""Add the invisible button that the bar's Stop and the keys Space and Escape press."""

from __future__ import annotations

from collections.abc import Callable

import viser


def add_stop(gui: viser.GuiApi, *stops: Callable[[], None]) -> viser.GuiButtonHandle:
    """Add the button; see ``bar.py``.

    Args:
        gui: Where.
        stops: What it calls, each in a thread of its own because it may wait for rest.
    """
    button = gui.add_button("STOP", color="red", visible=False)
    for stop in stops:
        button.on_click(_ignoring_event(stop))
    return button


def _ignoring_event(call: Callable[[], None]) -> Callable[[object], None]:
    def handler(_event: object) -> None:
        call()

    return handler
