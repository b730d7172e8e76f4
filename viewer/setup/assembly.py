"""The assembly page: what to check at each joint, with a picture.

The picture is our own model of the arm. It swings the chosen joint, to show which part its motor
moves; the real arm does not move.
"""

from __future__ import annotations

import math
import time

import numpy as np
import viser

from so101_motion.calib.motors.setup_view import MOVES
from so101_motion.calib.record.record import JOINTS, SERVO_IDS
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.setup.setup_steps import ASSEMBLY

from ..page import cards
from ..page.shared_fields import put
from .page import StepPage
from .setup_context import SetupContext

_SWING, _TURN = to_rad(35.0), 3.0  # swing of a joint to either side [rad], and its period [s]
_PERIOD = 0.1  # between two pictures of it [s]
_MOST_SHOWN = 8.0  # how long it swings [s]
_Q_JAW = 0.6  # [rad]

_BY_HAND = (
    "Turn it by hand from one stop to the other, with the power off: it goes easily, nothing rubs,"
    " and its cables stay loose at both ends."
)
_SPECIAL = {
    "shoulder_pan": "This motor sits in the base; it is the first on the cable, at the adapter.",
    "wrist_roll": "Lead the cable so that it does not wind itself up when the gripper turns.",
    "gripper": "The jaw closes onto the fixed one without sliding past it.",
}


class AssemblyPage(StepPage):
    """The page of the assembly step."""

    def __init__(self, setup: SetupContext) -> None:
        super().__init__(setup, ASSEMBLY)
        self._joint = JOINTS[0]
        self._looked: set[str] = set()
        self._since = self._due = 0.0
        model = RobotModel.load()
        self._ends = model.lower, model.upper

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        gui.add_html(cards.instruction(ASSEMBLY.title, ASSEMBLY.instruction))
        self._card = gui.add_html("")
        self._further = gui.add_button("This joint is right", icon=viser.Icon.CHECK)
        self._left = gui.add_html("")
        self._joints = gui.add_dropdown("Look at", JOINTS, initial_value=self._joint)
        self._setup.context.on_entry(self._joints, self._look_at)
        self._setup.context.on_press(self._further, self._done)

    def enter(self) -> None:
        """Show the first joint."""
        self._looked.clear()
        self._look_at(JOINTS[0])

    def refresh(self) -> bool:
        """Return whether it is time for another picture."""
        now = time.monotonic()
        if now < self._due or now - self._since > _MOST_SHOWN:
            return False
        self._due = now + _PERIOD
        return True

    def show(self) -> None:
        """Swing the joint in the picture."""
        joint, picture = self._joint, self._setup.picture
        picture.light((joint,))
        t = min(time.monotonic() - self._since, _MOST_SHOWN)
        off = _SWING * math.sin(2.0 * math.pi * t / _TURN) if t < _MOST_SHOWN else 0.0
        q, q_jaw = np.zeros(5), _Q_JAW
        if joint in ARM_JOINTS:
            q[ARM_JOINTS.index(joint)] = off
        else:
            q_jaw += 0.6 * off
        picture.move(np.clip(q, *self._ends), q_jaw)
        words = f"Motor {SERVO_IDS[joint]} {MOVES[joint]}. {_BY_HAND} {_SPECIAL.get(joint, '')}"
        self._card.content = cards.instruction(joint, words)
        left = self._unlooked
        self._left.content = (
            cards.note(f"Still to check: {', '.join(left)}.")
            if left
            else cards.good("All six are right. Press Next.")
        )

    def can_go_on(self) -> str | None:
        """Always None: nothing measures whether a screw is tight."""
        return None

    def is_next_due(self) -> bool:
        """Whether all joints were looked at."""
        return not self._unlooked

    def _as_it_was(self) -> str:
        return "nothing was changed, and nothing was moved"

    @property
    def _unlooked(self) -> list[str]:
        return [each for each in JOINTS if each not in self._looked]

    # What the widgets do

    def _look_at(self, joint: str) -> None:
        self._joint, self._since, self._due = joint, time.monotonic(), 0.0
        put(self._joints, joint)

    def _done(self) -> None:
        self._looked.add(self._joint)
        if self._unlooked:
            self._look_at(self._unlooked[0])
