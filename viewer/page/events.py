"""Log what happened, and report what an arm does.

``ArmEvents`` compares each state of an arm with the one before, so it logs events of any cause:
this page, another program on the same port, or a hand.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from so101_motion.common.modes import Mode
from so101_motion.common.state import JointState
from so101_motion.common.units import to_mm
from so101_motion.planning.request import Plan
from so101_motion.rig.protocols import RigLike

from .page_context import Part
from .screen_state import Tone

KEPT = 500
"""How many events are remembered; chosen: a day of work."""

_MODES = {
    Mode.LIMP: "The arm is limp",
    Mode.GUIDING: "The arm is guided by hand",
    Mode.HOLDING: "The arm holds",
    Mode.CALIBRATING: "A calibration or setup is using the servos",
}
"""Modes worth an entry; motions have their own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """One event in the log, at a local time; the text is a sentence without a full stop."""

    at: datetime
    text: str
    tone: Tone

    def __str__(self) -> str:
        return f"{self.at:%Y-%m-%d %H:%M:%S} {self.text}"


class EventLog:
    """The last ``KEPT`` events, and a count of all; any thread may use it."""

    def __init__(self) -> None:
        self.count = 0
        self._lock = threading.Lock()
        self._events: deque[Event] = deque(maxlen=KEPT)

    def add(self, text: str, tone: Tone = Tone.PLAIN) -> None:
        """Log ``text`` now; the same text within a second counts as one event."""
        event = Event(at=datetime.now(), text=text.rstrip("."), tone=tone)
        with self._lock:
            if self._events:
                last = self._events[-1]
                if last.text == event.text and (event.at - last.at).total_seconds() < 1.0:
                    return
            self._events.append(event)
            self.count += 1

    def newest(self, most: int = KEPT) -> list[Event]:
        with self._lock:
            return list(self._events)[: -most - 1 : -1]

    def text(self) -> str:
        return "".join(f"{event}\n" for event in reversed(self.newest()))


class ArmEvents(Part):
    """Logs what an arm does; a part of the page without widgets."""

    def __init__(self, rig: RigLike, tell: Callable[[str, Tone], None]) -> None:
        self._rig, self._tell = rig, tell
        self._state = rig.arm.state
        self._plan = _newest(rig)
        self._problem = rig.connection.problem
        self._began = 0.0

    def refresh(self) -> bool:
        before, self._state = self._state, self._rig.arm.state
        self._look_at_connection()
        plan = _newest(self._rig)
        if plan is not None and plan is not self._plan:
            self._tell(f"Planned a {plan.trajectory.duration:.1f} s motion", Tone.PLAIN)
        self._plan = plan
        if self._state is not before:
            self._compare(before, self._state)
        return False

    def _look_at_connection(self) -> None:
        connection, before = self._rig.connection, self._problem
        self._problem = connection.problem
        if connection.problem is None and before is not None:
            self._tell(f"The {connection.to} is back; nothing moves until you ask", Tone.GOOD)
        elif connection.problem is not None and before is None:
            self._tell(f"Lost the {connection.to}: {connection.problem}", Tone.BAD)

    def _compare(self, before: JointState, now: JointState) -> None:
        if now.arm_moving and not before.arm_moving:
            self._began = now.t
            self._tell("The arm moves", Tone.PLAIN)
        elif before.arm_moving and not now.arm_moving:
            x, y, z = np.rint(to_mm(self._rig.arm.T_base().p)) + 0.0  # never "-0"
            lasted = max(now.t - self._began, 0.0)
            arrived = before.mode is Mode.MOVING and now.mode is Mode.HOLDING
            what, after = ("Arrived", "in") if arrived else ("Stopped", "after")
            self._tell(
                f"{what} at ({x:.0f}, {y:.0f}, {z:.0f}) mm {after} {lasted:.1f} s", Tone.PLAIN
            )
        if now.fault != before.fault and now.fault is not None:
            if self._problem is None:
                self._tell(f"Fault: {now.fault}", Tone.BAD)
        elif now.mode is not before.mode and now.mode in _MODES and not _in_motion(before):
            self._tell(_MODES[now.mode], Tone.PLAIN)


def _in_motion(state: JointState) -> bool:
    return state.mode in (Mode.MOVING, Mode.STOPPING)


def _newest(rig: RigLike) -> Plan | None:
    newest = rig.arm.newest
    return newest[1] if newest is not None else None
