"""Serve the page of one arm, or of several that share a space.

The page is up at once; the arms may come later (``source.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

import viser

from so101_motion.common.geometry import SE3
from so101_motion.files import user_storage
from so101_motion.planning.request import Plan
from so101_motion.rig.cell_rigs import CellRigs
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.protocols import RigLike
from so101_motion.setup.identify_operation import IdentifyOperation
from so101_motion.tasks.program import ARM, Solo
from so101_motion.viam.client import MachineRig

from .page import texts
from .page.events import ArmEvents
from .page.operation_panel import OperationPanel
from .page.page_context import ArmContext, PageContext
from .page.screen_state import Sentence, Tone
from .panels.camera_panel import CameraPart
from .panels.health_panel import EventsPart, HealthPart
from .panels.hold_buttons import HoldButtons
from .panels.jog_panel import JogPart
from .panels.move_part import MovePart
from .panels.share_panel import SharePart
from .program.program_panel import ProgramPart
from .searching_page import SearchingPage
from .server.guarded_server import GuardedServer, start_guarded
from .server.kept_key import KeyOf, new_key
from .setup.part import setup_parts
from .source import Source
from .teach.teach_panel import TeachPart
from .world.atlas_panel import AtlasPart
from .world.scene_user import ArmsOfCell, OneArm, SceneUser
from .world.world_panel import WorldPart


class Preview(SearchingPage):
    """A served page of one arm or several."""

    def __init__(self, source: Source, server: GuardedServer, *, plan: Plan | None = None) -> None:
        self._plan = plan
        self._teaches: list[TeachPart] = []
        super().__init__(source, server)

    def stop(self) -> None:
        """Stop all arms and drop all waiting commands; returns when they are at rest."""
        self.host.drop_commands()
        if isinstance(self._opened, CellRigs):
            self._opened.cell.stop()
        elif self._opened is not None:
            self._opened.arm.stop()

    def _end_following(self) -> None:
        """Stop also ends a following that waits for its leader, in which nothing moves yet."""
        for each in self._teaches:
            each.end_following()

    def _add_parts(self, opened: RigLike | CellRigs) -> None:
        host, source = self.host, self._source
        cell = opened if isinstance(opened, CellRigs) else None
        rigs: Mapping[str, RigLike] = cell.rigs if cell else {"": opened}  # type: ignore[dict-item]
        bases = {"": SE3.identity()}
        if cell is not None:
            bases = {each.name: each.T_cell_base for each in cell.file.arms}
        context = host.page_context()
        move = MovePart(
            context,
            rigs,
            None if cell is None else cell.cell,
            bases,
            title=source.title,
            stops=(self.stop, *(rig.gripper.stop for rig in rigs.values()), self._end_following),
            plan=self._plan,
            atlas=source.atlas,
        )
        host.windows.leave_open_as_stop(move.stop_button)
        host.say = move.model.report
        panel = host.gui.add_panel()
        about = [
            HealthPart(host.arm_context(rig), panel, mark=partial(move.mark, name), name=name)
            for name, rig in rigs.items()
        ]
        events = EventsPart(context, panel)
        panel.dock_below(move.panel)
        servos = [
            _servos(context, rig, panel)
            for rig in rigs.values()
            if cell is None and isinstance(rig, HardwareRig)
        ]
        jogs = [
            JogPart(each, move.pages[name], title=name or "Jog")
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
        share = SharePart(context, rigs, move.pages, bases, title=source.title)
        self._teaches = [
            TeachPart(each, source.open_leader, title=name or "Teach", node=move.nodes[name])
            for name, each in self._tab_for_each("Teach", rigs)
        ]
        hold = HoldButtons(
            context, title=source.title, rigs=rigs, guide=program.model.guide, fade=move.fade
        )
        logs = [ArmEvents(rig, partial(self._log, name)) for name, rig in rigs.items()]
        host.add_parts(move, program, world, share, *about, events, *servos, hold, *logs)
        host.add_parts(*self._teaches)
        if cell is None:
            host.add_parts(*setup_parts(host.arm_context(rigs[""]), on_stage=move.set_visible))
        host.add_parts(*jogs)
        if source.atlas is not None:
            aim = move.pages[""].set_target_joints
            host.add_parts(AtlasPart(host.arm_context(rigs[""]), source.atlas, aim))
        if source.camera is not None:
            machine = opened if isinstance(opened, MachineRig) else None
            host.add_parts(CameraPart(context, source.camera, machine))

    def _program(self, opened: RigLike | CellRigs, move: MovePart) -> ProgramPart:
        context = self.host.page_context()
        if isinstance(opened, CellRigs):
            return ProgramPart(context, opened.cell, move.pages, move.nodes, opened.zeros)
        rig = opened
        return ProgramPart(
            context,
            Solo.of(rig),
            {ARM: move.pages[""]},
            {ARM: ""},
            lambda: {ARM: rig.connection.encoder_zeros},
        )

    def _tab_for_each(
        self, title: str, rigs: Mapping[str, RigLike]
    ) -> Iterator[tuple[str, ArmContext]]:
        """A tab with one tab in it for each arm, if there are several: their names and contexts."""
        if "" in rigs:
            yield "", self.host.arm_context(rigs[""])
            return
        with self.host.page_context().tabs.add_tab(title):
            arms = self.host.gui.add_tab_group()
        for name, rig in rigs.items():
            yield name, replace(self.host.arm_context(rig), tabs=arms)

    def _log(self, name: str, text: str, tone: Tone) -> None:
        said = texts.named(name, Sentence(text=text, tone=tone))
        self.host.events.add(said.text, said.tone)


def serve(
    rig: RigLike,
    host: str = "127.0.0.1",
    port: int | None = None,
    *,
    allow_remote: bool = False,
    title: str = "Simulated arm",
    plan: Plan | None = None,
) -> Preview:
    """Show ``rig`` in browsers.

    ``host``, ``port``, ``allow_remote`` and errors are those of ``start_guarded``. ``title`` says
    which arm it is; ``plan`` is shown from the start. Close the preview before the rig.
    """
    source = Source.given(rig, title)
    return serve_source(source, host, port, allow_remote=allow_remote, plan=plan)


def serve_source(
    source: Source,
    host: str = "127.0.0.1",
    port: int | None = None,
    *,
    allow_remote: bool = False,
    plan: Plan | None = None,
    key_of: KeyOf = new_key,
) -> Preview:
    """Serve the page at once, and show the arms of ``source`` as soon as they are there.

    Arguments, result and errors are otherwise those of ``serve`` and ``start_guarded``.
    """
    server = start_guarded(
        host, port, allow_remote=allow_remote, label="SO-101 motion", key_of=key_of
    )
    try:
        return Preview(source, server, plan=plan)
    except BaseException:
        server.close()
        raise


def _servos(context: PageContext, rig: HardwareRig, panel: viser.PanelHandle) -> OperationPanel:
    """The Servos tab: identify this arm's servos, and weigh what it carries."""
    operation = IdentifyOperation(rig)
    servos = OperationPanel(context, lambda: operation)
    with panel.add_tab("Servos", viser.Icon.RULER_MEASURE):
        servos.build(context.gui)
    return servos
