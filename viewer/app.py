"""The running preview: a guarded server, a page on it, and the thread that keeps the page true.

One thread, ``so101-viewer``, owns the view model. Thirty times a second it runs the commands that
browsers sent meanwhile, looks at the arm, and shows what is new; an arm at rest costs next to
nothing. Planning runs beside it. Stop waits for nobody: it drops every command that is still
waiting and goes straight to the arm from a thread of viser's.
"""

from __future__ import annotations

import logging
import threading
import time
from concurrent.futures import ThreadPoolExecutor

from so101_motion.errors import So101Error
from so101_motion.geometry import Array
from so101_motion.planning.model import RobotModel
from so101_motion.planning.plan import Plan
from so101_motion.rig import Rig

from .aim import Aimer
from .commands import Commands
from .guard import GuardedServer, start_guarded
from .panels import PlanPanel, StatePanel
from .stage import Stage
from .view_model import ViewModel

log = logging.getLogger(__name__)

_PERIOD = 0.03
"""Time between two pictures [s]; browsers get at most some 57 of them a second anyway."""

_WORDS_EVERY = 3
"""Joint figures are told every so many pictures of a motion; nobody reads 30 a second."""

_AMBER = (240, 165, 0)


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
        self._planning = ThreadPoolExecutor(max_workers=1, thread_name_prefix="so101-viewer-plan")
        model = RobotModel.load()
        self._page = ViewModel(
            arm=rig.arm,
            gripper=rig.gripper,
            aimer=Aimer.load(scene=rig.arm.scene),
            submit=self._planning.submit,
            welcome=f"{title}. Drag the arrows, then press Plan.",
        )
        if plan is not None:
            self._page.show(plan)
        gui = server.viser.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=_AMBER)
        self._stage = Stage(
            server.viser, model=model, surroundings=rig.arm.scene, on_drag=self._dragged
        )
        self._state_panel = StatePanel(
            gui,
            title=title,
            lower=model.lower,
            upper=model.upper,
            stops=(self.stop, rig.gripper.stop),
        )
        self._plan_panel = PlanPanel(gui, self._page, self._commands.post)
        self._pictures = 0
        self._thread = threading.Thread(target=self._run, name="so101-viewer", daemon=True)
        self._show()
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
        self._planning.shutdown(wait=True)
        self._server.close()

    def __enter__(self) -> Preview:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _dragged(self, p_base: Array) -> None:
        def command() -> None:
            self._stage.dragged_to(p_base)
            self._page.aim_at(p_base)

        self._commands.post(command)

    def _failed(self, error: Exception) -> None:
        if not isinstance(error, So101Error):
            log.error("a command of the preview failed", exc_info=error)
        self._page.report(error)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._closing.wait(max(due - time.monotonic(), 0.0)):
            due = max(due + _PERIOD, time.monotonic())
            try:
                acted = self._commands.run()
                if self._page.refresh() or acted:
                    self._show()
            except Exception:  # the page must outlive any one picture
                log.exception("the preview could not be brought up to date")

    def _show(self) -> None:
        screen = self._page.screen()
        self._pictures += 1
        with self._server.viser.atomic():
            self._stage.show(screen)
            if not screen.state.arm_moving or self._pictures % _WORDS_EVERY == 0:
                self._state_panel.show(screen.state)
                self._plan_panel.show(screen)


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
