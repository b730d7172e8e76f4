"""The motor setup as two operations: motors get their ids one by one, then the chain is verified.

``calib/motors/motor_setup.py`` carries the commands out. Here are the texts, rows and offers that
terminal, page and sensor show, and the answers of the published commands.

Looking at the cable is due again and again, because it writes nothing. A motor is written to when a
person says so; with ``writes`` also by itself, once it is certain which one it is.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Any

from so101_motion.calib.motors.motor_setup import MotorSetup
from so101_motion.calib.motors.progress import SetupProgress
from so101_motion.calib.motors.setup_view import (
    AS_NEW,
    SETUP_ORDER,
    MotorCheck,
    MotorView,
    ScannedServo,
    SetupView,
    connect_alone,
)
from so101_motion.common.errors import ConfigError
from so101_motion.common.operation import LocalOperation, Offer, Picture, Row, Tone, View
from so101_motion.setup.readings import about_servo

PAUSE = 0.6
"""How long to wait between two looks at the cable [s]; chosen: a look alone takes up to two."""

PATIENCE = 12.0
"""After this long without an answer the view says what may be wrong [s]; chosen: time to unplug one
motor and plug in another."""

_LOOKING = (
    "Watching the cable; nothing to press yet. The six motors of a follower's kit are alike: take"
    " any. Those of a leader differ: see its guide for which goes where."
)
_NOBODY = "no servo answers"
_SILENT = (
    "No motor has answered for a while. Is the power supply on, and the motor's cable plugged into"
    " the adapter? Try its other socket and another cable. A motor that still does not answer is"
    " dead: replace it or skip it."
)
_SETTLED = ("configured", "verified", "skipped")
_MARKS: dict[str, tuple[str, Tone]] = {
    "todo": ("○", "dim"),
    "found": ("●", "good"),
    "failed": ("!", "warm"),
    "skipped": ("–", "dim"),
    "configured": ("✓", "good"),
    "verified": ("✓", "good"),
}
_DRAWN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.6)  # [rad]; the jaw is open, to be seen as a part of its own


class MotorOperation(LocalOperation):
    """Gives motors their ids, one after the other.

    Args:
        setup: Carries out the commands.
        joints: The joints whose motors are to be set up.
        writes: Whether a motor that is found alone, and surely the right one, is written to by
            itself.
        is_attended: Whether there is a person who is asked.
        now: The time [s].
    """

    refuses = False

    def __init__(
        self,
        setup: MotorSetup,
        *,
        joints: Collection[str] = SETUP_ORDER,
        writes: bool = False,
        is_attended: bool = True,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self.setup, self._joints = setup, joints
        self._writes, self._is_attended, self._now = writes, is_attended, now
        self._progress: SetupProgress | None = None
        self._looked_at = 0.0
        self._silent: tuple[str, float] | None = None  # whose motor is missing, and since when
        self._picked: str | None = None  # whose motor a person wants next
        self.commands = {
            "discover": self._discover,
            "assign_id": self._assign,
            "skip": self._skip,
            "forget": self._forget,
            "choose": self._choose,
            "swap": self._swap,
            "repair": self._repair,
            "scan_bus": self._scan,
            "reset_status": self._reset,
        }

    def keep_in(self, progress: SetupProgress) -> None:
        """Keep the motors that are done for the next start, and take up those kept before."""
        self._progress = progress
        self.setup.recall(progress.done)

    # The view

    @property
    def view(self) -> View:
        """The present state; never waits."""
        setup = self.setup.view
        motor = self._motor(setup)
        is_ready = motor is not None and self._is_ready(setup, motor)
        trouble, fix = ("", "") if motor is None else self._trouble(setup, motor)
        return View(
            state="done" if motor is None else motor.joint,
            title="Motor ids",
            text=self._done(setup) if motor is None else self._text(setup, motor),
            rows=tuple(_row(m, is_next=m is motor) for m in setup.motors.values()),
            trouble=trouble,
            fix=fix,
            note="" if motor is None else self._note(setup, motor),
            offers=(() if motor is None else self._offers(setup, motor)) + _once_more(setup),
            said=self.said,
            picture=Picture(
                q=_DRAWN,
                lit=() if motor is None else (motor.joint,),
                lit_tone="good" if is_ready else "busy",
            ),
            is_over=motor is None,
        )

    def _motor(self, setup: SetupView) -> MotorView | None:
        """The motor that is next; None when all that are wanted are done."""
        if self._picked is not None:
            return setup.motors[self._picked]
        wanted = (motor for joint, motor in setup.motors.items() if joint in self._joints)
        return next((motor for motor in wanted if motor.state not in _SETTLED), None)

    @staticmethod
    def _done(setup: SetupView) -> str:
        is_skipped = any(motor.state == "skipped" for motor in setup.motors.values())
        return f"All six motors are set up{' or skipped' if is_skipped else ''}."

    def _text(self, setup: SetupView, motor: MotorView) -> str:
        if motor.state == "found" and _owner(setup, motor) is None:
            if motor.fix or motor.model is None or motor.volts is None:
                return motor.sentence
            return f"found it: {motor.model}, firmware {motor.firmware}, {motor.volts:.1f} V"
        others = (m for m in setup.motors.values() if m is not motor)
        settled = [m for m in others if m.state == "configured"]
        there = [m.joint for m in settled if m.target_id == motor.found_id != AS_NEW]
        done = there or [m.joint for m in settled]
        unplug = ""
        if done:
            number = setup.motors[done[-1]].target_id
            unplug = f"unplug the motor of {done[-1]} and write {number} on it, then "
        return unplug + connect_alone(motor.joint)

    @staticmethod
    def _trouble(setup: SetupView, motor: MotorView) -> tuple[str, str]:
        """What is wrong with the motor, and what to do."""
        is_wrong = motor.state == "found" and motor.fix and _owner(setup, motor) is None
        if is_wrong or (motor.state == "failed" and _NOBODY not in motor.sentence):
            return motor.sentence, motor.fix.removesuffix(f"; then discover {motor.joint} again")
        return "", ""

    def _note(self, setup: SetupView, motor: MotorView) -> str:
        if doubt := _doubt(setup, motor):
            return doubt
        if self._is_ready(setup, motor):
            return "Nothing is written until you press the button. The motor does not move."
        silent = self._silent
        return _SILENT if silent is not None and self._now() - silent[1] > PATIENCE else _LOOKING

    @staticmethod
    def _is_ready(setup: SetupView, motor: MotorView) -> bool:
        """Whether the motor can be written to, and has no problem to fix first."""
        return motor.state == "found" and not motor.fix and _owner(setup, motor) is None

    def _offers(self, setup: SetupView, motor: MotorView) -> tuple[Offer, ...]:
        named = {"motor_name": motor.joint}
        is_ready = self._is_ready(setup, motor)
        is_sure = not self._is_attended or not _doubt(setup, motor)
        write = Offer(
            command="assign_id",
            title=f"Write id {motor.target_id} to this motor",
            arguments=named,
            why_not=None if is_ready else "no motor is found that can be written to",
            due_in=0.0 if self._writes and is_ready and is_sure else None,
        )
        due = max(self._looked_at + PAUSE - self._now(), 0.0)
        look = Offer(
            command="discover", title="Look again", arguments=named, due_in=due, is_look=True
        )
        skip = Offer(command="skip", title=f"Skip {motor.joint}", arguments=named, key="s")
        owner = _owner(setup, motor)
        if owner is None:
            return (write, look, skip)
        swapped = Offer(
            command="swap",
            title="No, this is already the next motor",
            arguments={"motor_name": motor.joint, "owner": owner},
            asks="Press again: both get new ids",
            key="n",
        )
        return (write, look, skip, swapped)

    # The commands

    def _discover(self, motor_name: str = "") -> dict[str, Any]:
        joint = _named(motor_name)
        before = self.setup.view
        try:
            found = self.setup.discover(joint)
        finally:
            self._looked_at = self._now()
            now = self.setup.view.motors.get(joint)
            if now is None or _NOBODY not in now.sentence:
                self._silent = None
            elif self._silent is None or self._silent[0] != joint:
                self._silent = joint, self._looked_at
        is_news = found.sentence != before.motors[joint].sentence
        if is_news and _owner(self.setup.view, found) is None:
            self.say(f"{joint}: {found.sentence}", joint=joint, step="found")
        return {
            "motor_name": joint,
            "target_id": found.target_id,
            **about_servo(found),
            "status": found.sentence,
            "fix": found.fix or None,
            **self._next(),
        }

    def _assign(
        self,
        motor_name: str = "",
        current_id: int | None = None,
        target_id: int | None = None,
        current_baudrate: int | None = None,
    ) -> dict[str, Any]:
        joint = _named(motor_name)
        done = self.setup.assign(
            joint, current_id=current_id, target_id=target_id, current_baud=current_baudrate
        )
        if self._progress is not None:
            self._progress.add(joint)
        self._picked, self._looked_at = None, 0.0
        changed = f" ({', '.join(done.changed)})" if done.changed else ""
        about = {"joint": joint, "step": "configured", "servo_id": done.new_id}
        self.say(f"✓ {done.sentence}{changed}", "good", **about)
        return {
            "motor_name": joint,
            "old_id": done.old_id,
            "new_id": done.new_id,
            "old_baudrate": done.old_baud,
            "new_baudrate": done.new_baud,
            "changed": list(done.changed),
            "status": done.sentence,
            **self._next(),
        }

    def _skip(self, motor_name: str = "") -> dict[str, Any]:
        joint = _named(motor_name)
        status = self.setup.skip(joint).sentence
        self._picked = None
        self.say(status, joint=joint, step="skipped")
        return {"motor_name": joint, "status": status, **self._next()}

    def _forget(self, motor_name: str = "") -> dict[str, Any]:
        joint = _named(motor_name)
        self.setup.forget(joint)
        if self._progress is not None:
            self._progress.forget_motors(joint)
        return {"motor_name": joint, **self._next()}

    def _choose(self, motor_name: str) -> None:
        """Ask for a motor next, even if it is done."""
        self._forget(motor_name)
        self._picked = motor_name

    def _swap(self, motor_name: str, owner: str) -> None:
        """Take the connected motor for this joint, and ask again for that of the id's owner."""
        self._forget(owner)
        self._choose(motor_name)

    def _repair(self) -> dict[str, Any]:
        return {"changed": list(self.setup.repair()), **self._next()}

    def _scan(self) -> dict[str, Any]:
        found = self.setup.scan()
        return {
            "servos_found": len(found.servos),
            "unexpected_count": found.unexpected_count,
            "servos": [_scanned(servo) for servo in found.servos],
            "status": found.sentence,
        }

    def _reset(self) -> dict[str, Any]:
        self.setup.reset()
        if self._progress is not None:
            self._progress.forget_motors()
        self._picked = None
        return {"status": self.setup.view.status}

    def _next(self) -> dict[str, str]:
        return {"next_step": self.setup.view.next_step}


