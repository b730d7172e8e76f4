"""Serve the preview page of one arm.

The page is up at once; its arm may come later (``source.py``).
"""

from __future__ import annotations

from so101_motion.planning.request import Plan
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.protocols import RigLike

from .page.events import ArmEvents
from .page.page_context import ArmContext
from .page.part import Part
from .panels.camera_panel import CameraPart
from .panels.health_panel import HealthPart
from .panels.identify_panel import IdentifyPart
from .panels.jog_panel import JogPart
from .panels.move_part import MovePart
from .panels.share_panel import SharePart
from .panels.ways_home import WaysHome, waiting
from .program.program_panel import ProgramPart
from .server.guarded_server import GuardedServer, start_guarded
from .server.host import ServedPage
from .server.kept_key import KeyOf, new_key
from .setup.part import setup_parts
from .source import Source, SourceOpener
from .teach.teach_panel import TeachPart
from .world.atlas_panel import AtlasPart
from .world.world_panel import WorldPart


class Preview(ServedPage):
    """A served preview page."""

    def __init__(self, source: Source, server: GuardedServer, *, plan: Plan | None = None) -> None:
        super().__init__(server)
        self._source, self._plan = source, plan
        self._rig: RigLike | None = None
        self._search: SourceOpener | None = None
        self.host.say = self._missed
        if source.lasts:
            self._add_parts(source.open())
        else:
            waiting(self.host.bar, source.title)
        self.host.start()
        if not source.lasts:
            self._search = SourceOpener(source, found=self._found, failed=self._missed)

    def stop(self) -> None:
        """Stop the arm and drop all waiting commands; returns when the arm is at rest."""
        self.host.drop_commands()
        if self._rig is not None:
            self._rig.arm.stop()

    def close(self) -> None:
        """Stop serving. A rig that was passed in stays open; one that was opened is closed."""
        if self._search is not None:
            self._search.close()
        self.host.close()
        rig, self._rig = self._rig, None
        if rig is not None and not self._source.lasts:
            rig.close()

    # Looking for the arm

    def _missed(self, error: Exception) -> None:
        self.host.post(lambda: waiting(self.host.bar, self._source.title, error))

    def _found(self, rig: RigLike) -> None:
        self._rig = rig
        self.host.post(lambda: self._add_parts(rig))

    # The parts

    def _add_parts(self, rig: RigLike) -> None:
        self._rig = rig
        host, title = self.host, self._source.title
        context = host.arm_context(rig)
        move = MovePart(context, title=title, stops=(self.stop, rig.gripper.stop), plan=self._plan)
        host.windows.leave_open_as_stop(move.stop_button)
        host.say = move.page.report
        jog, program = JogPart(context, move.page), ProgramPart(context, move.page)
        host.add_parts(
            move,
            program,
            WorldPart(
                context,
                file=self._source.scene_file,
                on_handles=lambda shown: move.set_handles(not shown),
            ),
            SharePart(context, move.page, title=title),
            *self._about_the_arm(context, move, program),
            TeachPart(context, self._source.open_leader),
            *setup_parts(context, on_stage=move.set_visible),
            jog,
        )
        if self._source.atlas is not None:
            atlas = AtlasPart(context, self._source.atlas, move.page.set_target_joints)
            host.add_parts(atlas)
        if self._source.camera is not None:
            host.add_parts(CameraPart(context, self._source.camera))
        host.events.add(f"{title}: connected")

    def _about_the_arm(
        self, context: ArmContext, move: MovePart, program: ProgramPart
    ) -> tuple[Part, ...]:
        health = HealthPart(context, mark=move.mark)
        health.panel.dock_below(move.arm_panel)
        rig = context.rig
        servos: tuple[Part, ...] = ()
        if isinstance(rig, HardwareRig):
            servos = (IdentifyPart(context, rig, health.panel),)
        return (
            health,
            *servos,
            WaysHome(context, title=self._source.title, guide=program.model.guide, fade=move.fade),
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
