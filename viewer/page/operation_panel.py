"""Show any operation on the page: its view, and a button for each command that it offers.

The panel gives commands that are due, on a worker. It keeps nothing in the browser.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

import viser

from so101_motion.arm.stop_order import mark_request
from so101_motion.common.errors import So101Error
from so101_motion.common.operation import Input, Offer, Operation, View

from . import cards, markup, texts
from .bar import uuid_of
from .page_context import PageContext, Part
from .screen_state import Tone
from .shared_fields import AskingButton, SharedField

T = TypeVar("T")

log = logging.getLogger(__name__)

_PERIOD = 0.07
"""Time between two pictures [s]; chosen: hands are slow, and browsers on phones are as well."""


_NONE = "none"
_MOVES = ("run", "move")  # the commands that carry out what was planned


@dataclass(slots=True, kw_only=True)
class Worker:
    """One worker thread: what runs, and why the last run failed. For the page's thread."""

    doing: str = ""
    trouble: Exception | None = None
    _workers: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(1, thread_name_prefix="so101-page-worker")
    )
    _job: tuple[Future[Any], Callable[[Any], None]] | None = None
    _look: Future[object] | None = None
    _has_missed: bool = False  # whether the last look failed

    def do(
        self, doing: str, call: Callable[[], T], then: Callable[[T], None] = lambda _result: None
    ) -> bool:
        """Run ``call``, unless something runs already; return whether it runs.

        ``then`` takes the result on the page's thread; after an error that is in ``trouble``.
        """
        if self._job is not None:
            return False
        self.doing, self.trouble = doing, None
        self._job = (self._workers.submit(call), then)
        return True

    def watch(self, look: Callable[[], object]) -> None:
        """Look at something, unless something runs already.

        Nobody waits for it, and errors are ignored: it is called again soon.
        """
        if self._job is None and self._look is None:
            self._look = self._workers.submit(look)

    @property
    def is_looking(self) -> bool:
        return self._look is not None

    def collect(self) -> bool:
        if self._look is not None and self._look.done():
            looked, self._look = self._look, None
            error, has_missed = looked.exception(), self._has_missed
            self._has_missed = error is not None
            if has_missed and error is None:  # what it was about is there again
                self.trouble = None
            if error is not None and not isinstance(error, So101Error):
                log.error("the page could not look", exc_info=error)
        return self._collect_job()

    def _collect_job(self) -> bool:
        if self._job is None or not self._job[0].done():
            return False
        (future, then), self._job, self.doing = self._job, None, ""
        error = future.exception()
        if error is None:
            then(future.result())
            return True
        if not isinstance(error, So101Error):
            log.error("a command of the page failed", exc_info=error)
        assert isinstance(error, Exception)
        self.trouble = error
        return True

    def end(self) -> None:
        self._workers.shutdown(wait=True)


class _Field:
    """A value that a person gives, the same in every window; a new proposal replaces it."""

    def __init__(self, widget: Any, context: PageContext) -> None:
        self.widget, self.value, self._proposed = widget, "", ""
        self._shared = SharedField(widget, partial(setattr, self, "value"), context)

    def show(self, wanted: Input, proposed: str, order: int) -> None:
        choices = wanted.choices or (_NONE,)
        if isinstance(self.widget, viser.GuiDropdownHandle) and self.widget.options != choices:
            self.widget.options, self._proposed = choices, ""
        if proposed != self._proposed:
            self.value = self._proposed = proposed
        self._shared.show(self.value or ("" if wanted.choices is None else choices[0]))
        self.widget.order = order


