"""Set up the servos of a kit: give each its id, the port's baud rate and its settings.

New servos all have id 1, so they are set up one at a time: connect one alone, ``discover`` it,
``assign`` it, unplug it, and so on from the gripper to the shoulder. Then, in the finished chain,
``verify`` checks that everything is set up correctly. ``view.next_step`` always says what is next.

``assign`` always looks again which servo is connected, because plugs change between two requests.
It changes an id only if exactly one servo answers, and none at any other baud rate. It succeeds
once the servo answers at its new id and rate and its settings read back correctly. It may be called
again after any failure: it finds the servo at whatever id and rate it has now.

The bus is borrowed for each request and given back after it. Methods may be called from any thread
and wait for each other; ``view`` never waits.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace

from so101_motion.calib.access import BusAccess
from so101_motion.calib.motors import chain_check, servo_program
from so101_motion.calib.motors.arm_identification import ServoFacts, read_facts
from so101_motion.calib.motors.servo_search import Tuner, find_all_rates
from so101_motion.calib.motors.setup_view import (
    Assignment,
    BusScan,
    MotorView,
    ScannedServo,
    SetupView,
    Verification,
)
from so101_motion.calib.motors.single_servo import (
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
    PortUnavailable,
    So101Error,
)
from so101_motion.drivers.bus import registers as reg

_log = logging.getLogger(__name__)


class MotorSetup:
    """The setup of an arm's six servos.

    Args:
        borrow: Lends their bus until its block ends. Giving it back must not raise because servos
            are missing, as they are during a setup.

    Attributes:
        checked: The result of the last ``verify``; None before, and once a servo was changed.
    """

    def __init__(self, borrow: Callable[[], AbstractContextManager[BusAccess]]) -> None:
        self.checked: Verification | None = None
        self._borrow = borrow
        self._view = SetupView()
        self._busy = threading.Lock()

    @property
    def view(self) -> SetupView:
        """The state of the setup."""
        return self._view

    @property
    def next_joint(self) -> str | None:
        """The joint whose servo is next; None when all are done."""
        return self._view.next_joint

    # One servo at a time

    def discover(self, joint: str) -> MotorView:
        """Find the one servo that is connected, whatever its id and baud rate.

        Raises:
            ConfigError: There is no such joint.
            MotorSetupError: No servo answers, or more than one, or it is another model.
            BusError: The port is gone, or the servo cannot be read.
        """
        motor = self._motor(joint)
        with self._attempt(joint, f"looking for the servo of {joint}") as tuner:
            facts = find_alone(tuner, joint, hint=None, on_rate=self._show_rate)
            found = replace(motor.with_facts(facts, tuner.baud), state="found")
            found = replace(found, sentence=self._what_was_found(found), fix="")
            trouble = facts.supply_trouble
            if trouble is not None:
                found = replace(found, sentence=f"{found.sentence}: {trouble[0]}")
                found = replace(found, fix=trouble[1])
            self._show(found)
        return found

    def assign(
        self,
        joint: str,
        *,
        current_id: int | None = None,
        target_id: int | None = None,
        current_baud: int | None = None,
    ) -> Assignment:
        """Give the one servo that is connected its id, rate and settings; it goes limp.

        Args:
            joint: The joint that it is for.
            current_id: The id it must have now; any by default.
            target_id: The id to give; only the joint's own will do.
            current_baud: The rate to look for it first [bit/s].

        Raises:
            ConfigError: There is no such joint, or ``target_id`` is another joint's.
            MotorSetupError: It is not safe to do, or did not succeed.
            BusError: The port is gone, or the servo does not take a setting.
        """
        motor = self._motor(joint)
        if target_id not in (None, motor.target_id):
            raise ConfigError("target_id", target_id, f"{joint} has the id {motor.target_id}")
        with self._attempt(joint, f"setting up the servo of {joint}") as tuner:
            hint = current_baud if current_baud in reg.BAUDS else motor.baud
            facts = find_alone(tuner, joint, hint=hint, on_rate=self._show_rate)
            self._admit(joint, facts.servo_id, current_id)
            require_alone(tuner, joint)
            self.checked = None
            done = self._carry_out(tuner, joint, facts)
            now = read_back(tuner, joint)
            motor = replace(motor.with_facts(now, tuner.baud), state="configured")
            self._show(replace(motor, sentence=done.sentence, fix=""))
        _log.info("%s", done.sentence)
        return done

    def skip(self, joint: str) -> MotorView:
        """Leave a joint's servo as it is and go on with the next.

        Raises:
            ConfigError: There is no such joint.
        """
        skipped = replace(self._motor(joint), state="skipped", sentence=f"{joint} skipped", fix="")
        with self._busy:
            self._show(skipped)
        return skipped

    def recall(self, joints: Collection[str]) -> None:
        """Mark the servos of these joints as set up by an earlier setup.

        Raises:
            ConfigError: There is no such joint.
        """
        for joint in joints:
            motor = self._motor(joint)
            if motor.state == "todo":
                known = replace(motor, state="configured", found_id=motor.target_id)
                with self._busy:
                    self._show(replace(known, sentence=f"{joint} was set up before"))

    # All of them

    def verify(self) -> Verification:
        """Check the six servos of the finished chain."""
        with self._attempt(None, "verifying all servos") as tuner:
            self.checked = found = chain_check.verify(tuner)
            for check in found.motors.values():
                motor = self._view.motors[check.joint]
                if check.facts is not None:
                    motor = motor.with_facts(check.facts, tuner.baud)
                if check.status == "ok":
                    sentence = f"{check.joint}: servo {check.servo_id} is set up correctly"
                    motor = replace(motor, state="verified", sentence=sentence, fix="")
                elif motor.state != "skipped":
                    motor = replace(motor, state="failed", sentence=check.error, fix=check.fix)
                self._show(motor)
            first = next((check.fix for check in found.motors.values() if check.fix), "")
            self._view = replace(self._view, status=found.sentence, fix=first)
        return found

    def repair(self) -> tuple[str, ...]:
        """Store sound settings and the port's rate in all servos that have an arm's id, for good.

        They go limp. Ids and calibrations stay as they are.

        Returns:
            What was changed, a sentence for each servo.

        Raises:
            MotorSetupError: Several servos share an id.
            BusError: The port is gone, or a servo does not take a setting.
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
                self._repaired(tuner, joint, rate.baud)
                for rate in heard
                for joint, servo_id in SERVO_IDS.items()
                if servo_id in rate.ids
            ]
        return tuple(filter(None, done))

    def scan(self) -> BusScan:
        """Find every servo on the bus, at every baud rate; takes two seconds."""
        with self._attempt(None, "scanning the bus") as tuner:
            heard = find_all_rates(tuner, on_rate=self._show_rate)
            servos = []
            for rate in heard:
                tuner.tune(rate.baud)
                servos += [self._scanned(tuner, servo_id) for servo_id in rate.ids]
            garbled = tuple(rate.baud for rate in heard if rate.garbled)
            found = BusScan(
                servos=tuple(servos), garbled=garbled, sentence=_about_scan(servos, garbled)
            )
            self._view = replace(self._view, status=found.sentence, fix="", doing="")
        return found

    def forget(self, joint: str) -> None:
        """Mark a joint's servo as not set up, because a wrong one was; changes no servo.

        Raises:
            ConfigError: There is no such joint.
        """
        anew = replace(self._motor(joint), state="todo", found_id=None, sentence="", fix="")
        with self._busy:
            self._show(anew)
            self.checked = None

    def reset(self) -> None:
        """Start the setup again; the servos stay as they are."""
        with self._busy:
            self._view, self.checked = SetupView(), None

    # How

    def _motor(self, joint: str) -> MotorView:
        if joint not in self._view.motors:
            raise ConfigError("motor_name", joint, suggest(joint, self._view.motors))
        return self._view.motors[joint]

    def _show(self, motor: MotorView) -> None:
        self._view = self._view.with_motor(motor)

    def _show_rate(self, baud: int) -> None:
        self._view = replace(self._view, doing=f"listening at {baud} baud")

    @contextmanager
    def _attempt(self, joint: str | None, doing: str) -> Iterator[Tuner]:
        """Borrow the bus for one request; an error is shown in the view as well."""
        with self._busy:
            self._view = replace(self._view, doing=doing)
            try:
                with self._borrow() as access, Tuner(access) as tuner:
                    yield tuner
            except So101Error as error:
                self._note(joint, error)
                raise
            finally:
                self._view = replace(self._view, doing="")

    def _note(self, joint: str | None, error: So101Error) -> None:
        if isinstance(error, MotorSetupError):
            sentence, fix = error.reason, error.next_step
        else:  # most messages end with what to do
            sentence, _, fix = str(error).rpartition("; ")
            if not sentence:
                sentence, fix = fix, "try again"
        if joint is None:
            self._view = replace(self._view, status=sentence, fix=fix)
            return
        fix = f"{fix}; then discover {joint} again"
        self._show(replace(self._motor(joint), state="failed", sentence=sentence, fix=fix))

    def _what_was_found(self, found: MotorView) -> str:
        sentence = (
            f"found a servo with id {found.found_id} at {found.baud} baud"
            f" ({found.model}, firmware {found.firmware}, {found.volts:.1f} V)"
        )
        owner = self._view.owner(found.found_id, but=found.joint)
        if owner is not None:
            sentence += f". That is the id of {owner}: make sure it is not the servo of {owner}"
        return sentence

    def _admit(self, joint: str, servo_id: int, current_id: int | None) -> None:
        """Refuse a servo that should not be assigned to ``joint``."""
        if current_id not in (None, servo_id):
            raise MotorSetupError(
                joint,
                "other servo",
                f"the servo that is connected has the id {servo_id}, not {current_id}",
                f"check which servo it is, or leave current_id out to set up servo {servo_id}",
            )
        owner = self._view.owner(servo_id, but=joint)
        if owner is not None:
            raise MotorSetupError(
                joint,
                "other servo",
                f"the servo that is connected has the id {servo_id}, so it is the one of"
                f" {owner} that was set up before",
                f"unplug it and connect only the servo of {joint}; if it really is that of"
                f" {joint}, reset the setup first",
            )

    def _carry_out(self, tuner: Tuner, joint: str, facts: ServoFacts) -> Assignment:
        old_id, old_baud, new_id = facts.servo_id, tuner.baud, SERVO_IDS[joint]
        wanted = servo_program.settings(joint, facts, moved=old_id != new_id)
        # Settings first: with the new id it would look finished if this ended half-way.
        changed = tuner.call(lambda bus: servo_program.program(bus, old_id, wanted))
        tuner.call(lambda bus: servo_program.change_id(bus, old_id, new_id))
        servo_program.change_rate(tuner, new_id, tuner.home)
        return Assignment(
            joint=joint,
            old_id=old_id,
            new_id=new_id,
            old_baud=old_baud,
            new_baud=tuner.baud,
            changed=changed,
            sentence=f"{joint}: servo {old_id} at {old_baud} baud is now servo {new_id} at"
            f" {tuner.baud} baud, read back and locked",
        )

    def _repaired(self, tuner: Tuner, joint: str, baud: int) -> str:
        servo_id = SERVO_IDS[joint]
        tuner.tune(baud)
        facts = tuner.call(lambda bus: read_facts(bus, servo_id))
        wanted = servo_program.repairs(facts)
        changed = tuner.call(lambda bus: servo_program.program(bus, servo_id, wanted, anew=True))
        servo_program.change_rate(tuner, servo_id, tuner.home)
        changes = [
            f"{name} is {wanted[reg.REGISTERS[name]]}, was {facts.held[name]}" for name in changed
        ]
        changes += [f"{tuner.home} baud, was {baud}"] if baud != tuner.home else []
        if reg.PHASE.name in changed:
            changes.append("check its angle with so101 status, and calibrate it if that is wrong")
        return f"{joint}: {'; '.join(changes)}" if changes else ""

    def _scanned(self, tuner: Tuner, servo_id: int) -> ScannedServo:
        try:
            model = tuner.call(lambda bus: read_facts(bus, servo_id)).model
        except PortUnavailable:
            raise
        except BusError:
            model = None
        names = {i: joint for joint, i in SERVO_IDS.items()} if tuner.baud == tuner.home else {}
        return ScannedServo(
            servo_id=servo_id, baud=tuner.baud, model=model, expected_joint=names.get(servo_id)
        )


def _about_scan(servos: list[ScannedServo], garbled: tuple[int, ...]) -> str:
    if not servos and not garbled:
        return "no servo answers at any baud rate; is the arm's power supply on?"
    others = sum(servo.expected_joint is None for servo in servos)
    sentence = f"{len(servos)} servos answer"
    if others:
        sentence += f", {others} of them with ids or rates that an arm does not use"
    if garbled or any(servo.model is None for servo in servos):
        sentence += "; some share an id, so connect them one at a time"
    return sentence
