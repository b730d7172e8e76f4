"""The page that gives one motor after the other its id.

The page looks for the motor by itself, again and again. It writes only when somebody presses the
button that says what will be written. Every failure names its cause and what to do.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import viser

from so101_motion.calib.motors.setup_view import (
    AS_NEW,
    SETUP_ORDER,
    MotorView,
    SetupView,
    connect_alone,
)
from so101_motion.setup.setup_steps import MOTORS

from ..page.shared_fields import put
from ..page.texts import capital
from . import cards
from .asking_button import AskingButton
from .cards import MotorLook
from .page import StepPage
from .picture import GREEN, ORANGE
from .setup_context import SetupContext

PAUSE = 0.6
"""How long to wait between two looks at the cable [s]; chosen: a look alone takes up to two."""

PATIENCE = 12.0
"""After this long without an answer the page says what may be wrong [s]; chosen: time to unplug one
motor and plug in another."""

_LOOKING = (
    "Watching the cable; nothing to press yet. The six motors of a follower's kit are alike: take"
    " any. Those of a leader differ: see its guide for which goes where."
)

_NONE = "none"
_SWAPPED = "No, this is already the next motor"
_START_OVER, _SURE = "Start over with the gripper", "Press again to start over"
_NOBODY = "no servo answers"
_SILENT = (
    "No motor has answered for a while. Is the power supply on, and the motor's cable plugged into"
    " the adapter? Try its other socket and another cable. A motor that still does not answer is"
    " dead: replace it or skip it."
)


class MotorCards:
    """The content of the motor cards, and which buttons are enabled.

    Args:
        now: The time [s].
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._due = 0.0
        self._silent: tuple[str, float] | None = None  # whose motor is missing, and since when
        self.picked: str | None = None

    def joint(self, view: SetupView) -> str | None:
        """The joint whose motor is asked for; None when all are done."""
        return self.picked or view.next_joint

    def wants_to_look(self, view: SetupView) -> str | None:
        """The joint whose motor is to be looked for now; None if it is not time."""
        return None if self._now() < self._due else self.joint(view)

    def looked(self, view: SetupView) -> None:
        """Note that a look has ended; the next one comes later."""
        self._due = self._now() + PAUSE
        joint = self.joint(view)
        if joint is None or _NOBODY not in view.motors[joint].sentence:
            self._silent = None
        elif self._silent is None or self._silent[0] != joint:
            self._silent = (joint, self._now())

    @property
    def hint(self) -> str:
        """What may be wrong when no motor answers; empty at first."""
        is_long = self._silent is not None and self._now() - self._silent[1] > PATIENCE
        return _SILENT if is_long else ""

    def look_again(self) -> None:
        """Look again at once."""
        self._due = 0.0

    def owner(self, view: SetupView) -> str | None:
        """The other joint whose id the found motor has; None if it may be written to."""
        joint = self.joint(view)
        if joint is None or view.motors[joint].state != "found":
            return None
        return view.owner(view.motors[joint].found_id, but=joint)

    def can_write(self, view: SetupView) -> bool:
        """Whether a motor can be written to, and has no problem to fix first."""
        joint = self.joint(view)
        if joint is None or view.motors[joint].state != "found" or view.motors[joint].fix:
            return False
        return self.owner(view) is None

    def look(self, view: SetupView, motor: MotorView) -> tuple[MotorLook, str, str]:
        """The colour and text of a motor's card, and what to do."""
        if motor.state in ("configured", "verified"):
            return "done", motor.sentence, ""
        if motor.joint != self.joint(view):
            return ("skipped" if motor.state == "skipped" else "waiting"), "", ""
        if motor.state == "found":
            if self.owner(view):  # the last motor is still plugged in
                return "now", self.request(view, motor.joint), ""
            return ("trouble" if motor.fix else "found"), _found(motor), motor.fix
        if motor.state == "failed" and _NOBODY not in motor.sentence:
            return (
                "trouble",
                motor.sentence,
                motor.fix.removesuffix(f"; then discover {motor.joint} again"),
            )
        return "now", self.request(view, motor.joint), ""

    @staticmethod
    def request(view: SetupView, joint: str) -> str:
        """Which motor to plug in or out now."""
        found = view.motors[joint].found_id
        settled = [m for m in view.motors.values() if m.state == "configured"]
        there = [m.joint for m in settled if m.target_id == found != AS_NEW]
        done = there or [m.joint for m in settled]
        unplug = ""
        if done:
            number = view.motors[done[-1]].target_id
            unplug = f"unplug the motor of {done[-1]} and write {number} on it, then "
        return unplug + connect_alone(joint)


def _found(motor: MotorView) -> str:
    """What was found, without what is shown above it already."""
    if motor.fix or motor.model is None or motor.volts is None:
        return motor.sentence
    return f"found it: {motor.model}, firmware {motor.firmware}, {motor.volts:.1f} V"


