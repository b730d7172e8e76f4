"""Helpers for viser's widgets: values that people and the page set, undo, questions, greying."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import viser

from .bar import greyed
from .history import History
from .page_context import PageContext
from .plan_view import Playback
from .units import HUNDREDTHS, PERCENT, PLAIN, Unit

ASKED_FOR = 5.0  # how long the question stands [s]; chosen


class SharedField:
    """A widget whose value both people and the page set, which it shows in a unit.

    The page writes only what is news: a value it has not shown yet and that nobody entered. Else
    a picture drawn while somebody types or drags would put the previous value back under their
    fingers.
    """

    def __init__(
        self, widget: Any, command: Callable[[Any], None], context: PageContext, unit: Unit = PLAIN
    ) -> None:
        self.widget, self._command, self._unit = widget, command, unit
        self._known: Any = None
        context.on_entry(widget, self._take)

    def _take(self, entered: Any) -> None:
        value = self._unit.meant(entered)
        self._known = self._unit.shown(value)
        self._command(value)

    def show(self, value: Any) -> None:
        """Set ``value`` unless it was set already; None hides the widget."""
        self.widget.visible = value is not None
        if value is None:
            return
        shown = self._unit.shown(value)
        if shown != self._known:
            self._known = shown
            put(self.widget, shown)

    def offer(self, value: Any) -> None:
        """The same, but without a value the widget stays in its place, grey."""
        self.widget.disabled = value is None
        if value is not None:
            self.show(value)


def percent_slider(
    context: PageContext,
    label: str,
    command: Callable[[float], None],
    hint: str | None = None,
    least: float = 0.0,
) -> SharedField:
    """A slider for a share from ``least`` to 1, in percent; it begins with 0, or else with all."""
    lowest, first = round(100.0 * least), 100 if least else 0
    slider = context.gui.add_slider(label, lowest, 100, 1, first, hint=hint)
    return SharedField(slider, command, context, PERCENT)


class TimeFields:
    """A slider for a place on the timeline of what is planned, and buttons that play it."""

    def __init__(
        self,
        context: PageContext,
        label: str,
        playback: Playback,
        rates: Iterable[float],
        hint: str,
    ) -> None:
        self.slider = context.gui.add_slider(label, 0.0, 1.0, 0.01, 0.0, disabled=True)
        self._t = SharedField(self.slider, playback.seek, context, HUNDREDTHS)
        plays = {f"{rate:g}×": partial(playback.play, rate) for rate in rates}
        self._play = context.buttons("Play", plays, hint)

    def show(self, duration: float | None, t: float) -> None:
        """Show ``t`` of the ``duration`` [s]; grey without one."""
        self.slider.disabled = duration is None
        grey(self._play, duration is None)
        if duration is not None:
            self.slider.max = max(math.ceil(100.0 * duration) / 100.0, 0.01)
        self._t.show(0.0 if duration is None else t)


class UndoButtons:
    """A tab's pair of buttons, undo and redo. They go through all that is ``edited``, newest first.

    Each can be grey by itself, and then says why.
    """

    def __init__(self, context: PageContext, *edited: History[Any]) -> None:
        self._edited = edited
        self._group = context.buttons("Edits", {"undo": self._undo, "redo": self._redo})
        self._told = context.gui.add_html("", visible=False)

    def _undo(self) -> None:
        max(self._edited, key=lambda each: each.undoes).undo()

    def _redo(self) -> None:
        min(self._edited, key=lambda each: each.redoes).redo()

    def show(self, *, can: bool = True, needed: bool = True) -> None:
        """Show them; where they are not ``needed``, only if they can do anything."""
        undoes = any(each.can_undo for each in self._edited)
        redoes = any(each.can_redo for each in self._edited)
        self._group.visible = needed or undoes or redoes
        why_not = {}
        if not (can and undoes):
            why_not["undo"] = "There is nothing to undo."
        if not (can and redoes):
            why_not["redo"] = "Nothing was undone."
        self._told.content = greyed(self._group, why_not)


class AskingButton:
    """A button that says its question when it is pressed, and acts if it is again in time.

    Without a question it acts at once.
    """

    def __init__(
        self,
        context: PageContext,
        label: str,
        question: str,
        command: Callable[[], object],
        icon: viser.IconName | None,
    ) -> None:
        self._label, self.question, self._command = label, question, command
        self._until = 0.0
        self.widget = context.button(label, self._press, icon=icon, color="gray")

    def refresh(self) -> bool:
        if self._until and time.monotonic() > self._until:
            self._until = 0.0
            return True
        return False

    def show(self, *, shown: bool = True, can: bool = True, label: str = "") -> None:
        self.widget.visible, self._label = shown, label or self._label
        self.widget.label = self.question if self._until else self._label
        self.widget.disabled = not can

    def _press(self) -> None:
        asked, self._until = self._until, 0.0
        if not self.question or time.monotonic() <= asked:
            self._command()
        else:
            self._until = time.monotonic() + ASKED_FOR


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
