"""The button and the keys that stop the arm."""

from __future__ import annotations

from collections.abc import Callable

import viser


def add_stop(
    gui: viser.GuiApi, *stops: Callable[[], None]
) -> tuple[viser.GuiButtonHandle | viser.CommandHandle, ...]:
    """Add the button, and the keys Space and Escape.

    Args:
        gui: Where; the button goes where the cursor is.
        stops: What they call, each in a thread of its own because it may wait for rest.

    Returns:
        The button and the keys.
    """
    icon = viser.Icon.HAND_STOP
    button = gui.add_button("STOP", color="red", icon=icon, hint="Space or Escape does the same")
    keys = (
        gui.add_command("Stop the arm (Space)", hotkey="space", icon=icon),
        gui.add_command("Stop the arm (Escape)", hotkey="escape", icon=icon),
    )
    for stop in stops:
        button.on_click(_ignoring_event(stop))
        for key in keys:
            key.on_trigger(_ignoring_event(stop))
    return button, *keys


def _ignoring_event(call: Callable[[], None]) -> Callable[[object], None]:
    def handler(_event: object) -> None:
        call()

    return handler
