"""What every page of ours is hosted by: a guarded server, its windows, and one thread.

A page is made of parts that share a desk. One thread, ``so101-viewer``, owns them all. Forty times
a second it runs the commands that browsers sent meanwhile, lets each part look at the arm, and
shows what is new; an arm at rest costs next to nothing. What takes a while runs beside it. Stop
waits for nobody: it drops every command that is still waiting, from a thread of viser's.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import viser

from so101_motion.errors import So101Error
from so101_motion.rig_like import RigLike

from .commands import Commands
from .desk import Counter, Desk, Part
from .events import EventLog
from .guard import GuardedServer
from .screen import Tone
from .windows import Windows

log = logging.getLogger(__name__)

_PERIOD = 0.025
"""Time between two pictures [s]; browsers get at most some 57 of them a second anyway."""

_AMBER = (240, 165, 0)
_RIGHT_WIDTH = 400


class Host:
    """Runs parts on a server. Close it after use.

    Args:
        server: Where the page is.

    Attributes:
        gui: Where widgets are made.
        windows: The browsers on the page.
        events: What happened, for people.
        say: Told what a command raised; a part with a better place for it may take this over.
    """

    def __init__(self, server: GuardedServer) -> None:
        self._server = server
        self.events = EventLog()
        self.say: Callable[[Exception], None] = self._note
        self.windows = Windows(server.viser, self.events.tell)
        self._commands = Commands(self._failed)
        self._closing = threading.Event()
        self._workers = ThreadPoolExecutor(max_workers=1, thread_name_prefix="so101-viewer-work")
        self._parts: tuple[Part, ...] = ()
        self.gui = server.viser.gui
        self.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=_AMBER)
        self.gui.main_panel.dock_right()
        self.gui.main_panel.set_width(_RIGHT_WIDTH)
        self._tabs: viser.GuiTabGroupHandle | None = None
        self._thread = threading.Thread(target=self._run, name="so101-viewer", daemon=True)

    def start(self) -> None:
        """Begin to run."""
        self._thread.start()

    def counter(self) -> Counter:
        """For parts that need no arm."""
        return Counter(**self._shared())

    def desk(self, rig: RigLike) -> Desk:
        """A desk for parts that work on ``rig``."""
        return Desk(rig=rig, **self._shared())

    def _shared(self) -> dict[str, Any]:
        if self._tabs is None:  # empty, it would be an ugly thing to look at
            self._tabs = self.gui.add_tab_group()
        return {
            "server": self._server.viser,
            "tabs": self._tabs,
            "post": self._commands.post,
            "workers": self._workers,
            "leave_open": self.windows.leave_open,
            "events": self.events,
        }

    def take(self, *parts: Part) -> None:
        """Have ``parts`` on the page from now on; called before ``start`` or by a command."""
        self._parts = (*self._parts, *parts)
        self._show(parts)

    def post(self, command: Callable[[], None]) -> None:
        """Have the page's thread run ``command``."""
        self._commands.post(command)

    def drop_commands(self) -> None:
        """Forget every command still waiting; none has an effect after this."""
        self._commands.drop()

    def close(self) -> None:
        """Stop serving; may be called twice."""
        if self._closing.is_set():
            return
        self._closing.set()
        if self._thread.ident is not None:
            self._thread.join()
        for part in self._parts:
            part.close()
        self._workers.shutdown(wait=True)
        self._server.close()

    def _note(self, error: Exception) -> None:
        self.events.tell(str(error), Tone.BAD)

    def _failed(self, error: Exception) -> None:
        if not isinstance(error, So101Error):
            log.error("a command of the page failed", exc_info=error)
        self.say(error)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._closing.wait(max(due - time.monotonic(), 0.0)):
            due = max(due + _PERIOD, time.monotonic())
            try:
                self.windows.refresh()
                acted = self._commands.run()
                news = [part for part in self._parts if part.refresh() or acted]
                if news:
                    self._show(news)
            except Exception:  # the page must outlive any one picture
                log.exception("the page could not be brought up to date")

    def _show(self, parts: Iterable[Part]) -> None:
        with self._server.viser.atomic():
            for part in parts:
                part.show()
