"""The page that lets the joints go limp and takes the homing pose.

A ghost shows the pose, and the drawn arm moves as the real one does. The person has both hands on
the arm, so the pose is taken once the arm has been still for a moment after the button.
"""

from __future__ import annotations

import time
from functools import partial

import numpy as np
import viser

from so101_motion.calib.procedure import summary
from so101_motion.calib.procedure.pose_estimate import HOMING_POSE, PoseEstimate
from so101_motion.calib.procedure.steps import Command, State
from so101_motion.calib.procedure.stillness import STILL, Stillness
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.setup.setup_steps import POSE

from ..page.shared_fields import SharedField
from . import calibration_cards, cards
from .page import CalibrationPage
from .setup_context import SetupContext
from .setup_target import SetupTarget

_LET_GO = (
    "Hold the arm with one hand, then press Let go of the joints: it sinks at once. Nothing is"
    " written to the motors yet."
)
_MATCH = (
    "Match the blue ghost: upper arm upright, forearm and gripper level and straight ahead, the jaw"
    " half open. Then turn the gripper until it opens straight upwards, and look closely: this"
    " position becomes its zero."
)
_TAKEN = "The pose is taken. Press Next."

ALONE = 3.0
"""How long the arm must be held still for its pose to be taken without the button [s]; chosen:
longer than a hand rests in between."""

MOVED = 114
"""How far a joint must have been moved before [tick], 10 deg; else an arm that just lies there
would count as held. Chosen."""