class OperationPanel(Part):
    """The panel of an operation.

    Args:
        operation: Returns the operation; None while there is none.
        worker: Runs its commands, of a page that shows what it does and undoes it with a button of
            its own; one of the panel's if not given, closed with it.
        draw: Draws the view's picture.
        as_shown: What to show of the operation's view.
        by_enter: Whether Enter presses the usual button, where none has the focus.
        rows_last: Whether rows that come and go stand below the buttons, and so do not move them.
    """

    def __init__(
        self,
        context: PageContext,
        operation: Callable[[], Operation | None],
        *,
        worker: Worker | None = None,
        draw: Callable[[View], None] = lambda _view: None,
        as_shown: Callable[[View], View] = lambda view: view,
        by_enter: bool = False,
        rows_last: bool = False,
    ) -> None:
        self._context, self._operation, self._draw = context, operation, draw
        self._as_shown = as_shown
        self._by_enter, self._rows_last = by_enter, rows_last
        self._worker = worker or Worker()
        self._own = self._worker if worker is None else None
        self._view: View | None = None
        self._news = ""  # what was said last, until the state changes
        self._due = 0.0
        self._offers: dict[str, Offer] = {}
        self._buttons: dict[str, AskingButton] = {}
        self._fields: dict[str, _Field] = {}

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets, where the caller has put the cursor."""
        self._head, self._trouble, self._rows = (gui.add_html("") for _ in range(3))
        self._folder = gui.add_folder(None)
        if self._rows_last:
            self._rows.order = self._folder.order + 0.5
        self._foot = gui.add_html("")

    def refresh(self) -> bool:
        is_news = self._own is not None and self._own.collect()
        is_news |= any(button.refresh() for button in self._buttons.values())
        operation, t = self._operation(), time.monotonic()
        if operation is None or (t < self._due and not is_news):
            return is_news
        before, self._view = self._view, (now := self._as_shown(operation.view))
        if before is not None and (now.said, now.state) != (before.said, before.state):
            said = [s for s in now.said if self._own is not None or s.tone in ("warm", "bad")]
            new = next((s.text for s in reversed(said) if s not in before.said), "")
            self._news = new and f"{time.strftime('%H:%M:%S')} {new}"  # it may not last as long
        for offer in self._view.offers:
            if offer.due_in is not None and offer.due_in <= 0.0 and offer.why_not is None:
                self._give(offer)
                break
        self._due = t + _PERIOD
        return is_news or before != self._view

    def show(self) -> None:
        view = self._view
        if view is None:
            return
        self._trouble.content = self._wrong(view)
        self._rows.content = cards.rows(view.columns, view.rows) if view.rows else ""
        self._show_buttons(view)
        self._foot.content = self._words(view)
        self._draw(view)
        lines = markup.to_copy("In a terminal:", view.to_copy) if view.to_copy else ""
        self._head.content = cards.instruction(view.title, texts.capital(view.text)) + lines

    def forget_trouble(self, kind: type[Exception] = Exception) -> None:
        """Forget an error of this kind that the last command failed with."""
        if self._own is not None and isinstance(self._own.trouble, kind):
            self._own.trouble = None

    def close(self) -> None:
        """End the panel's own worker, after closing the operation; else its owner does both."""
        if self._own is not None:
            operation = self._operation()
            if operation is not None:
                operation.close()
            self._own.end()

    # Helpers

    def _words(self, view: View) -> str:
        due = next((o for o in view.offers if o.due_in is not None and not o.is_look), None)
        plain = (button.widget for button in self._buttons.values() if not button.question)
        lit = next((b for b in plain if b.visible and b.color is None and not b.disabled), None)
        press = uuid_of(lit) if self._by_enter else None
        html = cards.note(view.note, press) + cards.note(self._news)
        if view.picture is not None:
            html += cards.note(view.picture.note)
        says_it = self._own is None or any(each.cancels for each in view.offers)
        doing = self._worker.doing
        doing = view.doing or (f"{doing}: under way" if doing and not says_it else "")
        if doing:  # the page that has the worker shows what it does
            html += cards.going_on(doing)
        elif due is not None and due.due_in:
            html += cards.going_on(f"{due.title}: by itself in {due.due_in:.0f} s")
        first = next((o for o in view.offers if not o.is_look), None)
        why = "" if first is None or view.trouble else texts.capital(first.why_not or "")
        if first is not None and why.rstrip(".") not in texts.capital(view.text):  # nor said twice
            html += cards.note(f"{first.title}: {why}")
        return html

    def _wrong(self, view: View) -> str:
        """What is wrong, above the rows, so that it is seen on a phone as well."""
        if view.fix:
            return cards.marked("✗", "bad", view.trouble, view.fix)
        trouble = view.trouble
        if self._own is None and trouble == str(self._worker.trouble):
            return ""  # the page that has the worker shows it
        if self._own is not None and self._own.trouble is not None and not trouble:
            ended = texts.ended(self._own.trouble)
            if ended.tone is not Tone.BAD:  # it was stopped
                return cards.note(ended.text)
            trouble = ended.text
        return cards.failed(trouble) if trouble else ""

    def _show_buttons(self, view: View) -> None:
        self._offers.clear()
        for place, offer in enumerate(view.offers):
            is_by_itself = offer.is_look and offer.due_in is not None
            if is_by_itself or (offer.cancels and self._own is None):
                continue
            count = sum(before.command == offer.command for before in view.offers[:place])
            self._offers[f"{offer.command} {count} {bool(offer.asks)}"] = offer
        for slot, offer in self._offers.items():
            if slot not in self._buttons:
                press = partial(self._press, slot)
                with self._folder:
                    self._buttons[slot] = AskingButton(
                        self._context, offer.title, offer.asks, press, icon=None
                    )
        places: dict[str, int] = {}
        shown = {each.label for offer in view.offers for each in offer.inputs.values()}
        for slot, offer in self._offers.items():
            for name, wanted in offer.inputs.items():
                if wanted.label in shown:
                    shown.remove(wanted.label)
                    places[f"field {wanted.label}"] = len(places)
                    self._show_field(wanted, str(offer.arguments.get(name, "")), len(places))
            places[slot] = len(places) + 1
        for label, known in self._fields.items():
            known.widget.visible = f"field {label}" in places
        for slot, button in self._buttons.items():
            here = self._offers.get(slot)
            button.widget.order = places.get(slot, len(places))
            button.widget.color = self._color(here, view)
            is_busy = bool(self._worker.doing) and not (here is not None and here.cancels)
            can = here is not None and here.why_not is None and not is_busy
            button.show(shown=here is not None, can=can, label=here.title if here else "")

    def _color(self, offer: Offer | None, view: View) -> Any:
        """As on the Move tab: what plans or is usual shines, what moves the arm is green."""
        if offer is None or offer.cancels or view.is_over:
            return "gray"
        if offer.command in _MOVES:
            return "green"
        return None if offer is view.offers[0] else "gray"

    def _show_field(self, wanted: Input, value: str, order: int) -> None:
        known = self._fields.get(wanted.label)
        if known is None:
            gui = self._context.gui
            with self._folder:
                widget = (
                    gui.add_dropdown(wanted.label, wanted.choices or (_NONE,))
                    if wanted.choices is not None
                    else gui.add_text(wanted.label, value)
                )
            known = self._fields[wanted.label] = _Field(widget, self._context)
        known.show(wanted, value, order)

    def _press(self, slot: str) -> None:
        offer = self._offers.get(slot)  # as it was shown
        if offer is not None and offer.why_not is None:
            self._give(offer)

    def _give(self, offer: Offer) -> None:
        operation = self._operation()
        if operation is None:
            return
        typed = {name: self._fields[field.label].value for name, field in offer.inputs.items()}
        asked = copy_context()  # a stop before the worker gets to it ends it
        asked.run(mark_request)
        ask = partial(
            asked.run, partial(operation.ask, offer.command, **{**offer.arguments, **typed})
        )
        if offer.cancels and self._worker.doing:
            self._context.in_background(ask)
        elif offer.is_look:
            self._worker.watch(ask)
        else:
            self._worker.do(offer.title, ask)
