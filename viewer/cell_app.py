"""Serve one page for several arms that share a space."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

from so101_motion.files import user_storage
from so101_motion.rig.cell_rigs import CellRigs
from so101_motion.rig.rig import Rig

from .page import texts
from .page.events import ArmEvents
from .page.page_context import ArmContext
from .page.screen_state import Sentence, Tone
from .panels.camera_panel import CameraPart
from .panels.cell_part import CellPart
from .panels.health_panel import EventsPart, HealthPart
from .panels.hold_buttons import HoldButtons
from .panels.jog_panel import JogPart
from .panels.share_panel import SharePart, SharingArm
from .program.cell_program_panel import CellProgramPart
from .searching_page import SearchingPage
from .server.guarded_server import GuardedServer, start_guarded
from .server.kept_key import KeyOf, new_key
from .source import CellSource
from .teach.teach_panel import TeachPart
from .world.scene_user import ArmsOfCell
from .world.world_panel import WorldPart


class CellPage(SearchingPage[CellRigs]):
    """A served page of several arms."""

    def __init__(self, source: CellSource, server: GuardedServer) -> None:
        self._source = source
        super().__init__(source, source.open, server)

    def stop(self) -> None:
        """Stop all arms and drop all waiting commands; returns when they are at rest."""
        self.host.drop_commands()
        if self._opened is not None:
            self._opened.cell.stop()

    def _add_parts(self, opened: CellRigs) -> None:
        host, title, rigs = self.host, self._source.title, opened.rigs
        context = host.page_context()
        part = CellPart(
            context,
            opened,
            self._source.file,
            title=title,
            stops=(self.stop, *(rig.gripper.stop for rig in rigs.values())),
        )
        host.windows.leave_open_as_stop(part.stop_button)
        host.say = part.model.report
        panel = host.gui.add_panel()
        health = [
            HealthPart(host.arm_context(rig), panel, mark=partial(part.mark, name), name=name)
            for name, rig in rigs.items()
        ]
        events = EventsPart(context, panel)
        panel.dock_below(part.panel)
        hold = HoldButtons(context, title=title, rigs=rigs, guide=part.guide, fade=part.fade)
        jogs = [
            JogPart(each, part.model.arms[name], title=name)
            for name, each in self._tab_for_each("Jog", rigs)
        ]
        program = CellProgramPart(context, opened.cell, part.model.arms, part.nodes, opened.zeros)
        world = WorldPart(
            context,
            ArmsOfCell(rigs, self._source.file),
            file=self._source.path or user_storage.folder() / "cell.json",
            now=next(iter(rigs.values())).clock.now,
            on_handles=lambda shown: part.set_handles(not shown),
        )
        bases = {each.name: each.T_cell_base for each in self._source.file.arms}
        share = SharePart(
            context,
            {
                name: SharingArm(rig=rig, page=part.model.arms[name], T_scene_base=bases[name])
                for name, rig in rigs.items()
            },
            title=title,
        )
        teaches = [
            TeachPart(each, title=name, node=part.nodes[name])
            for name, each in self._tab_for_each("Teach", rigs)
        ]
        logs = [ArmEvents(rig, partial(self._log, name)) for name, rig in rigs.items()]
        if self._source.camera is not None:
            host.add_parts(CameraPart(context, self._source.camera))
        host.add_parts(part, program, world, share, *health, events, hold, *logs, *jogs, *teaches)

    def _tab_for_each(
        self, title: str, rigs: Mapping[str, Rig]
    ) -> Iterator[tuple[str, ArmContext]]:
        """A tab with one tab in it for each arm: its name, and where its widgets go."""
        with self.host.page_context().tabs.add_tab(title):
            arms = self.host.gui.add_tab_group()
        for name, rig in rigs.items():
            yield name, replace(self.host.arm_context(rig), tabs=arms)

    def _log(self, name: str, text: str, tone: Tone) -> None:
        said = texts.named(name, Sentence(text=text, tone=tone))
        self.host.events.add(said.text, said.tone)


def serve_cell(
    source: CellSource,
    host: str = "127.0.0.1",
    port: int | None = None,
    *,
    allow_remote: bool = False,
    key_of: KeyOf = new_key,
) -> CellPage:
    """Serve the page at once, and show the arms of ``source`` as soon as they are there.

    ``host``, ``port``, ``allow_remote``, ``key_of`` and errors are those of ``start_guarded``.
    """
    server = start_guarded(
        host, port, allow_remote=allow_remote, label="SO-101 motion", key_of=key_of
    )
    try:
        return CellPage(source, server)
    except BaseException:
        server.close()
        raise
