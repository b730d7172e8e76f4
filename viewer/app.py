"""Serve the page of one arm.

The page is up at once; its arm may come later (``source.py``).
"""

from __future__ import annotations

from so101_motion.files import user_storage
from so101_motion.planning.request import Plan
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.protocols import RigLike
from so101_motion.viam.client import MachineRig

from .page.events import ArmEvents
from .page.page_context import ArmContext
from .page.part import Part
from .panels.camera_panel import CameraPart
from .panels.health_panel import EventsPart, HealthPart
from .panels.hold_buttons import HoldButtons
from .panels.identify_panel import IdentifyPart
from .panels.jog_panel import JogPart
from .panels.move_part import MovePart
from .panels.share_panel import SharePart, SharingArm
from .program.program_panel import ProgramPart
from .searching_page import SearchingPage
from .server.guarded_server import GuardedServer, start_guarded
from .server.kept_key import KeyOf, new_key
from .setup.part import setup_parts
from .source import Source
from .teach.teach_panel import TeachPart
from .world.atlas_panel import AtlasPart
from .world.scene_user import OneArm
from .world.world_panel import WorldPart


class Preview(SearchingPage[RigLike]):
    """A served page of one arm."""

    def __init__(self, source: Source, server: GuardedServer, *, plan: Plan | None = None) -> None:
        self._source, self._plan = source, plan
        self._teach: TeachPart | None = None
        super().__init__(source, source.open, server)

    def stop(self) -> None:
        """Stop the arm and drop all waiting commands; returns when the arm is at rest."""
        self.host.drop_commands()
        if self._opened is not None:
            self._opened.arm.stop()

    def _end_following(self) -> None:
        """Stop also ends a following that waits for its leader, in which nothing moves yet."""
        if self._teach is not None and self._teach.leading is not None:
            self._teach.leading.end()

    def _add_parts(self, rig: RigLike) -> None:
        host, title = self.host, self._source.title
        context = host.arm_context(rig)
        move = MovePart(
            context,
            title=title,
            stops=(self.stop, rig.gripper.stop, self._end_following),
            plan=self._plan,
            atlas=self._source.atlas,
        )
        host.windows.leave_open_as_stop(move.stop_button)
        host.say = move.page.report
        jog, program = JogPart(context, move.page), ProgramPart(context, move.page)
        host.add_parts(
            move,
            program,
            WorldPart(
                context,
                OneArm(rig),
                file=self._source.scene_file or user_storage.folder() / "scene.json",
                now=rig.clock.now,
                on_handles=lambda shown: move.set_handles(not shown),
            ),
            SharePart(context, {"": SharingArm(rig=rig, page=move.page)}, title=title),
            *self._about_the_arm(context, move, program),
            (teach := TeachPart(context, self._source.open_leader)),
            *setup_parts(context, on_stage=move.set_visible),
            jog,
        )
        self._teach = teach
        if self._source.atlas is not None:
            atlas = AtlasPart(context, self._source.atlas, move.page.set_target_joints)
            host.add_parts(atlas)
        if self._source.camera is not None:
            machine = rig if isinstance(rig, MachineRig) else None
            host.add_parts(CameraPart(context, self._source.camera, machine))

    def _about_the_arm(
        self, context: ArmContext, move: MovePart, program: ProgramPart
    ) -> tuple[Part, ...]:
        rig, panel = context.rig, context.gui.add_panel()
        health, events = HealthPart(context, panel, mark=move.mark), EventsPart(context, panel)
        panel.dock_below(move.arm_panel)
        servos: tuple[Part, ...] = ()
        if isinstance(rig, HardwareRig):
            servos = (IdentifyPart(context, rig, panel),)
        hold_buttons = HoldButtons(
            context,
            title=self._source.title,
            rigs={"": rig},
            guide=program.model.guide,
            fade=lambda _name, faded: move.fade(faded),
        )
        return (
            health,
            events,
            *servos,
            hold_buttons,
            ArmEvents(context.rig, context.events.add),
        )


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
    """Serve the page at once, and show the arm of ``source`` as soon as it is there.

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
