"""Helpers for viser's widgets: values that both people and the page set, undo buttons, greying."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from .bar import board, uuid_of
from .history import History
from .page_context import PageContext
from .saved_files import SavedFiles


class SharedField:
    """A widget whose value both people and the page set; ``shown`` is a value as it shows it.

    The page writes only what is news: a value it has not shown yet and that nobody entered. Else
    a picture drawn while somebody types or drags would put the previous value back under their
    fingers.
    """

    def __init__(
        self,
        widget: Any,
        command: Callable[[Any], None],
        context: PageContext,
        *,
        shown: Callable[[Any], Any],
    ) -> None:
        self._widget, self._command, self._shown = widget, command, shown
        self._known: Any = None
        context.on_entry(widget, self._take)

    def _take(self, value: Any) -> None:
        self._known = self._shown(value)
        self._command(value)

    def show(self, value: Any) -> None:
        """Set ``value`` unless it was set already; None hides the widget."""
        self._widget.visible = value is not None
        if value is None:
            return
        shown = self._shown(value)
        if shown != self._known:
            self._known = shown
            put(self._widget, shown)

    def offer(self, value: Any) -> None:
        """The same, but without a value the widget stays in its place, grey."""
        self._widget.disabled = value is None
        if value is not None:
            self.show(value)


class UndoButtons:
    """A pair of buttons, undo and redo, of which each can be grey by itself, and then says why.

    viser greys a row only as a whole; ``front/row.js`` does it. Presses of a button that has just
    become grey are harmless.
    """

    def __init__(self, context: PageContext, label: str, edited: History[Any] | SavedFiles) -> None:
        self._edited = edited
        self._group = context.buttons(label, {"undo": edited.undo, "redo": edited.redo})
        self._told = context.gui.add_html("", visible=False)

    def show(self, *, can: bool = True) -> None:
        why_not = {}
        if not (can and self._edited.can_undo):
            why_not["undo"] = "There is nothing to undo."
        if not (can and self._edited.can_redo):
            why_not["redo"] = "Nothing was undone."
        row = uuid_of(self._group)
        self._told.content = board(f"row {row}", row=row, why_not=why_not)


def grey(group: Any, greyed: bool) -> None:
    """Disable a group of buttons, or not; viser's browser can, its Python only says that it cannot.

    Presses of a group that is disabled elsewhere meanwhile must be harmless.
    """
    inside = group._impl
    if inside.props.disabled != greyed:
        inside.props.disabled = greyed
        group._queue_update("disabled", greyed)


def put(widget: Any, value: object) -> None:
    """Set a widget's value; viser's types declare it read-only, which it is not."""
    widget.value = value


def tenth(value: float) -> float:
    """``value`` to one decimal, never -0."""
    return round(float(value), 1) + 0.0


def tenths(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(tenth(value) for value in values)