class MotorsPage(StepPage):
    """The page of the motor step."""

    def __init__(self, setup: SetupContext) -> None:
        super().__init__(setup, MOTORS)
        self.model = MotorCards()
        self._shown: tuple[SetupView, str] | None = None
        self._is_here = False

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        gui.add_html(cards.instruction(MOTORS.title, MOTORS.instruction))
        self._card = gui.add_html("")
        self._write = gui.add_button("Write", icon=viser.Icon.PENCIL, color="green")
        self._again = gui.add_button("Look again", icon=viser.Icon.REFRESH, color="gray")
        self._skip = gui.add_button("Skip", icon=viser.Icon.PLAYER_SKIP_FORWARD, color="gray")
        self._doing = gui.add_html("")
        self._list = gui.add_html("")
        self._redo = gui.add_dropdown("Set up again", (_NONE, *SETUP_ORDER), initial_value=_NONE)
        self._swapped = AskingButton(
            self._setup.context, _SWAPPED, "Press again: both get new ids", self._swap
        )
        self._anew = AskingButton(self._setup.context, _START_OVER, _SURE, self._begin_anew)
        on_press = self._setup.context.on_press
        on_press(self._write, self._assign)
        on_press(self._again, self.model.look_again)
        on_press(self._skip, self._leave_out)
        self._setup.context.on_entry(self._redo, self._pick)

    def enter(self) -> None:
        """Start looking for motors."""
        self._is_here, self._shown = True, None
        self.model.look_again()

    def leave(self) -> None:
        """Stop looking; a running look ends by itself."""
        self._is_here = False

    def refresh(self) -> bool:
        """Look for a motor if it is time; return whether anything has changed."""
        view = self._view
        target, joint = self._setup.target, self.model.wants_to_look(view)
        if target is not None and joint is not None and self._is_here:
            look = partial(target.calibrator.motor_setup.discover, joint)
            self._setup.watch(look, lambda: self.model.looked(self._view))
        for motor in view.motors.values():
            if motor.state in ("configured", "verified"):
                self._setup.progress.add(motor.joint)
        now = (replace(view, doing=""), self.model.hint)
        is_news, self._shown = now != self._shown, now
        return any((self._anew.refresh(), self._swapped.refresh(), is_news))

    def show(self) -> None:
        """Show the state of each motor, and highlight the one asked for."""
        view, model = self._view, self.model
        joint = model.joint(view)
        looks = {motor.joint: model.look(view, motor) for motor in view.motors.values()}
        self._list.content = cards.motor_list(
            (motor, looks[motor.joint][0]) for motor in view.motors.values()
        )
        self._card.visible = joint is not None
        if joint is not None:
            state, words, fix = looks[joint]
            self._card.content = cards.motor(view.motors[joint], state=state, words=words, fix=fix)
        is_found = model.can_write(view)
        self._setup.picture.light(() if joint is None else (joint,), GREEN if is_found else ORANGE)
        is_done = joint is None and not self._is_writing
        say = cards.good if is_done else cards.note
        self._doing.content = say(self._about(view, is_found))
        self._write.visible = joint is not None
        self._write.disabled = not is_found or self._is_writing
        self._skip.visible = self._again.visible = joint is not None
        self._skip.disabled = bool(self._setup.doing)
        if joint is not None:
            self._write.label = f"Write id {view.motors[joint].target_id} to this motor"
            self._skip.label = f"Skip {joint}"
        owner = model.owner(view)
        self._swapped.show(shown=owner is not None, can=not self._setup.doing)
        self._anew.show(can=view.step > 0 and not self._setup.doing)

    def can_go_on(self) -> str | None:
        """How many motors are left; a motor's card shows its problem."""
        left = 6 - self._view.step
        if self.check().verdict != "fail":
            return None
        return f"{left} motor{'s are' if left > 1 else ' is'} still to be set up or skipped"

    def _as_it_was(self) -> str:
        return "nothing moved; motors that got their ids keep them, the others are unchanged"

    # Helpers

    @property
    def _view(self) -> SetupView:
        target = self._setup.target
        return SetupView() if target is None else target.calibrator.motor_setup.view

    @property
    def _is_writing(self) -> bool:
        return self._setup.doing.startswith("writing")

    def _about(self, view: SetupView, is_found: bool) -> str:
        if self._is_writing:
            return capital(self._setup.doing)
        if view.next_joint is None and self.model.picked is None:
            is_skipped = any(motor.state == "skipped" for motor in view.motors.values())
            return f"All six motors are set up{' or skipped' if is_skipped else ''}. Press Next."
        if is_found:
            return "Nothing is written until you press the button. The motor does not move."
        return self.model.hint or _LOOKING

    def _assign(self) -> None:
        target, joint = self._setup.target, self.model.joint(self._view)
        if target is None or joint is None or not self.model.can_write(self._view):
            return
        motors = target.calibrator.motor_setup
        doing = f"writing id {self._view.motors[joint].target_id} to the motor of {joint}"
        self._setup.do(doing, partial(motors.assign, joint), lambda _: self._settled())

    def _leave_out(self) -> None:
        target, joint = self._setup.target, self.model.joint(self._view)
        if target is not None and joint is not None:
            skip = partial(target.calibrator.motor_setup.skip, joint)
            self._setup.do(f"skipping {joint}", skip, lambda _: self._settled())

    def _settled(self) -> None:
        self.model.picked = None
        put(self._redo, _NONE)
        self.model.look_again()

    def _swap(self) -> None:
        """Use the found motor for this joint, and ask again for the one that had its id."""
        target, joint = self._setup.target, self.model.joint(self._view)
        owner = self.model.owner(self._view)
        if target is None or owner is None:
            return

        def forgotten(_: object) -> None:
            self._setup.progress.forget_motors(owner)
            self.model.picked = joint
            self.model.look_again()

        forget = partial(target.calibrator.motor_setup.forget, owner)
        self._setup.do(f"asking for the motor of {owner} again", forget, forgotten)

    def _begin_anew(self) -> None:
        """Forget which motors are done: another kit, or all once more."""
        target = self._setup.target
        if target is not None:
            self._setup.do("starting over", target.calibrator.motor_setup.reset, self._forget)

    def _forget(self, _: object) -> None:
        self._setup.progress.forget_motors()
        self._settled()

    def _pick(self, joint: str) -> None:
        self.model.picked = joint if joint in SETUP_ORDER else None
        self.model.look_again()
