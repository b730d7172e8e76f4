"""Log what an arm does, and show the log in the Events tab.

``ArmEvents`` compares each state of an arm with the one before, so it logs events of any cause:
this page, another program on the same port, or a hand.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import viser

from so101_motion.common.modes import Mode
from so101_motion.common.state import JointState
from so101_motion.common.units import to_mm
from so101_motion.planning.request import Plan
from so101_motion.rig.protocols import RigLike

from ..page import markup
from ..page.page_context import PageContext, Part
from ..page.screen_state import Tone
from ..page.target_ik import FRAMES

_LINES = 60  # how many events the page shows; the saved file has all

_POINT = FRAMES[0]  # what a target is for, unless another frame was chosen

_MODES = {
    Mode.LIMP: "The arm is limp",
    Mode.GUIDING: "The arm is guided by hand",
    Mode.HOLDING: "The arm holds",
    Mode.CALIBRATING: "A calibration or setup is using the servos",
}
"""Modes worth an entry; motions have their own."""


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
            x, y, z = np.rint(to_mm(self._rig.arm.T_base(_POINT).p)) + 0.0  # never "-0"
            lasted = max(now.t - self._began, 0.0)
            arrived = before.mode is Mode.MOVING and now.mode is Mode.HOLDING
            what, after = ("Arrived", "in") if arrived else ("Stopped", "after")
            self._tell(
                f"{what} with the {_POINT.replace('_', ' ')} at ({x:.0f}, {y:.0f}, {z:.0f}) mm"
                f" {after} {lasted:.1f} s",
                Tone.PLAIN,
            )
        moved = before.mode in (Mode.MOVING, Mode.STOPPING)
        if now.fault != before.fault and now.fault is not None:
            if self._problem is None:
                self._tell(f"Fault: {now.fault}", Tone.BAD)
        elif now.mode is not before.mode and now.mode in _MODES and not moved:
            does = f"The arm {now.torque}" if now.torque else _MODES[now.mode]
            self._tell(does, Tone.PLAIN)


def _newest(rig: RigLike) -> Plan | None:
    newest = rig.arm.newest
    return newest[1] if newest is not None else None


class EventsPart(Part):
    """Shows the log of events."""

    def __init__(self, context: PageContext, panel: viser.PanelHandle) -> None:
        self._log, self._count = context.events, -1
        with panel.add_tab("Events", viser.Icon.LIST):
            self._events = context.gui.add_html("")
            save = context.gui.add_button("Save events", icon=viser.Icon.DOWNLOAD, color="gray")
        context.leave_open(save)
        context.on_asked(save, self._hand_over)

    def refresh(self) -> bool:
        return self._count != self._log.count

    def show(self) -> None:
        if self._count != self._log.count:
            self._count = self._log.count
            self._events.content = markup.events(self._log.newest(_LINES))

    def _hand_over(self, client: viser.ClientHandle) -> None:
        name = f"so101-events-{time.strftime('%Y%m%d-%H%M%S')}.txt"
        client.send_file_download(name, self._log.text().encode(), save_immediately=True)