def _once_more(setup: SetupView) -> tuple[Offer, ...]:
    """What may be set up once more: the last motor; with all done, each; or all from the start."""
    settled = [motor.joint for motor in setup.motors.values() if motor.state in _SETTLED]
    if not settled:
        return ()
    again = (
        Offer(command="choose", title=f"Set up {joint} again", arguments={"motor_name": joint})
        for joint in (settled if len(settled) == len(setup.motors) else settled[-1:])
    )
    title, sure = "Start over with the gripper", "Press again to start over"
    return (*again, Offer(command="reset_status", title=title, asks=sure))


def _named(joint: str) -> str:
    if not joint:
        raise ConfigError("motor_name", None, 'is missing; name the motor, such as "gripper"')
    return joint


def _owner(setup: SetupView, motor: MotorView) -> str | None:
    """The other joint whose id the found motor has; None if it may be written to."""
    return setup.owner(motor.found_id, but=motor.joint) if motor.state == "found" else None


def _doubt(setup: SetupView, motor: MotorView) -> str:
    """Why a person should check this motor before it is written to; empty for no reason."""
    if _owner(setup, motor) is not None:
        return ""
    for other in setup.motors.values():
        if motor.state == "found" and other is not motor and other.target_id == motor.found_id:
            return "" if motor.found_id == AS_NEW else (
                f"This motor was set up before as the motor of {other.joint}; make sure that it is"
                f" the right one for {motor.joint}."
            )  # fmt: skip
    return ""


