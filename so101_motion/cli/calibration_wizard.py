"""Guide a person through a calibration in the terminal: the steps of ``so101 calibrate``.

The person's hands hold the arm, so few keys are needed. The homing pose is taken once the arm has
been held still for a moment. The recording ends by itself once every joint has been at both stops
and no travel has been added for a while. The direction of the gripper is asked for separately,
because it becomes the zero of wrist_roll.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from functools import partial

from rich.console import Group, RenderableType
from rich.text import Text

from so101_motion.calib.procedure import summary
from so101_motion.calib.procedure.steps import Command
from so101_motion.calib.procedure.stillness import STILL, Stillness
from so101_motion.calib.procedure.travel_assessment import ROLL, Verdict
from so101_motion.calib.procedure.view import JointView
from so101_motion.calib.record.record import Calibration
from so101_motion.cli import calibration_bars
from so101_motion.cli.terminal import ENTER, Terminal, keys_line, sentence
from so101_motion.common.errors import BusError, CalibrationError
from so101_motion.setup.calibrator import Calibrator, StepResult

POSE = (
    "hold every joint about in the middle of its travel: the upper arm upright, forearm and gripper"
    " level and straight ahead, the jaw half open"
)
TURN = (
    "now turn the gripper about its long axis until it opens straight upwards. This alone sets the"
    " zero of wrist_roll, so look closely"
)

NOTHING_NEW = 3.0
"""The recording ends when all joints are done and have had no new travel for this long [s].
Chosen."""

GOOD_ENOUGH = 10.0
"""The same without a person at the terminal, when all joints can be saved but some did not quite
reach their stops [s]. Chosen."""

SHOWN = 5.0
"""How long the reason is shown why the recording could not end [s]. Chosen."""


class CalibrationWizard:
    """Guides a person through a calibration.

    Args:
        calibrator: Carries out the steps.
        terminal: Shows the texts and reads the keys.
        before: The calibration that the file has now, to compare with.
        accept: Joints whose travel may differ from that of an SO-101.
    """

    def __init__(
        self,
        calibrator: Calibrator,
        terminal: Terminal,
        *,
        before: Calibration,
        accept: Collection[str] = (),
    ) -> None:
        self._calibrator, self._terminal = calibrator, terminal
        self._before, self._accept = before, accept
        self._asks = self._trouble = self._hint = ""
        self._refused = ("", 0.0)  # why the recording could not end, and until when that is shown
        self._keys: dict[str, str] = {}
        self._has_started = False

    def go(self) -> StepResult:
        """Calibrate and save.

        Raises:
            CalibrationError: A step failed; call ``give_up``.
            BusError: The servos do not answer; call ``give_up``.
            Quit: The person wants to stop; call ``give_up``.
        """
        self._begin()
        while True:
            try:
                self._take_pose()
                break
            except (CalibrationError, BusError) as error:
                self._ask_again(error)
                self._start()
        self._record()
        self._review()
        return self._save()

    def give_up(self) -> str:
        """Abort the calibration; return the result in a sentence.

        Raises:
            CalibrationError: The previous settings cannot be restored now.
            BusError: The servos do not answer.
        """
        if not self._has_started:
            return "nothing was changed"
        ended = self._terminal.run(partial(self._calibrator.step, Command.ABORT), Text)
        return ended.put_back

    # The steps

    def _begin(self) -> None:
        self._ask("the joints are about to go limp: hold the arm with one hand", Enter="release")
        self._terminal.await_key(ENTER, self._picture)
        self._start()

    def _start(self) -> None:
        self._has_started = True
        self._carry_out(Command.START)
        note = self._calibrator.situation.view.note
        if note:
            self._terminal.say(note, style="yellow")
        self._terminal.say("the joints are limp", step="limp")

    def _take_pose(self) -> None:
        terminal = self._terminal
        self._ask(POSE, Enter="it is in this pose")
        terminal.mention(self._asks, step="pose")
        terminal.await_key(ENTER, self._picture)
        self._ask(TURN, Enter="it points up")
        terminal.mention(self._asks, step="roll")
        terminal.await_key(ENTER, self._picture)
        self._ask("hold still")
        stillness, seconds = Stillness(), 0.0
        while seconds < STILL:
            self._hint = f"{STILL - seconds:.1f} s more" if seconds else "it moves"
            terminal.show(self._picture())
            terminal.key(0.05)
            seconds = stillness.feed(time.monotonic(), self._ticks())
        self._hint = ""
        self._carry_out(Command.SET_HOMING)
        terminal.say("the homing pose is taken", style="green", step="homed")

    def _record(self) -> None:
        terminal = self._terminal
        self._carry_out(Command.START_RECORDING)
        self._ask(
            "move every joint slowly through its whole travel, to both stops, in any order",
            Enter="finish",
        )
        terminal.mention(self._asks, step="record")
        done: set[str] = set()
        ends, since, pressed = None, time.monotonic(), ""
        while True:
            joints, now = self._calibrator.situation.view.joints, time.monotonic()
            seen = [(view.recorded_min, view.recorded_max) for view in joints.values()]
            if seen != ends:
                ends, since = seen, now
            self._tell_done(joints, done)
            left = self._left(joints) - (now - since)
            self._hint = f"done; it ends in {left:.0f} s" if left < NOTHING_NEW else ""
            if (left <= 0.0 or pressed == ENTER) and self._has_stopped():
                return
            terminal.show(self._picture())
            pressed = terminal.key(0.1)

    def _review(self) -> None:
        joints = self._calibrator.situation.view.joints
        self._ask("save this?", Enter="save")
        lines = summary.lines(joints, self._before)
        for line in lines:
            text = f"{line.joint}: {line.travel} {line.quality} ({line.change})"
            self._terminal.mention(text, step="review")
        table = calibration_bars.comparison(lines)
        self._terminal.await_key(ENTER, lambda: self._picture(table))

    def _save(self) -> StepResult:
        while True:
            try:
                return self._carry_out(Command.SAVE)
            except (CalibrationError, BusError) as error:
                self._ask_again(error)

    # Helpers of the steps

    def _carry_out(self, command: Command, *, accept: Collection[str] = ()) -> StepResult:
        step = partial(self._calibrator.step, command, accept=accept)
        return self._terminal.run(step, self._picture)

    def _ask(self, sentence: str, **keys: str) -> None:
        self._asks, self._trouble, self._hint = sentence, "", ""
        self._keys = {**keys, "q": "undo everything and stop"}

    def _ask_again(self, error: CalibrationError | BusError) -> None:
        """Let the person fix the problem and try again; without a person, end."""
        if not self._terminal.is_manned:
            raise error
        self._ask("that did not work", Enter="try again")
        self._trouble = str(error)
        self._terminal.await_key(ENTER, self._picture)

    def _ticks(self) -> dict[str, int | None]:
        joints = self._calibrator.situation.view.joints
        return {joint: view.ticks for joint, view in joints.items()}

    def _tell_done(self, joints: Mapping[str, JointView], done: set[str]) -> None:
        for joint, view in joints.items():
            if joint not in done and view.verdict is Verdict.COMPLETE:
                done.add(joint)
                self._terminal.mention(f"✓ {joint}: {view.sentence}", step="done", joint=joint)

    def _left(self, joints: Mapping[str, JointView]) -> float:
        """How long without new travel until the recording ends by itself [s]."""
        if all(_is_through(view) or joint in self._accept for joint, view in joints.items()):
            return NOTHING_NEW
        if all(view.is_done for view in joints.values()) and not self._terminal.is_manned:
            return GOOD_ENOUGH
        return float("inf")

    def _has_stopped(self) -> bool:
        try:
            self._carry_out(Command.STOP_RECORDING, accept=self._accept)
        except CalibrationError as error:  # the recording goes on
            self._refused = (str(error), time.monotonic() + SHOWN)
            self._terminal.mention(str(error), step="trouble")
            return False
        return True

    def _picture(self, below: RenderableType | None = None) -> RenderableType:
        view = self._calibrator.situation.view
        is_recorded = any(joint.verdict is not None for joint in view.joints.values())
        shown = (
            calibration_bars.travels(view.joints)
            if is_recorded
            else calibration_bars.positions(view.joints)
        )
        lines: list[RenderableType] = [Text(), shown]
        if below is not None:
            lines += [Text(), below]
        lines.append(Text(f"\n{sentence(self._asks)}", style="bold"))
        refused, until = self._refused
        is_old = time.monotonic() > until  # the joints have moved on since
        for trouble in dict.fromkeys((self._trouble, view.error)):
            if trouble and not (trouble == refused and is_old):
                lines.append(Text(trouble, style="red"))
        lines.append(Text(self._hint, style="green"))
        if self._terminal.is_manned:
            lines.append(keys_line(**self._keys))
        return Group(*lines)


def _is_through(view: JointView) -> bool:
    """Whether more movement would record nothing new."""
    return view.verdict is Verdict.COMPLETE or (view.joint == ROLL and view.is_done)
