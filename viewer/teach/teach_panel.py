"""The Teach tab: record a path by hand and replay it; follow a leader arm."""

from __future__ import annotations

import viser

from so101_motion.common.geometry import Array
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig
from so101_motion.viam.client import MachineRig

from ..page import markup
from ..page.page_context import ArmContext
from ..page.part import Part
from ..page.shared_fields import SharedField, UndoButtons, grey
from ..scene.robot_view import segments
from .leading import Leading, OpenLeader, session_for
from .machine_teaching import MachineTeaching
from .path_teaching import PathTeaching
from .teaching import Doing, Teaching

_NONE = "none"
_COLOR = (12, 133, 153)


class TeachPart(Part):
    """The widgets of the Teach tab.

    Args:
        open_leader: Opens the leader arm, if there is one on this computer.
        title: What the tab is called.
        node: The node in the scene that stands where the arm's base does.
    """

    def __init__(
        self,
        context: ArmContext,
        open_leader: OpenLeader | None = None,
        *,
        title: str = "Teach",
        node: str = "",
    ) -> None:
        rig = context.rig
        self._scene, self._node = context.server.scene, f"{node}/teach/path"
        self.teaching = _teaching_for(rig, context)
        session = session_for(rig, open_leader)
        self.leading = None if session is None else Leading(session, context.in_background)
        self._drawn: Array | None = None
        self._line: viser.LineSegmentsHandle | None = None
        self._shown: object = None
        if self.teaching is None and self.leading is None:
            return
        self._context = context
        with context.tabs.add_tab(title):
            if self.teaching is not None:
                self._add_path(context.gui, self.teaching)
            if self.leading is not None:
                self._add_leader(context.gui, self.leading)

    def _add_path(self, gui: viser.GuiApi, teaching: Teaching) -> None:
        context = self._context.reporting(teaching.report)
        self._sentence = gui.add_html("")
        self._record = gui.add_button("Record a path", icon=viser.Icon.PLAYER_RECORD)
        self._plan = gui.add_button("Plan replay", icon=viser.Icon.ROUTE)
        self._run = gui.add_button("Replay", icon=viser.Icon.PLAYER_PLAY, color="green")
        context.on_press(self._record, self._switch_recording)
        context.on_press(self._plan, teaching.plan)
        context.on_press(self._run, teaching.run)
        with gui.add_folder("Save and load", expand_by_default=False):
            name = gui.add_text("Path name", "")
            self._name = SharedField(name, teaching.call, context, shown=str)
            self._write = None
            if isinstance(teaching, PathTeaching):
                self._write = gui.add_button_group("Path", ("save",))
                context.on_choice(self._write, lambda _name: teaching.save())
            self._saved = gui.add_dropdown("Saved", (_NONE,))
            self._use = gui.add_button_group("Saved one", ("load", "delete"))
            self._undo = UndoButtons(context, "Files", teaching.saved_files)
        use = {"load": teaching.load, "delete": teaching.delete}
        context.on_choice(self._use, lambda what: use[what](self._saved.value))

    def _add_leader(self, gui: viser.GuiApi, leading: Leading) -> None:
        gui.add_divider()
        self._follows = gui.add_html("")
        self._follow = gui.add_button("Follow the leader", icon=viser.Icon.COPY)
        self._context.on_press(self._follow, leading.toggle)

    def _switch_recording(self) -> None:
        assert self.teaching is not None  # its button was made
        if self.teaching.doing is Doing.RECORDING:
            self.teaching.end_recording()
        else:
            self.teaching.record()

    def refresh(self) -> bool:
        """Take in what has happened; return whether anything is new."""
        teaching, leading, before = self.teaching, self.leading, self._shown
        state: list[object] = []
        is_drawn = teaching is None or teaching.line is self._drawn  # arrays cannot be compared
        if teaching is not None:
            teaching.refresh()
            state += [teaching.sentence, teaching.doing, teaching.can_run]
            state += [teaching.can_plan, teaching.can_record, teaching.names, teaching.name]
        if leading is not None:
            leading.refresh()
            state += [leading.sentence, leading.is_on, leading.can_switch]
        self._shown = state
        return before is None or not is_drawn or state != before

    def show(self) -> None:
        """Update the widgets."""
        if self.teaching is not None:
            self._show_path(self.teaching)
        if self.leading is not None:
            self._follows.content = markup.sentence(self.leading.sentence)
            self._follow.label = "End following" if self.leading.is_on else "Follow the leader"
            self._follow.disabled = not self.leading.can_switch

    def _show_path(self, teaching: Teaching) -> None:
        self._sentence.content = markup.sentence(teaching.sentence)
        records = teaching.doing is Doing.RECORDING
        self._record.label = "End the recording" if records else "Record a path"
        self._record.disabled = not records and not teaching.can_record
        self._plan.disabled = not teaching.can_plan
        self._run.disabled = not teaching.can_run
        self._name.show(teaching.name)
        if self._write is not None:
            grey(self._write, teaching.line is None)
        saved = teaching.names
        if self._saved.options != (saved or (_NONE,)):
            self._saved.options = saved or (_NONE,)
        grey(self._use, not saved)
        self._undo.show()
        if teaching.line is not self._drawn:
            self._drawn = teaching.line
            self._draw(teaching.line)

    def _draw(self, line: Array | None) -> None:
        """Draw the tool's path."""
        if self._line is not None:
            self._line.remove()
            self._line = None
        if line is not None and len(line) > 1:
            self._line = self._scene.add_line_segments(
                self._node, segments(line), _COLOR, thickness=3.0, thickness_units="screen"
            )

    def close(self) -> None:
        """End the following."""
        if self.leading is not None:
            self.leading.close()


def _teaching_for(rig: RigLike, context: ArmContext) -> Teaching | None:
    if isinstance(rig, MachineRig):
        return MachineTeaching(rig, context.in_background)
    return PathTeaching(rig, context.in_background) if isinstance(rig, Rig) else None