def _row(motor: MotorView, *, is_next: bool) -> Row:
    """A motor: its state, the id and the rate it has, and the id it is to have."""
    mark, tone = _MARKS[motor.state]
    if is_next and motor.state in ("todo", "failed"):
        mark, tone = "●", "busy"
    identity = f"id {motor.found_id}"
    if motor.state == "skipped":
        identity = "skipped"
    elif motor.found_id is None or motor.state == "todo":
        identity = f"gets id {motor.target_id}"
    elif motor.state in ("found", "failed") and motor.found_id != motor.target_id:
        identity += f" → {motor.target_id}"
    if motor.baud is not None and identity.startswith("id"):
        baud = motor.baud
        is_fast = baud >= 1_000_000
        identity += f", {baud // 1_000_000} Mbaud" if is_fast else f", {baud / 1000:g} kbaud"
    return Row(label=motor.joint, cells=(identity,), tone=tone, mark=mark)


def _scanned(servo: ScannedServo) -> dict[str, Any]:
    return {
        "id": servo.servo_id,
        "model": servo.model or "unknown",
        "status": "unexpected" if servo.expected_joint is None else "expected",
        "expected_name": servo.expected_joint,
        "baudrate": servo.baud,
    }


_CHAIN = (
    "Put all six motors on the cable, one after the other: the adapter, shoulder_pan,"
    " shoulder_lift, elbow_flex, wrist_flex, wrist_roll, gripper."
)


