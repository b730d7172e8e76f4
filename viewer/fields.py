"""Widgets that both people and the page write."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .desk import Counter


class Field:
    """A widget whose value people set, and the page too.

    The page writes only what is news: a value it has not shown yet and that nobody entered. Else
    a picture drawn while somebody types or drags would put the previous value back under their
    fingers.

    Args:
        widget: The widget.
        command: What an entered value does.
        desk: Brings the command to the page's thread.
        shown: A value as the widget shows it.
    """

    def __init__(
        self,
        widget: Any,
        command: Callable[[Any], None],
        desk: Counter,
        *,
        shown: Callable[[Any], Any],
    ) -> None:
        self._widget, self._command, self._shown = widget, command, shown
        self._known: Any = None
        desk.on_entry(widget, self._take)

    def _take(self, value: Any) -> None:
        self._known = self._shown(value)
        self._command(value)

    def show(self, value: Any) -> None:
        """Show ``value`` if it is news."""
        shown = self._shown(value)
        if shown != self._known:
            self._known = shown
            put(self._widget, shown)


def put(widget: Any, value: object) -> None:
    """Set a widget's value; viser's types declare it read-only, which it is not."""
    widget.value = value
