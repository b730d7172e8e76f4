"""Following a leader as an operation: one command starts it, another ends it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from so101_motion.arm.stop_order import NUMBERS, STOP, request_number
from so101_motion.common.errors import Interrupted
from so101_motion.common.operation import LocalOperation, Offer, View
from so101_motion.rig.rig import Rig
from so101_motion.tasks.teleop.pilot import Phase
from so101_motion.tasks.teleop.session import Teleop
from so101_motion.tasks.teleop.sides import LocalArm, LocalFollower, LocalLeader

OFF = "Keep a hand on the leader: it goes limp, and this arm moves to it slowly."


class LeadingOperation(LocalOperation):
    """Lets an arm follow a leader on another port, opened at the first start."""

    def __init__(self, follower: Rig, open_leader: Callable[[], Rig]) -> None:
        super().__init__()
        self._follower, self._open = follower, open_leader
        self._leader: Rig | None = None
        self._teleop: Teleop | None = None
        self._stopped = 0  # the number of the newest stop, see ``stop_order.py``
        self.commands = {"start": self._start, "stop": self._stop}

    @property
    def view(self) -> View:
        teleop = self._teleop
        return view_of({"running": False} if teleop is None else teleop.status.to_json())

    def close(self) -> None:
        """End it, and close the leader."""
        if self._teleop is not None:
            self._teleop.close()
        if self._leader is not None:
            self._leader.close()

    def _start(self) -> None:
        asked = request_number()
        self._refuse_stopped(asked)
        if self._leader is None:
            self._leader = self._open()
        if self._teleop is None:
            self._teleop = Teleop(
                LocalLeader(LocalArm(station=self._leader, jaw=self._leader)),
                LocalFollower(LocalArm(station=self._follower, jaw=self._follower)),
                self._follower.clock,
            )
        self._refuse_stopped(asked)
        self._teleop.start()
        self._refuse_stopped(asked)  # it starts in a thread that does not know the request

    def _stop(self) -> None:
        self._stopped = next(NUMBERS)
        if self._teleop is not None:
            self._teleop.stop()

    def _refuse_stopped(self, asked: int) -> None:
        """End a start during which somebody stopped."""
        if self._stopped > asked:
            if self._teleop is not None:
                self._teleop.stop()
            raise Interrupted(STOP)


def view_of(status: Mapping[str, Any]) -> View:
    """The view of a teleoperation with this status, as ``Status.to_json`` has it."""
    if not status["running"]:
        start = Offer(command="start", title="Follow the leader")
        return View(state=Phase.STOPPED.value, text=OFF, offers=(start,))
    stop = Offer(command="stop", title="End following")
    return View(state=status["state"], text=_sentence(status), offers=(stop,))


def _sentence(status: Mapping[str, Any]) -> str:
    joint, gap = status["gap_joint"], status["gap_deg"]
    if status["state"] == Phase.APPROACHING.value:
        return f"Moving to the leader: {joint} is {gap:.0f}° away."
    if status["state"] == Phase.WAITING.value:
        where = f" {joint} is {gap:.0f}° from this arm's." if joint else ""
        return f"Holding: {status['reason']}.{where} Move the leader back to it."
    more = [f"in its way: {', '.join(status['held_by'])}"] if status["held_back"] else []
    if status["beyond_range"]:
        more.append(f"{', '.join(status['beyond_range'])} beyond this arm's range")
    if status["gripping"]:
        more.append("gripping")
    return "; ".join(("Following the leader", *more)) + "."
