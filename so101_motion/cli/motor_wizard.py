"""Guide a person from motor to motor in the terminal: the steps of ``so101 setup``.

No key is needed: a motor is set up as soon as it answers alone. Until then the screen shows the
problem.
"""

from __future__ import annotations

import time

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from so101_motion.calib.motors.motor_setup import MotorSetup
from so101_motion.calib.motors.progress import SetupProgress
from so101_motion.calib.motors.setup_view import (
    AS_NEW,
    MOVES,
    MotorView,
    SetupView,
    Verification,
    connect_alone,
)
from so101_motion.cli.terminal import ENTER, Terminal, keys_line, sentence
from so101_motion.common.errors import BusError, MotorSetupError, So101Error

_MARKS = {
    "todo": ("·", "dim"),
    "found": ("→", "cyan"),
    "failed": ("!", "yellow"),
    "skipped": ("–", "dim"),
    "configured": ("✓", "green"),
    "verified": ("✓", "bold green"),
}


class _Skip(Exception):
    """Leave this motor as it is."""


class MotorWizard:
    """Guides a person from motor to motor.

    Args:
        motors: Sets up and verifies the motors.
        terminal: Shows the texts and reads the keys.
        progress: The motors that are done, kept for the next start.
        within: How long to wait for a motor [s]; None for no limit.
    """

    def __init__(
        self,
        motors: MotorSetup,
        terminal: Terminal,
        progress: SetupProgress,
        *,
        within: float | None,
    ) -> None:
        self._motors, self._terminal, self._progress = motors, terminal, progress
        self._within = within
        self._asks = ""
        self._trouble = ""
        self._is_verifying = False
        self._keys = keys_line(q="stop")
        motors.recall(progress.done)

    @property
    def view(self) -> SetupView:
        """The state of the motor setup."""
        return self._motors.view

    def set_up(self, joint: str) -> None:
        """Wait for the motor of a joint, alone, and set it up.

        Raises:
            MotorSetupError: It did not answer in time, or not alone.
            BusError: The bus could not be reached in time.
            Quit: The person wants to stop; a step that was begun is finished.
        """
        terminal = self._terminal
        self._asks, self._trouble = self._instruction(joint), ""
        self._keys = keys_line(s=f"skip {joint}", q="stop, go on later")
        terminal.mention(self._asks, joint=joint, step="connect")
        began = time.monotonic()
        is_done = False
        while not is_done:
            try:
                is_done = self._is_set_up(joint)
            except (MotorSetupError, BusError) as error:
                if self._within is not None and time.monotonic() - began > self._within:
                    raise
                self._print_progress(error)
            except _Skip:
                terminal.say(self._motors.skip(joint).sentence, joint=joint, step="skipped")
                return

    def verify(self) -> Verification:
        """Wait until all six motors are right; ENTER accepts them as they are.

        Raises:
            BusError: The port did not come back in time.
            Quit: The person wants to stop.
        """
        terminal = self._terminal
        self._asks = (
            "put all six on the cable, one after the other: the adapter, shoulder_pan,"
            " shoulder_lift, elbow_flex, wrist_flex, wrist_roll, gripper"
        )
        self._is_verifying = True
        self._keys = keys_line(Enter="accept it as it is", q="stop, go on later")
        terminal.mention(self._asks, step="chain")
        began = time.monotonic()
        while True:
            is_late = self._within is not None and time.monotonic() - began > self._within
            try:
                found = terminal.run(self._motors.verify, self._picture)
                if found.ok or is_late or terminal.pressed == ENTER:
                    return found
                self._trouble = ""  # the table shows it
                terminal.mention(found.sentence, step="chain")
            except BusError as error:
                if is_late:
                    raise
                self._print_progress(error)

    # Helpers of the steps

    def _instruction(self, joint: str) -> str:
        done = self._progress.done
        unplug = f"unplug the motor of {done[-1]}; then " if done else ""
        return unplug + connect_alone(joint)

    def _is_set_up(self, joint: str) -> bool:
        """Set up what is connected; False when the person wants to connect something else."""
        terminal = self._terminal
        try:
            found = terminal.run(lambda: self._motors.discover(joint), self._picture)
            self._refuse_done(joint, found)
        finally:
            if terminal.pressed == "s":
                raise _Skip
        terminal.say(f"{joint}: {found.sentence}", joint=joint, step="found")
        doubt = self._doubt(joint, found)
        if doubt:
            terminal.say(doubt, style="yellow", joint=joint, step="doubt")
            before, self._keys = self._keys, keys_line(Enter="set it up anyway", r="look again")
            pressed = terminal.await_key(f"{ENTER}r", self._picture)
            self._keys = before
            if pressed == "r":
                return False
        done = terminal.run(lambda: self._motors.assign(joint), self._picture)
        self._progress.add(joint)
        changed = f" ({', '.join(done.changed)})" if done.changed else ""
        terminal.say(
            f"✓ {done.sentence}{changed}",
            style="green",
            joint=joint,
            step="configured",
            servo_id=done.new_id,
        )
        return True

    def _refuse_done(self, joint: str, found: MotorView) -> None:
        owner = self.view.owner(found.found_id, but=joint)
        if owner is not None:
            raise MotorSetupError(
                joint,
                "other servo",
                f"the motor of {owner}, which is done, is still connected",
                f"unplug it and connect that of {joint}",
            )

    def _doubt(self, joint: str, found: MotorView) -> str:
        """Why a person should check this motor before it is set up; empty for no reason."""
        if found.fix:
            return f"check this first: {found.fix}"
        for other, motor in self._motors.view.motors.items():
            if other != joint and motor.target_id == found.found_id != AS_NEW:
                return (
                    f"this motor was set up before as the motor of {other}; make sure that it is"
                    f" the right one for {joint}"
                )
        return ""

    def _print_progress(self, error: So101Error) -> None:
        if isinstance(error, MotorSetupError):
            self._trouble = f"{error.reason}; {error.next_step}"
            if error.problem == "no servo":
                return  # normal while plugs are changed; the picture shows it
        else:
            self._trouble = str(error)
        self._terminal.mention(self._trouble, step="trouble")

    def _picture(self) -> RenderableType:
        view = self._motors.view
        table = Table.grid(padding=(0, 2))
        for joint, motor in view.motors.items():
            mark, style = _MARKS[motor.state]
            table.add_row(
                Text(mark, style=style),
                Text(joint, style=style),
                Text(f"id {motor.target_id}", style="dim"),
                self._about(motor),
            )
        lines = [Text(f"\n{sentence(self._asks)}", style="bold")]
        if self._trouble:
            lines.append(Text(self._trouble, style="yellow"))
        lines.append(Text(view.doing or "waiting", style="dim"))
        return Group(Text(), table, *lines, *([self._keys] if self._terminal.is_manned else []))

    def _about(self, motor: MotorView) -> Text:
        if motor.state == "failed" and self._is_verifying:
            return Text(motor.sentence, style="yellow")
        if motor.state not in ("configured", "verified") or motor.volts is None:
            return Text(MOVES[motor.joint], style="dim")
        return Text(f"{motor.model}, firmware {motor.firmware}, {motor.volts:.1f} V", style="dim")
