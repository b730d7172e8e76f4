"""The motor setup as two operations: motors get their ids one by one, then the chain is verified.

Assigning looks again which servo is connected, because plugs change between two requests. It
changes an id only if exactly one servo answers, and none at any other baud rate. It succeeds once
the servo answers at its new id and rate and its settings read back correctly, and may be repeated
after any failure: it finds the servo at whatever id and rate it has now.

Looking at the cable is due again and again, because it writes nothing. A motor is written to when a
person says so; with ``writes`` also by itself, once it is certain which one it is. The bus is
borrowed for each request. Commands of any thread wait for each other; ``view`` never waits.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from typing import Any

from so101_motion.calib.access import BusAccess
from so101_motion.calib.motors import chain_check, single_servo
from so101_motion.calib.motors.arm_identification import read_facts
from so101_motion.calib.motors.setup_view import (
    AS_NEW,
    SETTLED,
    SETUP_ORDER,
    MotorCheck,
    MotorView,
    SetupProgress,
    SetupView,
    Verification,
    connect_alone,
)
from so101_motion.calib.motors.single_servo import (
    Tuner,
    find_all_rates,
    find_alone,
    read_back,
    require_alone,
)
from so101_motion.calib.record.record import SERVO_IDS
from so101_motion.common.attributes import suggest
from so101_motion.common.errors import (
    BusError,
    ConfigError,
    MotorSetupError,
    NoReply,
    PortUnavailable,
    So101Error,
)
from so101_motion.common.operation import Input, LocalOperation, Offer, Picture, Row, Tone, View
from so101_motion.drivers.bus import registers as reg

_log = logging.getLogger(__name__)

PAUSE = 0.6
"""How long to wait between two looks at the cable [s]; chosen: a look alone takes up to two."""

PATIENCE = 12.0
"""After this long without an answer the view says what may be wrong [s]; chosen: time to unplug one
motor and plug in another."""

_WATCHING = "Watching the cable; nothing to press yet."
_ALIKE = (
    " The six motors of a follower's kit are alike: take any. Those of a leader differ: see its"
    " guide for which goes where."
)
_WRITING = "writing to"
_NOBODY, _UNKNOWN = "no servo answers", "unknown"
_SILENT = (
    "No motor has answered for a while. Is the power supply on, and the motor's cable plugged into"
    " the adapter? Try its other socket and another cable. A motor that still does not answer is"
    " dead: replace it or skip it."
)
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
        borrow: Lends their bus until its block ends. Giving it back must not raise because servos
            are missing, as they are during a setup.
    """

    refuses = False

    def __init__(
        self,
        borrow: Callable[[], AbstractContextManager[BusAccess]],
        *,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self.state = SetupView()
        self.checked: Verification | None = None  # also once a servo was changed
        self.joints: Collection[str] = SETUP_ORDER  # whose motors are to be set up
        self.writes = False  # whether a motor that is surely the right one is written to by itself
        self.is_attended = True  # whether there is a person who is asked
        self._borrow, self._now = borrow, now
        self._busy = threading.Lock()
        self._progress: SetupProgress | None = None
        self._looked_at = 0.0
        self._silent: tuple[str, float] | None = None  # whose motor is missing, and since when
        self._picked: str | None = None  # whose motor a person wants next
        self.commands = {
            "discover": self.discover,
            "assign_id": self.assign,
            "skip": self.skip,
            "forget": self.forget,
            "choose": self._choose,
            "swap": self._swap,
            "repair": self.repair,
            "scan_bus": self.scan,
            "reset_status": self.reset,
        }

    def keep_in(self, progress: SetupProgress) -> None:
        self._progress = progress
        for joint in progress.done:
            motor = self._motor(joint)
            if motor.state == "todo":
                known = replace(motor, state="configured", found_id=motor.target_id)
                with self._busy:
                    self._show(replace(known, sentence=f"{joint} was set up before"))

    # The view

    @property
    def view(self) -> View:
        setup = self.state
        motor = self._next(setup)
        is_ready = motor is not None and self._is_ready(setup, motor)
        trouble, fix = ("", "") if motor is None else self._trouble(setup, motor)
        return View(
            state="done" if motor is None else motor.joint,
            title="Motor ids",
            text=self._done(setup) if motor is None else self._text(setup, motor),
            rows=tuple(_row(setup, m, is_next=m is motor) for m in setup.motors.values()),
            trouble=trouble,
            fix=fix,
            note="" if motor is None else self._note(setup, motor),
            doing=setup.doing if setup.doing.startswith(_WRITING) else "",
            offers=(() if motor is None else self._offers(setup, motor)) + _once_more(setup),
            said=self.said,
            picture=Picture(
                q=_DRAWN,
                lit=() if motor is None else (motor.joint,),
                lit_tone="good" if is_ready else "busy",
            ),
            is_over=motor is None,
        )

    def _next(self, setup: SetupView) -> MotorView | None:
        if self._picked is not None:
            return setup.motors[self._picked]
        wanted = (motor for joint, motor in setup.motors.items() if joint in self.joints)
        return next((motor for motor in wanted if motor.state not in SETTLED), None)

    @staticmethod
    def _done(setup: SetupView) -> str:
        is_skipped = any(motor.state == "skipped" for motor in setup.motors.values())
        new = [motor for motor in setup.motors.values() if motor.state == "configured"]
        write = f" Write {new[-1].target_id} on the motor of {new[-1].joint}." if new else ""
        return f"All six motors are set up{' or skipped' if is_skipped else ''}.{write}"

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
        is_wrong = motor.state == "found" and motor.fix and _owner(setup, motor) is None
        if is_wrong or (motor.state == "failed" and _NOBODY not in motor.sentence):
            return motor.sentence, motor.fix.removesuffix(f"; then discover {motor.joint} again")
        return "", ""

    def _note(self, setup: SetupView, motor: MotorView) -> str:
        if setup.doing.startswith(_WRITING):
            return ""
        if doubt := _doubt(setup, motor):
            return doubt
        if owner := _owner(setup, motor):
            return (
                f"Id {motor.found_id} answers, that of {owner}. If another motor is on the cable"
                ' now, choose "No, this is already the next motor".'
            )
        if self._is_ready(setup, motor):
            first = "" if self.writes else "Nothing is written until you press the button. "
            return f"{first}Writing does not turn the motor."
        silent = self._silent
        if silent is not None and self._now() - silent[1] > PATIENCE:
            return _SILENT
        if self._trouble(setup, motor)[0]:
            return ""
        is_first = all(each.state not in SETTLED for each in setup.motors.values())
        return _WATCHING + _ALIKE * is_first

    @staticmethod
    def _is_ready(setup: SetupView, motor: MotorView) -> bool:
        return motor.state == "found" and not motor.fix and _owner(setup, motor) is None

    def _offers(self, setup: SetupView, motor: MotorView) -> tuple[Offer, ...]:
        named = {"motor_name": motor.joint}
        is_ready = self._is_ready(setup, motor)
        is_sure = not self.is_attended or not _doubt(setup, motor)
        write = Offer(
            command="assign_id",
            title=f"Write id {motor.target_id} to this motor",
            arguments=named,
            why_not=None if is_ready else "no new motor answers yet",
            due_in=0.0 if self.writes and is_ready and is_sure else None,
        )
        due = max(self._looked_at + PAUSE - self._now(), 0.0)
        look = Offer(
            command="discover", title="Look again", arguments=named, due_in=due, is_look=True
        )
        skip = Offer(command="skip", title=f"Skip {motor.joint}", arguments=named, key="s")
        offers = [write, look, skip]
        if (owner := _owner(setup, motor)) is not None:
            swap = Offer(
                command="swap",
                title="No, this is already the next motor",
                arguments={"motor_name": motor.joint, "owner": owner},
                asks="Press again: both get new ids",
                key="n",
            )
            offers.append(swap)
        return tuple(offers)

    # The commands

    def discover(self, motor_name: str = "") -> dict[str, Any]:
        """Find the one servo that is connected, whatever its id and baud rate."""
        before = self._motor(motor_name)
        try:
            found = self._find(motor_name)
        finally:
            self._looked_at = self._now()
            if _NOBODY not in self._motor(motor_name).sentence:
                self._silent = None
            elif self._silent is None or self._silent[0] != motor_name:
                self._silent = motor_name, self._looked_at
        if found.sentence != before.sentence and _owner(self.state, found) is None:
            self.say(f"{motor_name}: {found.sentence}", joint=motor_name, step="found")
        return {
            "motor_name": motor_name,
            "target_id": found.target_id,
            **about_servo(found),
            "status": found.sentence,
            "fix": found.fix or None,
            "next_step": self.state.next_step,
        }

    def assign(
        self,
        motor_name: str = "",
        current_id: int | None = None,
        target_id: int | None = None,
        current_baudrate: int | None = None,
    ) -> dict[str, Any]:
        """Give the one servo that is connected its id, rate and settings; it goes limp."""
        motor = self._motor(motor_name)
        new_id = motor.target_id
        if target_id not in (None, new_id):
            raise ConfigError("target_id", target_id, f"{motor_name} has the id {new_id}")
        writing = f"{_WRITING} the motor of {motor_name}: do not unplug it yet"
        with self._attempt(motor_name, writing) as tuner:
            hint = current_baudrate if current_baudrate in reg.BAUDS else motor.baud
            facts = find_alone(tuner, motor_name, hint=hint)
            old_id, old_baud = facts.servo_id, tuner.baud
            self._admit(motor_name, old_id, current_id)
            require_alone(tuner, motor_name)
            self.checked = None
            wanted = single_servo.settings(motor_name, facts, moved=old_id != new_id)
            # Settings first: with the new id it would look finished if this ended half-way.
            changed = tuner.call(lambda bus: single_servo.program(bus, old_id, wanted))
            if old_id != new_id:
                tuner.call(lambda bus: bus.change_id(old_id, new_id))
            single_servo.change_rate(tuner, new_id, tuner.home)
            became = f"id {new_id} kept" if old_id == new_id else f"id {old_id} is now id {new_id}"
            if old_baud != tuner.baud:
                became += f", {old_baud} baud are now {tuner.baud}"
            status = f"{motor_name}: {became}, checked and locked"
            motor = motor.with_facts(read_back(tuner, motor_name), tuner.baud)
            self._show(replace(motor, state="configured", sentence=status, fix=""))
        _log.info("%s", status)
        if self._progress is not None:
            self._progress.add(motor_name)
        self._picked, self._looked_at = None, 0.0
        settings = f" (set: {', '.join(changed)})" if changed else ""
        about = {"joint": motor_name, "step": "configured", "servo_id": new_id}
        self.say(f"✓ {status}{settings}", "good", **about)
        return {
            "motor_name": motor_name,
            "old_id": old_id,
            "new_id": new_id,
            "old_baudrate": old_baud,
            "new_baudrate": motor.baud,
            "changed": list(changed),
            "status": status,
            "next_step": self.state.next_step,
        }

    def skip(self, motor_name: str = "") -> dict[str, Any]:
        status = f"{motor_name} skipped"
        skipped = replace(self._motor(motor_name), state="skipped", sentence=status, fix="")
        with self._busy:
            self._show(skipped)
        self._picked = None
        self.say(status, joint=motor_name, step="skipped")
        return {"motor_name": motor_name, "status": status, "next_step": self.state.next_step}

    def forget(self, motor_name: str = "") -> dict[str, Any]:
        anew = replace(self._motor(motor_name), state="todo", found_id=None, sentence="", fix="")
        with self._busy:
            self._show(anew)
            self.checked = None
        if self._progress is not None:
            self._progress.forget_motors(motor_name)
        return {"motor_name": motor_name, "next_step": self.state.next_step}

    def _choose(self, motor_name: str) -> None:
        self.forget(motor_name)
        self._picked = motor_name

    def _swap(self, motor_name: str, owner: str) -> None:
        self.forget(owner)
        self._choose(motor_name)

    def repair(self) -> dict[str, Any]:
        """Store sound settings and the port's rate in all servos that have an arm's id, for good.

        They go limp. Ids and calibrations stay as they are.
        """
        with self._attempt(None, "repairing the settings") as tuner:
            heard = find_all_rates(tuner, on_rate=self._show_rate)
            ids = [servo_id for rate in heard for servo_id in rate.ids]
            if len(ids) > len(set(ids)) or any(rate.garbled for rate in heard):
                raise MotorSetupError(
                    None, "same id", "several servos share an id", "so101 setup, one at a time"
                )
            self.checked = None
            done = [
                _repaired(tuner, joint, rate.baud)
                for rate in heard
                for joint, servo_id in SERVO_IDS.items()
                if servo_id in rate.ids
            ]
        return {"changed": list(filter(None, done)), "next_step": self.state.next_step}

    def scan(self) -> dict[str, Any]:
        """Find every servo on the bus, at every baud rate; takes two seconds."""
        with self._attempt(None, "scanning the bus") as tuner:
            heard = find_all_rates(tuner, on_rate=self._show_rate)
            servos = []
            for rate in heard:
                tuner.tune(rate.baud)
                servos += [_scanned(tuner, servo_id) for servo_id in rate.ids]
            others = sum(servo["expected_name"] is None for servo in servos)
            is_garbled = any(rate.garbled for rate in heard)
            status = f"{len(servos)} servos answer"
            if not servos and not is_garbled:
                status = "no servo answers at any baud rate; is the arm's power supply on?"
            if others:
                status += f", {others} of them with ids or rates that an arm does not use"
            if is_garbled or any(servo["model"] == _UNKNOWN for servo in servos):
                status += "; some share an id, so connect them one at a time"
            self.state = replace(self.state, status=status, fix="", doing="")
        return {
            "servos_found": len(servos),
            "unexpected_count": others,
            "servos": servos,
            "status": status,
        }

    def reset(self) -> dict[str, Any]:
        """Start the setup again; the servos stay as they are."""
        with self._busy:
            self.state, self.checked = SetupView(), None
        if self._progress is not None:
            self._progress.forget_motors()
        self._picked = None
        return {"status": self.state.status}

    def verify(self) -> Verification:
        with self._attempt(None, "verifying all servos") as tuner:
            self.checked = found = chain_check.verify(tuner)
            for check in found.motors.values():
                motor = self.state.motors[check.joint]
                if check.facts is not None:
                    motor = motor.with_facts(check.facts, tuner.baud)
                if check.status == "ok":
                    sentence = f"{check.joint}: servo {check.servo_id} is set up correctly"
                    motor = replace(motor, state="verified", sentence=sentence, fix="")
                elif motor.state != "skipped":
                    motor = replace(motor, state="failed", sentence=check.error, fix=check.fix)
                self._show(motor)
            first = next((check.fix for check in found.motors.values() if check.fix), "")
            self.state = replace(self.state, status=found.sentence, fix=first)
        return found

    # How

    def _motor(self, joint: str) -> MotorView:
        if not joint:
            raise ConfigError("motor_name", None, 'is missing; name the motor, such as "gripper"')
        if joint not in self.state.motors:
            raise ConfigError("motor_name", joint, suggest(joint, self.state.motors))
        return self.state.motors[joint]

    def _show(self, motor: MotorView) -> None:
        self.state = self.state.with_motor(motor)

    def _show_rate(self, baud: int) -> None:
        self.state = replace(self.state, doing=f"listening at {baud} baud")

    @contextmanager
    def _attempt(self, joint: str | None, doing: str) -> Iterator[Tuner]:
        """Borrow the bus for one request; an error is shown in the view as well."""
        with self._busy:
            self.state = replace(self.state, doing=doing)
            try:
                with self._borrow() as access, Tuner(access) as tuner, _only(joint):
                    yield tuner
            except So101Error as error:
                self._fail(joint, error)
                raise
            finally:
                self.state = replace(self.state, doing="")

    def _fail(self, joint: str | None, error: So101Error) -> None:
        if isinstance(error, MotorSetupError):
            sentence, fix = error.reason, error.next_step
        else:  # most messages end with what to do
            sentence, _, fix = str(error).rpartition("; ")
            if not sentence:
                sentence, fix = fix, "try again"
        if joint is None:
            self.state = replace(self.state, status=sentence, fix=fix)
            return
        fix = f"{fix}; then discover {joint} again"
        self._show(replace(self._motor(joint), state="failed", sentence=sentence, fix=fix))

    def _find(self, joint: str) -> MotorView:
        with self._attempt(joint, f"looking for the servo of {joint}") as tuner:
            facts = find_alone(tuner, joint, on_rate=self._show_rate)
            found = replace(self._motor(joint).with_facts(facts, tuner.baud), state="found", fix="")
            sentence = (
                f"found a servo with id {found.found_id} at {found.baud} baud"
                f" ({found.model}, firmware {found.firmware}, {found.volts:.1f} V)"
            )
            owner = _owner(self.state, found)
            if owner is not None:
                sentence += f". That is the id of {owner}: make sure it is not the servo of {owner}"
            if facts.supply_trouble is not None:
                trouble, fix = facts.supply_trouble
                found = replace(found, fix=fix)
                sentence += f": {trouble}"
            found = replace(found, sentence=sentence)
            self._show(found)
        return found

    def _admit(self, joint: str, servo_id: int, current_id: int | None) -> None:
        if current_id not in (None, servo_id):
            raise MotorSetupError(
                joint,
                "other servo",
                f"the servo that is connected has the id {servo_id}, not {current_id}",
                f"check which servo it is, or leave current_id out to set up servo {servo_id}",
            )
        owner = self.state.owner(servo_id, but=joint)
        if owner is not None:
            raise MotorSetupError(
                joint,
                "other servo",
                f"the servo that is connected has the id {servo_id}, so it is the one of"
                f" {owner} that was set up before",
                f"unplug it and connect only the servo of {joint}; if it really is that of"
                f" {joint}, reset the setup first",
            )


@contextmanager
def _only(joint: str | None) -> Iterator[None]:
    """Blame silence on the motor of ``joint``: no other is connected, whatever its id."""
    try:
        yield
    except NoReply as error:
        if joint is None:
            raise
        reason = f"its motor did not answer (id {error.servo_id})"
        fix = "check its cable, then write its id again"
        raise MotorSetupError(joint, "no servo", reason, fix) from error


def _once_more(setup: SetupView) -> tuple[Offer, ...]:
    """What may be set up once more: all from the start, or with all done one that is chosen."""
    settled = tuple(motor.joint for motor in setup.motors.values() if motor.state in SETTLED)
    if not settled:
        return ()
    title, sure = "Start over with the gripper", "Press again to start over"
    anew = Offer(command="reset_status", title=title, asks=sure)
    if len(settled) < len(setup.motors):
        return (anew,)
    again = Offer(
        command="choose",
        title="Set it up again",
        arguments={"motor_name": settled[-1]},
        inputs={"motor_name": Input(label="Motor", choices=settled)},
    )
    return (again, anew)


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
                f"This motor was set up as the motor of {other.joint}; make sure that it is"
                f" the right one for {motor.joint}."
            )  # fmt: skip
    return ""


