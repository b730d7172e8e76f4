"""The Teach tab: record a path by hand and replay it; follow a leader arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import msgspec

from so101_motion.arm.stop_order import NUMBERS, refuse_older
from so101_motion.common.errors import So101Error
from so101_motion.common.operation import Operation, RemoteOperation
from so101_motion.files import user_storage
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig
from so101_motion.tasks.guided.teaching import TeachingOperation
from so101_motion.tasks.teleop.leading import LeadingOperation, view_of
from so101_motion.viam.client import MachineRig

from ..page.page_context import PageContext
from ..panels.task_panel import TaskPart

_LEADER_PERIOD = 1.0  # how often a machine is asked how its arm follows [s]; chosen


class TeachPart(TaskPart):
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
        self._leading = leading_of(rig, open_leader)
        with context.tabs.add_tab(title):
            super().__init__(
                context,
                rig,
                "teaching",
                ("run",),
                lambda rig: TeachingOperation(rig, lambda: user_storage.folder() / "paths"),
                cannot="This arm's module on the machine cannot record or replay a path.",
                node=f"{node}/teach",
                tab="Teach",
                color=(12, 133, 153),
            )
            if self._leading is not None:
                context.gui.add_divider()
                self.add(lambda: self._leading)

    def end_following(self) -> None:
        """End it, also while it starts or waits for the leader; any thread. May take a while."""
        if self._leading is not None:
            with suppress(So101Error):  # an arm that cannot be reached does not follow
                self._leading.ask("stop")


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
