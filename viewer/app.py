"""The running preview: an arm, wherever it comes from, and the parts of the page that show it.

The page is there at once; its arm may come later (``source.py``). What a part is, ``desk.py`` says;
what runs them, ``host.py``.
"""

from __future__ import annotations

from so101_motion.planning.plan import Plan
from so101_motion.rig_like import RigLike

from .desk import Desk, Part
from .events import Witness
from .guard import GuardedServer, start_guarded
from .health_part import HealthPart
from .host import Host
from .keys import add_keys
from .move import MovePart
from .program_part import ProgramPart
from .setup.part import setup_parts
from .share_part import SharePart
from .source import Search, Source
from .source_part import SourceLine, SourcePart, waiting
from .world_part import WorldPart


class Preview:
    """A preview that is being served. Use it in a ``with`` block or call ``close``.

    Args:
        source: Where the arm to show and move comes from.
        server: Where the page is.
        plan: A plan to begin with.
    """

    def __init__(self, source: Source, server: GuardedServer, *, plan: Plan | None = None) -> None:
        self.url, self._server = server.url, server
        self._source, self._plan = source, plan
        self._rig: RigLike | None = None
        self._search: Search | None = None
        self._host = Host(server)
        self._host.say = self._missed
        self._line = SourceLine(self._host.gui)
        if source.lasts:
            self._furnish(source.open())
        else:
            self._line.show(waiting(source.title))
        self._host.start()
        if not source.lasts:
            self._search = Search(source, found=self._found, failed=self._missed)

    def stop(self) -> None:
        """Stop the arm and forget every command still waiting; returns when the arm is at rest."""
        self._host.drop_commands()
        if self._rig is not None:
            self._rig.arm.stop()

    def url_for_once(self) -> str:
        """A link that opens the page once; see ``GuardedServer.url_for_once``."""
        return self._server.url_for_once()

    def close(self) -> None:
        """Stop serving. An arm that was handed to the page goes on; one it opened is closed."""
        if self._search is not None:
            self._search.close()
        self._host.close()
        rig, self._rig = self._rig, None
        if rig is not None and not self._source.lasts:
            rig.close()

    def __enter__(self) -> Preview:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Looking for the arm

    def _missed(self, error: Exception) -> None:
        self._host.post(lambda: self._line.show(waiting(self._source.title, error)))

    def _found(self, rig: RigLike) -> None:
        self._rig = rig
        self._host.post(lambda: self._furnish(rig))

    # The parts

    def _furnish(self, rig: RigLike) -> None:
        self._rig = rig
        host, title = self._host, self._source.title
        desk = host.desk(rig)
        move = MovePart(desk, title=title, stops=(self.stop, rig.gripper.stop), plan=self._plan)
        host.windows.leave_open_as_stop(*move.stop_widgets)
        host.say = move.page.report
        add_keys(desk, plan=move.page.plan)
        host.take(
            move,
            ProgramPart(desk, move.page),
            WorldPart(
                desk,
                file=self._source.scene_file,
                on_handles=lambda shown: move.set_handles(not shown),
            ),
            SharePart(desk, move.page, title=title),
            *self._about_the_arm(desk, move),
            *setup_parts(desk, on_stage=move.set_visible),
        )
        host.events.tell(f"{title}: connected")

    def _about_the_arm(self, desk: Desk, move: MovePart) -> tuple[Part, ...]:
        health = HealthPart(desk)
        health.panel.dock_below(move.state_panel)
        return (
            health,
            SourcePart(desk, self._line, fade=move.fade),
            Witness(desk.rig, desk.events.tell),
        )


def serve(
    rig: RigLike,
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
    source = Source.given(rig, title)
    return serve_source(source, host, port, allow_remote=allow_remote, plan=plan)


def serve_source(
    source: Source,
    host: str = "127.0.0.1",
    port: int = 8080,
    *,
    allow_remote: bool = False,
    plan: Plan | None = None,
) -> Preview:
    """Show the arm of ``source`` in browsers as soon as it is there; the page is there at once.

    Arguments, result and errors are otherwise those of ``serve``.
    """
    server = start_guarded(host, port, allow_remote=allow_remote, label="SO-101 motion")
    try:
        return Preview(source, server, plan=plan)
    except BaseException:
        server.close()
        raise