def _row(setup: SetupView, motor: MotorView, *, is_next: bool) -> Row:
    mark, tone = _MARKS[motor.state]
    is_another = _owner(setup, motor) is not None  # the one before is still plugged in
    if is_next and (is_another or motor.state in ("todo", "failed")):
        mark, tone = "●", "busy"
    identity = f"id {motor.found_id}"
    if motor.state == "skipped":
        identity = "skipped"
    elif motor.found_id is None or motor.state in ("todo", "failed") or is_another:
        identity = f"gets id {motor.target_id}"
    elif motor.state == "found" and motor.found_id != motor.target_id:
        identity += f" → {motor.target_id}"
    if motor.baud is not None and identity.startswith("id"):
        baud = motor.baud
        is_fast = baud >= 1_000_000
        identity += f", {baud // 1_000_000} Mbaud" if is_fast else f", {baud / 1000:g} kbaud"
    return Row(label=motor.joint, cells=(identity,), tone=tone, mark=mark)


def _repaired(tuner: Tuner, joint: str, baud: int) -> str:
    servo_id = SERVO_IDS[joint]
    tuner.tune(baud)
    facts = tuner.call(lambda bus: read_facts(bus, servo_id))
    wanted = single_servo.repairs(facts)
    changed = tuner.call(lambda bus: single_servo.program(bus, servo_id, wanted, anew=True))
    single_servo.change_rate(tuner, servo_id, tuner.home)
    changes = [
        f"{name} is {wanted[reg.REGISTERS[name]]}, was {facts.held[name]}" for name in changed
    ]
    changes += [f"{tuner.home} baud, was {baud}"] if baud != tuner.home else []
    if reg.PHASE.name in changed:
        changes.append("check its angle with so101 status, and calibrate it if that is wrong")
    return f"{joint}: {'; '.join(changes)}" if changes else ""


