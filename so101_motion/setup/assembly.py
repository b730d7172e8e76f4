"""The check of an assembled arm, joint by joint, by hand, with the power off.

Nothing measures whether a screw is tight, so a person says that a joint is right. The picture
swings the joint to show which part its motor moves; the real arm does not move.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from so101_motion.calib.motors.setup_view import MOVES
from so101_motion.calib.record.record import JOINTS, SERVO_IDS
from so101_motion.common.errors import ConfigError
from so101_motion.common.operation import Input, LocalOperation, Offer, Picture, Row, View
from so101_motion.common.units import to_rad
from so101_motion.setup.setup_steps import ASSEMBLY

_SWING, _TURN = to_rad(35.0), 3.0  # swing of a joint to either side [rad], and its period [s]
_MOST_SHOWN = 8.0  # how long it swings [s]
_DRAWN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.6)  # [rad]; the jaw is open, to be seen as a part of its own

_BY_HAND = (
    "Turn it by hand from one stop to the other, with the power off: it goes easily, nothing rubs,"
    " and its cables stay loose at both ends."
)
_SPECIAL = {
    "shoulder_pan": "This motor sits in the base; it is the first on the cable, at the adapter.",
    "wrist_roll": "Route the cable so that it does not wind up when the gripper turns.",
    "gripper": "The jaw closes onto the fixed one without sliding past it.",
}


class AssemblyOperation(LocalOperation):
    """Has a person check each joint of an assembled arm."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._now, self._left = now, list(JOINTS)
        self._joint, self._since = JOINTS[0], now()
        self.commands = {"accept": self._accept, "look_at": self._look_at}

    @property
    def view(self) -> View:
        joint, left = self._joint, self._left
        t = self._now() - self._since
        off = _SWING * math.sin(2.0 * math.pi * t / _TURN) if t < _MOST_SHOWN else 0.0
        q = list(_DRAWN)
        q[JOINTS.index(joint)] += off if joint in JOINTS[:5] else 0.6 * off
        words = f"Motor {SERVO_IDS[joint]} {MOVES[joint]}. {_BY_HAND} {_SPECIAL.get(joint, '')}"
        rows = (
            Row(
                label=each,
                mark="●" if each == joint else "○" if each in left else "✓",
                text=words if each == joint else "",
                tone="dim" if each in left or each == joint else "good",
            )
            for each in JOINTS
        )
        choice = Input(label="Look at", choices=JOINTS)
        look = {"joint": joint}
        return View(
            state=joint,
            title=ASSEMBLY.title,
            text=ASSEMBLY.instruction if left else "All six are right. Press Next.",
            rows=tuple(rows),
            note=f"Still to check: {', '.join(left)}." if left else "",
            offers=(
                Offer(command="accept", title="This joint is right", arguments=look),
                Offer(command="look_at", title="Show", arguments=look, inputs={"joint": choice}),
            ),
            picture=Picture(q=tuple(q), lit=(joint,)),
            is_over=not left,
        )

    def _accept(self, joint: str) -> None:
        self._look_at(joint)
        self._left = [each for each in self._left if each != joint]
        if self._left:
            self._look_at(self._left[0])

    def _look_at(self, joint: str) -> None:
        if joint not in JOINTS:
            raise ConfigError("joint", joint, f"must be one of {', '.join(JOINTS)}")
        self._joint, self._since = joint, self._now()
