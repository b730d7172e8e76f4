"""The Teach tab: record a path by hand and replay it; follow a leader arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Any

import msgspec
import numpy as np

from so101_motion.arm.stop_order import NUMBERS, refuse_older
from so101_motion.common.errors import MachineUnavailable, So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.operation import Operation, RemoteOperation, View
from so101_motion.files import user_storage
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig
from so101_motion.tasks.guided.teaching import TeachingOperation
from so101_motion.tasks.teleop.leading import LeadingOperation, view_of
from so101_motion.viam.client import MachineRig

from ..page import markup
from ..page.operation_panel import OperationPanel
from ..page.page_context import PageContext, Part
from ..page.screen_state import Sentence, Tone
from ..scene.robot_view import Line, segments

_COLOR = (12, 133, 153)
_LEADER_PERIOD = 1.0  # how often a machine is asked how its arm follows [s]; chosen

CANNOT = Sentence("This arm's module on the machine cannot record or replay a path.", Tone.WARM)


class TeachPart(Part):
    """The widgets of the Teach tab; the leader, if there is one, is on this computer."""

    def __init__(
        self,
        context: PageContext,
        rig: RigLike,
        open_leader: Callable[[], Rig] | None = None,
        *,
        title: str = "Teach",
        node: str = "",
    ) -> None:
        self._context, self._rig = context, rig
        self._line = Line(context.server.scene, f"{node}/teach/path")
        self._opening: Future[Operation] | None = self._open(rig)
        self._leading = leading_of(rig, open_leader)
        self._drawn: tuple[tuple[float, ...], ...] = ()
        self._was_impossible = self._was_faulty = False
        self._panel = OperationPanel(context, self._teaching, draw=self._draw)
        self._leads = OperationPanel(context, lambda: self._leading)
        if self._opening is None and self._leading is None:
            return
        with context.tabs.add_tab(title):
            if self._opening is not None:
                self._cannot = context.gui.add_html("", visible=False)
                self._panel.build(context.gui)
            if self._leading is not None:
                context.gui.add_divider()
                self._leads.build(context.gui)

    def end_following(self) -> None:
        """End it, also while it starts or waits for the leader; any thread. May take a while."""
        if self._leading is not None:
            with suppress(So101Error):  # an arm that cannot be reached does not follow
                self._leading.ask("stop")

    def _open(self, rig: RigLike) -> Future[Operation] | None:
        if isinstance(rig, MachineRig):
            return self._context.in_background(partial(rig.operation, "teaching", ("run",)))
        if not isinstance(rig, Rig):
            return None
        local: Future[Operation] = Future()
        local.set_result(TeachingOperation(rig, lambda: user_storage.folder() / "paths"))
        return local

    def _teaching(self) -> Operation | None:
        opening = self._opening
        if opening is None or not opening.done():
            return None
        error = opening.exception()
        if isinstance(error, MachineUnavailable):
            self._opening = self._open(self._rig)
        return None if error is not None else opening.result()

    @property
    def _is_impossible(self) -> bool:
        opening = self._opening
        return opening is not None and opening.done() and opening.exception() is not None

    def refresh(self) -> bool:
        was_faulty, self._was_faulty = self._was_faulty, self._rig.arm.state.mode is Mode.FAULT
        if was_faulty and not self._was_faulty:
            self._panel.forget_trouble()
            self._leads.forget_trouble()
        was_impossible, self._was_impossible = self._was_impossible, self._is_impossible
        is_news = self._panel.refresh() | self._leads.refresh()
        return is_news or was_impossible != self._was_impossible

    def show(self) -> None:
        if self._opening is not None:
            self._cannot.visible = self._is_impossible
            self._cannot.content = markup.sentence(CANNOT)
        self._panel.show()
        self._leads.show()

    def _draw(self, view: View) -> None:
        line = () if view.picture is None else view.picture.line
        if line == self._drawn:
            return
        self._drawn = line
        self._line.show(segments(np.array(line)) if len(line) > 1 else None, _COLOR)

    def close(self) -> None:
        self._leads.close()
        self._panel.close()


def leading_of(rig: RigLike, open_leader: Callable[[], Rig] | None) -> Operation | None:
    if isinstance(rig, MachineRig):
        for each in rig.resources:
            service = _TeleopService(rig, each.name)
            if each.api == "service:generic" and service.is_ours():
                return RemoteOperation(service, "leading", period=_LEADER_PERIOD)
        return None
    if isinstance(rig, Rig) and open_leader is not None:
        return LeadingOperation(rig, open_leader)
    return None


class _TeleopService:
    """A machine's teleoperation service, as a ``RemoteOperation`` uses it."""

    def __init__(self, rig: MachineRig, name: str) -> None:
        self._rig, self._name, self._stopped = rig, name, 0

    def is_ours(self) -> bool:
        try:
            return "consecutive_errors" in self._status()
        except So101Error:
            return False

    def __call__(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        command = request.get("ask")
        if command is None:
            return {"view": msgspec.json.encode(view_of(self._status()))}
        if command == "stop":
            self._stopped = next(NUMBERS)
        else:
            refuse_older(self._stopped)
        return {"answer": msgspec.json.encode(self._do(command))}

    def _status(self) -> Mapping[str, Any]:
        return self._do("status")

    def _do(self, command: str) -> Mapping[str, Any]:
        return self._rig.do_command(self._name, {"command": command})