def _scanned(tuner: Tuner, servo_id: int) -> dict[str, Any]:
    try:
        model = tuner.call(lambda bus: read_facts(bus, servo_id)).model
    except PortUnavailable:
        raise
    except BusError:  # several answer at once
        model = _UNKNOWN
    names = (
        {number: joint for joint, number in SERVO_IDS.items()} if tuner.baud == tuner.home else {}
    )
    return {
        "id": servo_id,
        "model": model,
        "status": "expected" if servo_id in names else "unexpected",
        "expected_name": names.get(servo_id),
        "baudrate": tuner.baud,
    }


def about_servo(motor: MotorView) -> dict[str, Any]:
    return {
        "current_id": motor.found_id,
        "model": motor.model,
        "found_baudrate": motor.baud,
        "firmware": motor.firmware,
        "volts": None if motor.volts is None else round(motor.volts, 1),
    }


PUT_TOGETHER = (
    "Put all six motors on the cable, one after the other: the adapter, shoulder_pan,"
    " shoulder_lift, elbow_flex, wrist_flex, wrist_roll, gripper."
)


class ChainOperation(LocalOperation):
    """Verifies all six motors on one cable; if it ``waits``, again until all are right."""

    def __init__(
        self,
        motors: MotorOperation,
        *,
        waits: bool = False,
        is_busy: Callable[[], bool] = lambda: False,
    ) -> None:
        super().__init__()
        self._motors, self._waits, self._is_busy = motors, waits, is_busy
        self._looked_at, self._is_accepted = 0.0, False
        self.commands = {"verify": self._verify, "accept": self._accept}

    @property
    def view(self) -> View:
        found = self._motors.checked
        wrong = () if found is None else tuple(c for c in found.motors.values() if c.error)
        due = max(self._looked_at + PAUSE - time.monotonic(), 0.0) if self._waits else None
        title = "Verify all six" if found is None else "Verify again"
        why = "The calibration is under way: press Next." if self._is_busy() else None
        verify = Offer(command="verify", title=title, why_not=why, due_in=due, is_look=self._waits)
        accept = Offer(command="accept", title="Accept it as it is", key="a")
        good = "" if found is None or wrong else found.sentence
        notes = (() if found is None else found.notes) + ((_WATCHING,) if self._waits else ())
        return View(
            state="chain",
            title="All six together",
            text=PUT_TOGETHER if found is None or (wrong and self._waits) else good,
            rows=() if found is None else tuple(map(_checked_row, found.motors.values())),
            trouble=_about(wrong),
            fix=wrong[0].fix if wrong else "",
            note=" ".join(notes),
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
            found = self._motors.verify()
        finally:
            self._looked_at = time.monotonic()
        error = {} if found.ok else {"error": found.sentence}  # the published setup page shows it
        return {
            "success": found.ok,
            **error,
            "all_ok": found.ok,
            "motors": {joint: _checked(check) for joint, check in found.motors.items()},
            "unexpected_ids": list(found.unexpected_ids),
            "notes": list(found.notes),
            "status": found.sentence,
            "next_step": self._motors.state.next_step,
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
