"""The keys of the page beside Stop's.

P plans, which moves nothing. No key executes: what moves the arm is pressed where the eye has just
been. Ctrl+K lists all commands, viser's own way.
"""

from __future__ import annotations

from collections.abc import Callable

import viser

from .desk import Desk

WORDS = "Space or Esc stops, P plans; no key moves the arm."
"""What a person should know of them."""


def add_keys(desk: Desk, *, plan: Callable[[], None]) -> None:
    """Have P call ``plan``."""
    command = desk.gui.add_command("Plan (P)", hotkey="P", icon=viser.Icon.ROUTE)
    desk.on_press(command, plan)