class ChainOperation(LocalOperation):
    """Verifies all six motors on one cable.

    Args:
        setup: Carries out the commands.
        waits: Whether it verifies again and again until all are right.
        is_busy: Whether the motors are in use for a calibration.
        now: The time [s].
    """

    def __init__(
        self,
        setup: MotorSetup,
        *,
        waits: bool = False,
        is_busy: Callable[[], bool] = lambda: False,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self.setup, self._waits, self._is_busy, self._now = setup, waits, is_busy, now
        self._looked_at, self._is_accepted = 0.0, False
        self.commands = {"verify": self._verify, "accept": self._accept}

    @property
    def view(self) -> View:
        """The present state; never waits."""
        found = self.setup.checked
        wrong = () if found is None else tuple(c for c in found.motors.values() if c.error)
        due = max(self._looked_at + PAUSE - self._now(), 0.0) if self._waits else None
        title = "Verify all six" if found is None else "Verify again"
        why = "The calibration is under way: press Next." if self._is_busy() else None
        verify = Offer(command="verify", title=title, why_not=why, due_in=due, is_look=self._waits)
        accept = Offer(command="accept", title="accept it as it is")
        return View(
            state="chain",
            title="All six together",
            text=_CHAIN if found is None else "" if wrong else found.sentence,
            rows=() if found is None else tuple(map(_checked_row, found.motors.values())),
            trouble=_about(wrong),
            fix=wrong[0].fix if wrong else "",
            note=" ".join(found.notes) if found is not None else "",
            offers=(verify, accept) if self._waits else (verify,),
            picture=Picture(
                q=_DRAWN,
                lit=tuple(c.joint for c in wrong or (found.motors.values() if found else ())),
                lit_tone="busy" if wrong else "good",
            ),
            is_over=self._is_accepted or (found is not None and found.ok),
        )

    def _verify(self) -> dict[str, Any]:
        try:
            found = self.setup.verify()
        finally:
            self._looked_at = self._now()
        error = {} if found.ok else {"error": found.sentence}  # the published setup page shows it
        return {
            "success": found.ok,
            **error,
            "all_ok": found.ok,
            "motors": {joint: _checked(check) for joint, check in found.motors.items()},
            "unexpected_ids": list(found.unexpected_ids),
            "notes": list(found.notes),
            "status": found.sentence,
            "next_step": self.setup.view.next_step,
        }

    def _accept(self) -> None:
        self._is_accepted = True


def _about(wrong: tuple[MotorCheck, ...]) -> str:
    """What is wrong first, with the ids of the others for which the same is to be done."""
    if not wrong:
        return ""
    first, *others = wrong
    alike = [str(c.servo_id) for c in others if (c.status, c.fix) == (first.status, first.fix)]
    also = f"; the same with {', '.join(alike)}" if alike else ""
    return f"{first.error}{also}"


def _checked_row(check: MotorCheck) -> Row:
    is_ok, facts = check.status == "ok", check.facts
    about = "" if facts is None else f"{facts.volts:.1f} V, firmware {facts.firmware}"
    return Row(
        label=check.joint,
        cells=(f"id {check.servo_id}", about if is_ok else check.status.replace("_", " ")),
        tone="good" if is_ok else "bad",
        mark="✓" if is_ok else "✗",
    )


def _checked(check: MotorCheck) -> dict[str, Any]:
    motor: dict[str, Any] = {"id": check.servo_id, "status": check.status}
    if check.facts is not None:
        motor |= {
            "model": check.facts.model,
            "firmware": check.facts.firmware,
            "volts": round(check.facts.volts, 1),
        }
    if check.error:
        motor |= {"error": check.error, "fix": check.fix}
    return motor
