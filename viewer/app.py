"""The running preview: a guarded server, a page on it, and the thread that keeps the page true.

The page is made of parts that share a desk. One thread, ``so101-viewer``, owns them all. Thirty
times a second it runs the commands that browsers sent meanwhile, lets each part look at the arm,
and shows what is new; an arm at rest costs next to nothing. Planning runs beside it. Stop waits
for nobody: it drops every command that is still waiting and goes straight to the arm from a
thread of viser's.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

from so101_motion.errors import So101Error
from so101_motion.planning.plan import Plan
from so101_motion.rig import Rig

from .commands import Commands
from .desk import Desk, Part
from .guard import GuardedServer, start_guarded
from .move import MovePart

log = logging.getLogger(__name__)

_PERIOD = 0.03
"""Time between two pictures [s]; browsers get at most some 57 of them a second anyway."""

_AMBER = (240, 165, 0)
_RIGHT_WIDTH = 330


class Preview:
    """A preview that is being served. Use it in a ``with`` block or call ``close``.

    Args:
        rig: The arm to show and move; it stays the caller's.
        server: Where the page is.
        title: Which arm this is.
        plan: A plan to begin with.
    """

    def __init__(
        self, rig: Rig, server: GuardedServer, *, title: str, plan: Plan | None = None
    ) -> None:
        self.url = server.url
        self._server, self._rig = server, rig
        self._commands = Commands(self._failed)
        self._closing = threading.Event()
        self._workers = ThreadPoolExecutor(max_workers=1, thread_name_prefix="so101-viewer-work")
        gui = server.viser.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=_AMBER)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_RIGHT_WIDTH)
        desk = Desk(
            server=server.viser,
            rig=rig,
            tabs=gui.add_tab_group(),
            post=self._commands.post,
            workers=self._workers,
        )
        move = MovePart(desk, title=title, stops=(self.stop, rig.gripper.stop), plan=plan)
        self._say = move.page.report
        self._parts: tuple[Part, ...] = (move,)
        self._show(self._parts)
        self._thread = threading.Thread(target=self._run, name="so101-viewer", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop the arm and forget every command still waiting; returns when the arm is at rest."""
        self._commands.drop()
        self._rig.arm.stop()

    def close(self) -> None:
        """Stop serving. What the arm is doing goes on; it is not ours. May be called twice."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._thread.join()
        for part in self._parts:
            part.close()
        self._workers.shutdown(wait=True)
        self._server.close()

    def __enter__(self) -> Preview:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _failed(self, error: Exception) -> None:
        if not isinstance(error, So101Error):
            log.error("a command of the preview failed", exc_info=error)
        self._say(error)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._closing.wait(max(due - time.monotonic(), 0.0)):
            due = max(due + _PERIOD, time.monotonic())
            try:
                acted = self._commands.run()
                news = [part for part in self._parts if part.refresh() or acted]
                if news:
                    self._show(news)
            except Exception:  # the page must outlive any one picture
                log.exception("the preview could not be brought up to date")

    def _show(self, parts: Iterable[Part]) -> None:
        with self._server.viser.atomic():
            for part in parts:
                part.show()


def serve(
    rig: Rig,
    host: str = "127.0.0.1",
    port: int = 8080,
    *,
    allow_remote: bool = False,
    title: str = "Simulated arm",
    plan: Plan | None = None,
) -> Preview:
    """Show ``rig`` in browsers.

    Args:
        rig: The arm to show and move; close it after the preview.
        host: Address to listen on.
        port: Port to listen on; 0 for any free one.
        allow_remote: Whether ``host`` may be more than this machine's loopback.
        title: Which arm this is, in words.
        plan: A plan to show from the start; the page can execute it.

    Returns:
        The running preview; its ``url`` is the link that opens it.

    Raises:
        ConfigError: The host or port cannot be used.
        GuardError: The server let a stranger in; it is stopped again.
    """
    server = start_guarded(host, port, allow_remote=allow_remote, label="SO-101 motion")
    try:
        return Preview(rig, server, title=title, plan=plan)
    except BaseException:
        server.close()
        raise
