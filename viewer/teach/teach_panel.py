"""The Teach tab: record a path by hand and replay it; follow a leader arm."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from functools import partial
from typing import Any

import numpy as np
import viser

from so101_motion.common.errors import MachineUnavailable
from so101_motion.common.operation import Operation, View
from so101_motion.common.remote_operation import RemoteOperation
from so101_motion.files import user_storage
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig
from so101_motion.tasks.guided.teaching import TeachingOperation
from so101_motion.viam.client import MachineRig

from ..page import markup
from ..page.operation_panel import OperationPanel
from ..page.page_context import ArmContext
from ..page.part import Part
from ..page.screen_state import Sentence, Tone
from ..scene.robot_view import segments
from .leading import Leading, OpenLeader, session_for

_COLOR = (12, 133, 153)
_PERIOD = 0.3  # how often a machine is asked what it teaches [s]; chosen

CANNOT = Sentence(
    text="This arm's module on the machine cannot record or replay a path.", tone=Tone.WARM
)


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
        self._context = context
        self._scene, self._node = context.server.scene, f"{node}/teach/path"
        self._opening: Future[Operation] | None = self._open(context.rig)
        session = session_for(context.rig, open_leader)
        self.leading = None if session is None else Leading(session, context.in_background)
        self._drawn: tuple[tuple[float, ...], ...] = ()
        self._line: viser.LineSegmentsHandle | None = None
        self._shown: object = None
        self._panel = OperationPanel(context, self._teaching, draw=self._draw)
        if self._opening is None and self.leading is None:
            return
        with context.tabs.add_tab(title):
            if self._opening is not None:
                self._cannot = context.gui.add_html("", visible=False)
                self._panel.build(context.gui)
            if self.leading is not None:
                self._add_leader(context.gui, self.leading)

    def _open(self, rig: RigLike) -> Future[Operation] | None:
        if isinstance(rig, MachineRig):
            return self._context.in_background(partial(teaching_on, rig))
        if not isinstance(rig, Rig):
            return None
        local: Future[Operation] = Future()
        local.set_result(TeachingOperation(rig, lambda: user_storage.folder() / "paths"))
        return local

    def _teaching(self) -> Operation | None:
        """The operation, once it is known."""
        opening = self._opening
        if opening is None or not opening.done():
            return None
        error = opening.exception()
        if isinstance(error, MachineUnavailable):
            self._opening = self._open(self._context.rig)
        return None if error is not None else opening.result()

    @property
    def _is_impossible(self) -> bool:
        opening = self._opening
        return opening is not None and opening.done() and opening.exception() is not None

    def _add_leader(self, gui: viser.GuiApi, leading: Leading) -> None:
        gui.add_divider()
        self._follows = gui.add_html("")
        self._follow = gui.add_button("Follow the leader", icon=viser.Icon.COPY)
        self._context.on_press(self._follow, leading.toggle)

    def refresh(self) -> bool:
        """Take in what has happened; return whether anything is new."""
        leading, before = self.leading, self._shown
        state: list[object] = [self._is_impossible]
        is_news = self._opening is not None and self._panel.refresh()
        if leading is not None:
            leading.refresh()
            state += [leading.sentence, leading.is_on, leading.can_switch]
        self._shown = state
        return is_news or state != before

    def show(self) -> None:
        """Update the widgets."""
        if self._opening is not None:
            self._cannot.visible = self._is_impossible
            self._cannot.content = markup.sentence(CANNOT)
            self._panel.show()
        if self.leading is not None:
            self._follows.content = markup.sentence(self.leading.sentence)
            self._follow.label = "End following" if self.leading.is_on else "Follow the leader"
            self._follow.disabled = not self.leading.can_switch

    def _draw(self, view: View) -> None:
        """Draw the tool's path."""
        line = () if view.picture is None else view.picture.line
        if line == self._drawn:
            return
        self._drawn = line
        if self._line is not None:
            self._line.remove()
            self._line = None
        if len(line) > 1:
            self._line = self._scene.add_line_segments(
                self._node, segments(np.array(line)), _COLOR, thickness=3.0,
                thickness_units="screen",
            )  # fmt: skip

    def close(self) -> None:
        """End the following and what is being recorded."""
        if self.leading is not None:
            self.leading.close()
        self._panel.close()


def teaching_on(rig: MachineRig) -> Operation:
    """The teaching of a machine's arm; a replay is a motion that Stop here ends.

    Raises:
        MachineRefused: It is not an arm of this module.
        MachineUnavailable: It does not answer.
    """

    def send(request: Mapping[str, Any]) -> Mapping[str, Any]:
        if request.get("ask") == "run":
            rig.start_request(request).result()
            return {"answer": "{}"}
        return rig.do_command(rig.arm_name, request)

    return RemoteOperation(send, "teaching", period=_PERIOD)
