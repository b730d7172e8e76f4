"""Run the parts of a page on one thread, forty times a second, and slow calls on a worker.

Stop does not wait for this thread: viser's own drops every waiting command and stops the arm.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Self

from so101_motion.common.errors import So101Error

from ..page.bar import Bar, board, uuid_of
from ..page.events import EventLog
from ..page.page_context import Command, FrontTab, PageContext, Part
from ..page.screen_state import Tone
from .guarded_server import GuardedServer
from .windows import Windows

log = logging.getLogger(__name__)

_PERIOD = 0.025
"""Time between two pictures [s]; browsers get at most some 57 of them a second anyway."""

_AT_REST, _LIVELY = 0.05, 1.0
"""Time between two pictures when there has been nothing new for the second [s]; chosen. A command
is not kept waiting."""

_BEAT = 1.0
"""How often every browser is told that the page is there [s]; after three of silence it says that
the connection is lost. Chosen."""

_AMBER = (240, 165, 0)
_RIGHT_WIDTH = 400


class Commands:
    """A queue of commands for one thread, which any thread can empty.

    ``on_error`` is called with what a command raised; the next one runs all the same.
    """

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._waiting: deque[Command] = deque()
        self._running = threading.Lock()
        self._posted = threading.Event()

    def post(self, command: Command) -> None:
        self._waiting.append(command)
        self._posted.set()

    def wait(self, timeout: float) -> None:
        """Return when a command was posted since the last call, or after ``timeout`` [s]."""
        self._posted.wait(timeout)
        self._posted.clear()

    def run(self) -> bool:
        acted = False
        with self._running:
            while self._waiting:
                command = self._waiting.popleft()
                acted = True
                try:
                    command()
                except Exception as error:
                    self._on_error(error)
        return acted

    def drop(self) -> None:
        """Drop all waiting commands, and wait for the running one.

        After this no command given before it can have an effect any more: what it set in motion
        can be stopped, and nothing more will be.
        """
        self._waiting.clear()
        with self._running:
            self._waiting.clear()


class ServedPage:
    """A served page, opened by its ``url``. Use it in a ``with`` block or call ``close``.

    It runs the page's parts. ``say`` is called with what a command raised; a part that can show it
    better may replace it. ``wrong`` is why the page can never show its arm, or None.
    """

    def __init__(self, server: GuardedServer) -> None:
        self.url, self._server = server.url, server
        self.events = EventLog()
        self.say: Callable[[Exception], None] = self._note
        self.wrong: So101Error | None = None
        self.windows = Windows(server.viser, self.events.add, self._leave_front)
        self._commands = Commands(self._failed)
        self.post, self.drop_commands = self._commands.post, self._commands.drop
        self._closing = threading.Event()
        self._workers = ThreadPoolExecutor(max_workers=1, thread_name_prefix="so101-viewer-work")
        self._parts: tuple[Part, ...] = ()
        self.bar = Bar()
        self.front = FrontTab()
        self.gui = server.viser.gui
        self.gui.configure_theme(
            show_logo=False,
            show_share_button=False,
            brand_color=_AMBER,
            control_width="large",  # of the panel that a window gets when it is widened again
        )
        self.gui.main_panel.dock_right()
        self.gui.main_panel.set_width(_RIGHT_WIDTH)
        self._bar_html = self.gui.add_html("", visible=False)
        self._beat_html = self.gui.add_html("", visible=False)
        self._front_html = self.gui.add_html("", visible=False)
        self._front_name = self.gui.add_text("Front", "", visible=False)
        self._bar_text = ""
        self._beats, self._beat_due = 0, 0.0
        self._context: PageContext | None = None
        self._thread = threading.Thread(target=self._run, name="so101-viewer", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def page_context(self) -> PageContext:
        if self._context is None:  # not made earlier: an empty group of tabs is ugly
            self._context = PageContext(
                server=self._server.viser,
                tabs=self.gui.add_tab_group(),
                post=self._commands.post,
                workers=self._workers,
                leave_open=self.windows.leave_open,
                events=self.events,
                bar=self.bar,
                front=self.front,
            )
            self._context.on_entry(self._front_name, self._turn_to)
            self._turn_to("")
        return self._context

    def _leave_front(self) -> None:
        """Show what belongs to no tab; the window in control may have been loaded again."""
        if self._context is not None:
            self._turn_to("")
        for part in self._parts:
            self.post(part.left)

    def _turn_to(self, name: str) -> None:
        self.front.name = name
        self._front_html.content = board("front", tab=name, press=uuid_of(self._front_name))

    def add_parts(self, *parts: Part) -> None:
        """Add ``parts`` to the page; called before ``start`` or by a command."""
        self._parts = (*self._parts, *parts)
        self._show(parts)

    def url_for_once(self) -> str:
        return self._server.url_for_once()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving; may be called twice."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._commands.post(lambda: None)  # the thread may wait for one
        if self._thread.ident is not None:
            self._thread.join()
        for part in self._parts:
            part.close()
        self._workers.shutdown(wait=True)
        self.windows.close()
        self._server.close()

    def _note(self, error: Exception) -> None:
        self.events.add(str(error), Tone.BAD)

    def _failed(self, error: Exception) -> None:
        if not isinstance(error, So101Error):
            log.error("a command of the page failed", exc_info=error)
        self.say(error)

    def _run(self) -> None:
        due = lively = time.monotonic()
        while True:
            now = time.monotonic()
            if now - lively < _LIVELY:
                self._closing.wait(max(due - now, 0.0))
                due = max(due + _PERIOD, time.monotonic())
            else:
                self._commands.wait(_AT_REST)
                due = time.monotonic() + _PERIOD
            if self._closing.is_set():
                return
            try:
                acted = self._commands.run()
                news = [part for part in self._parts if part.refresh() or acted]
                if news:
                    lively = time.monotonic()
                    self._show(news)
                self._show_bar()
            except Exception:  # the page must outlive any one picture
                log.exception("the page could not be updated")

    def _show_bar(self) -> None:
        text = self.bar.text()
        if text != self._bar_text:
            self._bar_html.content = self._bar_text = text
        if time.monotonic() >= self._beat_due:
            self._beat_due = time.monotonic() + _BEAT
            self._beats += 1
            self._beat_html.content = board("beat", count=self._beats)

    def _show(self, parts: Iterable[Part]) -> None:
        with self._server.viser.atomic():
            for part in parts:
                part.show()
