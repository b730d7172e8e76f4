"""Serve the page of one arm, or of several that share a space.

The page is up at once; the arms may come later (``source.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import viser

from so101_motion.common.errors import ChoiceNeeded
from so101_motion.common.geometry import SE3
from so101_motion.files import user_storage
from so101_motion.planning.request import Plan
from so101_motion.rig.cell_rigs import CellRigs
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig
from so101_motion.setup.identify_operation import IdentifyOperation
from so101_motion.tasks.datasets.episodes import EpisodeOperation
from so101_motion.tasks.picking import PickOperation
from so101_motion.tasks.program import ARM, Solo
from so101_motion.viam.client import MachineRig

from .page import markup, texts
from .page.operation_panel import OperationPanel
from .page.page_context import PICK, PageContext, Part
from .page.screen_state import Sentence, Tone
from .panels.camera_panel import CameraPart
from .panels.events_panel import ArmEvents, EventsPart
from .panels.health_panel import HealthPart
from .panels.hold_buttons import HoldButtons, waiting
from .panels.jog_panel import JogPart
from .panels.move_part import MovePart
from .panels.record_panel import RecordPart
from .panels.share_panel import SharePart
from .panels.task_panel import TaskPart
from .program.program_panel import ProgramPart
from .server.guarded_server import GuardedServer, start_guarded
from .server.host import ServedPage
from .setup.part import SetupPart
from .setup.setup_context import known_arm
from .source import Source, SourceOpener
from .teach.teach_panel import TeachPart
from .world.atlas_panel import AtlasPart
from .world.scene_user import ArmsOfCell, OneArm, SceneUser
from .world.world_panel import WorldPart

_WAITS = Sentence(
    "This page keeps looking for the arm, and shows it here as soon as it answers. Nothing"
    " moves. Meanwhile check:"
)
_CHECK = (
    ("Power", "the arm's own supply is switched on: USB does not feed the motors"),
    ("Cable", "the USB cable is plugged in at both ends"),
    ("Port", "no other program has it open"),
    ("Machine", "for the arm of a Viam machine: the machine runs, and its address is right"),
)


class Preview(ServedPage):
    """A served page of one arm or several; it shows them as soon as they can be opened."""

    def __init__(self, source: Source, server: GuardedServer, *, plan: Plan | None = None) -> None:
        super().__init__(server)
        self._source, self._plan = source, plan
        self._teaches: list[TeachPart] = []
        self._opened: RigLike | CellRigs | None = None
        self._search: SourceOpener | None = None
        self._waits: viser.GuiHtmlHandle | None = None
        self.say = self._missed
        if source.lasts:
            self._take(source.open())
        else:
            waiting(self.bar, source.title)
            about = markup.sentence(_WAITS) + markup.facts(_CHECK)
            self._waits = self.gui.add_html(about)
        self.start()
        if not source.lasts:
            self._search = SourceOpener(source.open, found=self._found, failed=self._missed)

    def close(self) -> None:
        """Stop serving. What was passed in stays open; what was opened is closed."""
        if self._search is not None:
            self._search.close()
        super().close()
        opened, self._opened = self._opened, None
        if opened is not None and not self._source.lasts:
            opened.close()

    def await_first_try(self, seconds: float) -> None:
        """Wait until the arm was found or not, so that ``wrong`` is known, but no longer."""
        if self._search is not None:
            self._search.tried.wait(seconds)

    def _missed(self, error: Exception) -> None:
        if isinstance(error, ChoiceNeeded):
            self.wrong = error
        self.post(lambda: waiting(self.bar, self._source.title, error))

    def _found(self, opened: RigLike | CellRigs) -> None:
        self._opened = opened
        self.post(lambda: self._take(opened))

    def _take(self, opened: RigLike | CellRigs) -> None:
        self._opened = opened
        if self._waits is not None:
            self._waits.remove()
        self._add_parts(opened)
        self.events.add(f"{self._source.title}: connected")

    def stop(self) -> None:
        """Stop all arms and drop all waiting commands; returns when they are at rest."""
        self.drop_commands()
        if isinstance(self._opened, CellRigs):
            self._opened.cell.stop()
        elif self._opened is not None:
            self._opened.arm.stop()

    def _end_following(self) -> None:
        """Stop also ends a following that waits for its leader, in which nothing moves yet."""
        for each in self._teaches:
            each.end_following()

    def _add_parts(self, opened: RigLike | CellRigs) -> None:
        source = self._source
        cell = opened if isinstance(opened, CellRigs) else None
        rigs: Mapping[str, RigLike] = cell.rigs if cell else {"": opened}  # type: ignore[dict-item]
        bases = {"": SE3.identity()}
        if cell is not None:
            bases = {each.name: each.T_cell_base for each in cell.file.arms}
        context = self.page_context()
        move = MovePart(
            context,
            rigs,
            None if cell is None else cell.cell,
            bases,
            title=source.title,
            stops=(self.stop, *(rig.gripper.stop for rig in rigs.values()), self._end_following),
            plan=self._plan,
        )
        self.windows.leave_open_as_stop(move.stop_button)
        self.say = move.model.report
        panel = self.gui.add_panel()
        about: list[Part] = [
            HealthPart(context, rig, panel, mark=move.stages[name].mark, name=name)
            for name, rig in rigs.items()
        ]
        about.append(EventsPart(context, panel))
        panel.dock_below(move.panel)
        if isinstance(opened, HardwareRig):
            servos = IdentifyOperation(opened)
            shown = OperationPanel(context, lambda: servos)
            with panel.add_tab("Servos", viser.Icon.RULER_MEASURE):
                shown.build(context.gui)
            about.append(shown)
        records: list[Part] = []
        if isinstance(opened, Rig):
            episodes = EpisodeOperation(opened, source.camera or "")
            records.append(RecordPart(context, episodes, panel))
        jogs = [
            JogPart(each, rigs[name], move.pages[name], title=name or "Jog")
            for name, each in self._tab_for_each("Jog", rigs)
        ]
        program = self._program(opened, move)
        user: SceneUser = OneArm(rigs[""]) if cell is None else ArmsOfCell(cell.rigs, cell.file)
        world = WorldPart(
            context,
            user,
            file=source.scene_file
            or user_storage.folder() / ("scene.json" if cell is None else "cell.json"),
            now=next(iter(rigs.values())).clock.now,
            on_handles=lambda shown: move.set_handles(not shown),
        )
        share = SharePart(context, move.pages, bases, title=source.title)
        self._teaches = [
            TeachPart(
                each, rigs[name], source.open_leader, title=name or "Teach", node=move.nodes[name]
            )
            for name, each in self._tab_for_each("Teach", rigs)
        ]
        picks = [
            _picks(each, rigs[name], source.place, title=name or PICK, node=move.nodes[name])
            for name, each in self._tab_for_each(PICK, rigs)
        ]
        fade = {name: stage.fade for name, stage in move.stages.items()}
        hold = HoldButtons(
            context, title=source.title, rigs=rigs, guide=program.model.guide, fade=fade
        )
        logs = [ArmEvents(rig, partial(self._log, name)) for name, rig in rigs.items()]
        self.add_parts(move, world, share, *about, hold, program, *logs, *self._teaches, *picks)
        known = None if cell is not None else known_arm(rigs[""])
        if known is not None:
            self.add_parts(SetupPart(context, source=known, on_stage=move.set_visible))
        self.add_parts(*jogs, *records)
        if source.atlas is not None:
            self.add_parts(AtlasPart(context, source.atlas, move.pages[""].set_target_joints))
        if source.camera is not None:
            machine = opened if isinstance(opened, MachineRig) else None
            self.add_parts(CameraPart(context, source.camera, machine))

    def _program(self, opened: RigLike | CellRigs, move: MovePart) -> ProgramPart:
        context = self.page_context()
        if isinstance(opened, CellRigs):
            return ProgramPart(context, opened.cell, move.pages, move.nodes, opened.zeros)
        rig, page = opened, {ARM: move.pages[""]}
        return ProgramPart(
            context, Solo.of(rig), page, {ARM: ""}, lambda: {ARM: rig.connection.encoder_zeros}
        )

    def _tab_for_each(
        self, title: str, rigs: Mapping[str, RigLike]
    ) -> Iterator[tuple[str, PageContext]]:
        context = self.page_context()
        if "" in rigs:
            yield "", context
            return
        with context.tabs.add_tab(title):
            arms = self.gui.add_tab_group()
        for name in rigs:
            yield name, replace(context, tabs=arms)

    def _log(self, name: str, text: str, tone: Tone) -> None:
        said = texts.named(name, Sentence(text, tone=tone))
        self.events.add(said.text, said.tone)


def serve(
    shown: RigLike | Source, *, title: str = "Simulated arm", plan: Plan | None = None, **where: Any
) -> Preview:
    """Show a rig, or the arms of a source as soon as they are there, in browsers.

    ``title`` says which arm a rig is; ``plan`` is shown from the start. Other arguments and errors
    are those of ``start_guarded``. Close the preview before the rig.
    """
    server = start_guarded(label="SO-101 motion", **where)
    try:
        source = shown if isinstance(shown, Source) else Source.given(shown, title)
        return Preview(source, server, plan=plan)
    except BaseException:
        server.close()
        raise


def _picks(context: PageContext, rig: RigLike, place: str, *, title: str, node: str) -> Part:
    """The Pick tab; ``place`` is proposed."""
    with context.tabs.add_tab(title):
        return TaskPart(
            context,
            rig,
            "picking",
            ("pick", "place", "run"),
            lambda rig: PickOperation(rig.picker, place),
            cannot="This arm's module on the machine cannot pick and place.",
            node=f"{node}/pick",
            tab=PICK,
            color=(140, 95, 200),
        )
