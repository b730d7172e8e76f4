"""The page on which the joints go limp and are held in the homing pose.

A ghost shows the pose, the arm beside it moves as the real one does. The person has both hands on
the arm when the pose is to be taken, so the button only says that it is there: it is taken once the
arm has been held still for a moment.
"""

from __future__ import annotations

import time

import numpy as np
import viser

from so101_motion.calib.likely import HOMING_POSE, Likely
from so101_motion.calib.steps import State
from so101_motion.calib.stillness import STILL, Stillness
from so101_motion.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.workflow import POSE

from . import calibrating, calibration_cards, cards
from .bench import Bench
from .page import CalibrationPage
from .workshop import Workshop

_LET_GO = (
    "The arm must be screwed together by now; that takes an hour or two, and this page waits. Hold"
    " the arm with one hand, then let go of its joints: it sinks at once. Nothing is written to the"
    " motors yet."
)
_MATCH = (
    "Match the blue ghost: upper arm upright, forearm and gripper level and straight ahead, the jaw"
    " half open. Then turn the gripper until it opens straight upwards, and look closely: how you"
    " hold it is what it takes for straight from now on."
)
_TAKEN = "The pose is taken. Relax, and go on."


class PosePage(CalibrationPage):
    """The page of the homing pose.

    Args:
        shop: What all pages share.
    """

    def __init__(self, shop: Workshop) -> None:
        super().__init__(shop, POSE)
        self._stillness: Stillness | None = None  # while the pose is about to be taken
        self._still = 0.0

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        self._todo = gui.add_html("")
        self._hints = gui.add_html("")
        self._let_go = gui.add_button("Let go of the joints", icon=viser.Icon.HAND_GRAB)
        self._take = gui.add_button(
            "I hold it there", icon=viser.Icon.CHECK, color="green", visible=False
        )
        self._again = gui.add_button(
            "Take the pose again", icon=viser.Icon.REPEAT, color="gray", visible=False
        )
        self._mend = gui.add_button(
            "Put the motors back", icon=viser.Icon.ARROW_BACK_UP, visible=False
        )
        self._said = gui.add_html("")
        on_press = self._shop.desk.on_press
        on_press(self._let_go, self._start)
        on_press(self._take, self._wait_for_stillness)
        on_press(self._again, self._start_over)
        on_press(self._mend, self._put_back)

    def enter(self) -> None:
        """Show the pose."""
        self._stillness = None

    def leave(self) -> None:
        """A pose that is about to be taken is not."""
        self._stillness = None

    def refresh(self) -> bool:
        """Look at the arm; take the pose when it has been still."""
        news = super().refresh()
        return self._await_stillness() or news

    def show(self) -> None:
        """Tell what to do, and how near each joint is."""
        now, busy = self._watch.now, bool(self._shop.doing)
        if now is None:
            return
        state = now.view.state
        seen = self._watch.draw()
        assert seen is not None  # there is a situation
        self._show_pose(state, seen)
        taken = state in (State.HOMED, State.RECORDING, State.COMPLETED)
        text = {State.IDLE: _LET_GO, State.STARTED: _MATCH, State.ERROR: ""}.get(state, _TAKEN)
        self._todo.content = cards.instruction(POSE.title, text)
        self._let_go.visible = state is State.IDLE
        self._take.visible = state is State.STARTED
        self._again.visible, self._mend.visible = taken, state is State.ERROR
        self._let_go.disabled = self._again.disabled = self._mend.disabled = busy
        self._take.disabled = busy or self._stillness is not None
        self._say()

    def _show_pose(self, state: State, seen: Likely) -> None:
        now, picture = self._watch.now, self._shop.picture
        if state is not State.STARTED or now is None:
            picture.ghost(None)
            picture.light(())
            self._hints.content = ""
            return
        q = np.array([HOMING_POSE[joint] for joint in ARM_JOINTS])
        picture.ghost(q, HOMING_POSE[GRIPPER_JOINT])
        told = calibrating.hints(now.joints, seen)
        picture.light(tuple(hint.joint for hint in told if hint.tone == "warm"))
        note = calibrating.picture_note(seen, now.joints)
        is_all_guessed = all(hint.tone == "dim" for hint in told)
        table = "" if is_all_guessed else calibration_cards.hints(told)
        self._hints.content = table + cards.note(note)

    def _say(self) -> None:
        now = self._watch.now
        assert now is not None
        view = now.view
        said = cards.note(view.note or "")
        if self._stillness is not None:
            left = STILL - self._still
            told = f"hold still: {left:.1f} s more" if self._still else "hold still: it moves"
            said += cards.going_on(told)
        elif view.error and not self._shop.trouble:
            said += cards.failed(view.error)
        self._said.content = said

    # What the buttons do

    def _start(self) -> None:
        bench = self._shop.bench
        if bench is None:
            return
        before = calibrating.in_force(bench.calibrator.situation.joints)
        if self._shop.do("letting go of the joints", bench.calibrator.start):
            self._shop.before = before
            self._shop.saved = self._shop.tested = None

    def _start_over(self) -> None:
        def again(bench: Bench) -> None:
            bench.calibrator.abort()
            bench.calibrator.start()

        if self._do("putting the motors back, to begin again", again):
            self._shop.saved = self._shop.tested = None

    def _put_back(self) -> None:
        self._do("putting the motors back", lambda bench: bench.calibrator.reset())

    def _wait_for_stillness(self) -> None:
        if not self._shop.doing:
            self._stillness, self._still = Stillness(), 0.0

    def _await_stillness(self) -> bool:
        """Take the pose once the arm is still; whether there is something to tell about that."""
        stillness, bench = self._stillness, self._shop.bench
        if stillness is None or bench is None:
            return False
        now = bench.calibrator.situation
        if now.view.state is not State.STARTED:
            self._stillness = None
            return True
        ticks = {joint: view.ticks for joint, view in now.joints.items()}
        self._still = stillness.feed(time.monotonic(), ticks)
        if self._still >= STILL:
            self._stillness = None
            self._shop.do("taking the pose", bench.calibrator.set_homing)
        return True