class PosePage(CalibrationPage):
    """The page of the homing pose."""

    def __init__(self, setup: SetupContext) -> None:
        super().__init__(setup, POSE)
        self._stillness: Stillness | None = None  # while the pose is about to be taken
        self._still = 0.0
        self._begun_at: dict[str, int | None] | None = None  # while it is taken without the button
        self._has_moved = False  # since then

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        self._todo = gui.add_html("")
        self._hints = gui.add_html("")
        self._let_go = gui.add_button("Let go of the joints", icon=viser.Icon.HAND_GRAB)
        self._take = gui.add_button(
            "I hold it there", icon=viser.Icon.CHECK, color="green", visible=False
        )
        alone = gui.add_checkbox(
            "Take it when I hold still",
            False,
            hint=f"When both hands are busy: taken after {ALONE:g} s without motion",
            visible=False,
        )
        self._alone = SharedField(alone, self._go_alone, self._setup.context, shown=bool)
        self._again = gui.add_button(
            "Take the pose again", icon=viser.Icon.REPEAT, color="gray", visible=False
        )
        self._mend = gui.add_button(
            "Restore the motors' settings", icon=viser.Icon.ARROW_BACK_UP, visible=False
        )
        self._status = gui.add_html("")
        on_press = self._setup.context.on_press
        on_press(self._let_go, self._start)
        on_press(self._take, self._wait_for_stillness)
        on_press(self._again, self._start_over)
        on_press(self._mend, self._put_back)

    def enter(self) -> None:
        """Show the pose."""
        self._stillness = self._begun_at = None

    def leave(self) -> None:
        """Do not take a pose that was about to be taken."""
        self._stillness = None

    def refresh(self) -> bool:
        """Read the arm; take the pose once it has been still."""
        news = super().refresh()
        return self._await_stillness() or news

    def show(self) -> None:
        """Show the instruction, and how near each joint is."""
        now, busy = self._now, bool(self._setup.doing)
        if now is None:
            return
        state = now.view.state
        seen = self._draw(now)
        self._show_pose(state, seen)
        taken = state in (State.HOMED, State.RECORDING, State.COMPLETED)
        text = {State.IDLE: _LET_GO, State.STARTED: _MATCH, State.ERROR: ""}.get(state, _TAKEN)
        self._todo.content = cards.instruction(POSE.title, text)
        self._let_go.visible = state is State.IDLE
        self._take.visible = state is State.STARTED
        self._again.visible, self._mend.visible = taken, state is State.ERROR
        self._let_go.disabled = self._again.disabled = self._mend.disabled = busy
        is_alone = self._begun_at is not None
        self._take.disabled = busy or (self._stillness is not None and not is_alone)
        self._alone.show(is_alone if state is State.STARTED else None)
        self._say()

    def _show_pose(self, state: State, seen: PoseEstimate) -> None:
        now, picture = self._now, self._setup.picture
        if state is not State.STARTED or now is None:
            picture.ghost(None)
            picture.light(())
            self._hints.content = ""
            return
        q = np.array([HOMING_POSE[joint] for joint in ARM_JOINTS])
        picture.ghost(q, HOMING_POSE[GRIPPER_JOINT])
        hints = summary.hints(now.joints, seen)
        picture.light(tuple(hint.joint for hint in hints if hint.tone == "warm"))
        note = summary.picture_note(seen, now.joints)
        is_all_guessed = all(hint.tone == "dim" for hint in hints)
        table = "" if is_all_guessed else calibration_cards.hints(hints)
        self._hints.content = table + cards.note(note)

    def _say(self) -> None:
        now = self._now
        assert now is not None
        view = now.view
        html = cards.note(view.note or "")
        if self._stillness is not None:
            left = self._needed - self._still
            text = f"hold still: {left:.1f} s more" if self._still else "hold still: it moves"
            if self._begun_at is not None and not self._has_moved:
                text = "bring the arm into the pose, then hold still"
            html += cards.going_on(text)
        elif view.error and not self._setup.trouble:
            html += cards.failed(view.error)
        self._status.content = html

    # What the buttons do

    def _start(self) -> None:
        target = self._setup.target
        if target is None:
            return
        before = summary.in_force(target.calibrator.situation.joints)
        if self._setup.do(
            "letting go of the joints", partial(target.calibrator.step, Command.START)
        ):
            self._setup.before = before
            self._setup.saved = self._setup.tested = None

    def _start_over(self) -> None:
        def again(target: SetupTarget) -> None:
            target.calibrator.step(Command.ABORT)
            target.calibrator.step(Command.START)

        if self._do("restoring the motors' settings, to begin again", again):
            self._setup.saved = self._setup.tested = None

    def _put_back(self) -> None:
        self._do(
            "restoring the motors' settings", lambda target: target.calibrator.step(Command.RESET)
        )

    def _wait_for_stillness(self) -> None:
        if not self._setup.doing:
            self._stillness, self._still, self._begun_at = Stillness(), 0.0, None

    def _go_alone(self, is_alone: bool) -> None:
        """Take the pose without a button, once the arm was moved and then held still."""
        target, self._has_moved, self._still = self._setup.target, False, 0.0
        self._stillness = self._begun_at = None
        if is_alone and target is not None:
            self._stillness, self._begun_at = Stillness(), _ticks(target)

    @property
    def _needed(self) -> float:
        return STILL if self._begun_at is None else ALONE

    def _await_stillness(self) -> bool:
        """Take the pose once the arm is still; return whether anything is new."""
        stillness, target = self._stillness, self._setup.target
        if stillness is None or target is None:
            return False
        if target.calibrator.situation.view.state is not State.STARTED:
            self._stillness = self._begun_at = None
            return True
        ticks = _ticks(target)
        self._still = stillness.feed(time.monotonic(), ticks)
        begun_at = self._begun_at
        self._has_moved = self._has_moved or begun_at is None or _moved(begun_at, ticks)
        if self._still >= self._needed and self._has_moved:
            self._stillness = self._begun_at = None
            self._setup.do("taking the pose", partial(target.calibrator.step, Command.SET_HOMING))
        return True


def _ticks(target: SetupTarget) -> dict[str, int | None]:
    return {joint: view.ticks for joint, view in target.calibrator.situation.joints.items()}


def _moved(before: dict[str, int | None], now: dict[str, int | None]) -> bool:
    """Whether any joint has moved; ticks wrap at 4096."""
    pairs = [(before.get(joint), place) for joint, place in now.items()]
    turned = [(b - a + 2048) % 4096 - 2048 for a, b in pairs if a is not None and b is not None]
    return any(abs(each) > MOVED for each in turned)
