"""The state of a motor setup and the next step, as values that are replaced whole; no bus here."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from so101_motion.calib.motors.arm_identification import ServoFacts
from so101_motion.calib.record.record import JOINTS, SERVO_IDS
from so101_motion.files import atomic

SETUP_ORDER = tuple(reversed(JOINTS))
"""Gripper to shoulder_pan. New servos all have id 1; shoulder_pan, which keeps it, comes last."""

MOVES: Mapping[str, str] = {
    "shoulder_pan": "turns the arm on its base",
    "shoulder_lift": "lifts the upper arm",
    "elbow_flex": "bends the elbow",
    "wrist_flex": "tilts the wrist",
    "wrist_roll": "turns the gripper",
    "gripper": "opens and closes the jaw",
}
"""What each motor does, for people who do not know the joints' names."""

AS_NEW = 1  # the id of every new servo, so it does not show which joint a servo is for

State = Literal["todo", "found", "configured", "verified", "failed", "skipped"]

READY = "Motor setup ready"

SETTLED = ("configured", "verified", "skipped")


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorView:
    """The state of one joint's servo in the setup."""

    joint: str
    target_id: int
    # ``"todo"``, ``"found"`` (connected alone), ``"configured"`` (id, rate and settings stored and
    # read back), ``"verified"`` (seen in the finished chain), ``"failed"`` or ``"skipped"``
    state: State = "todo"
    found_id: int | None = None
    baud: int | None = None  # the rate it was found at, or talks at now [bit/s]
    model: str | None = None  # the published module's name of the model, such as ``"sts3215"``
    firmware: str | None = None  # such as ``"3.10"``
    volts: float | None = None  # its supply [V]
    sentence: str = ""  # what was found, or what is wrong
    fix: str = ""  # what to do about it; empty when nothing is wrong

    def with_facts(self, facts: ServoFacts, baud: int) -> MotorView:
        return replace(
            self,
            found_id=facts.servo_id,
            baud=baud,
            model=facts.model,
            firmware=facts.firmware,
            volts=facts.volts,
        )


def connect_alone(joint: str) -> str:
    which = f"the motor of {joint}, which {MOVES[joint]}"
    return f"connect only {which}, to the adapter, with the power on"


def _untouched() -> dict[str, MotorView]:
    return {joint: MotorView(joint=joint, target_id=SERVO_IDS[joint]) for joint in SETUP_ORDER}


@dataclass(frozen=True, slots=True, kw_only=True)
class SetupView:
    """The state of the motor setup."""

    motors: Mapping[str, MotorView] = field(default_factory=_untouched)
    status: str = READY
    fix: str = ""  # what to do about it; empty when nothing is wrong
    doing: str = ""  # the request under way; empty when there is none

    @property
    def step(self) -> int:
        """How many motors are set up or skipped, 0 to 6."""
        return sum(motor.state in SETTLED for motor in self.motors.values())

    @property
    def in_progress(self) -> bool:
        untouched = all(motor.state == "todo" for motor in self.motors.values())
        return bool(self.doing) or (not untouched and self.next_joint is not None)

    @property
    def next_joint(self) -> str | None:
        unsettled = (joint for joint, m in self.motors.items() if m.state not in SETTLED)
        return next(unsettled, None)

    @property
    def next_step(self) -> str:
        joint = self.next_joint
        if joint is None:
            return self._after_all()
        motor = self.motors[joint]
        if motor.state == "found":
            return f"assign {joint}: its servo gets the id {motor.target_id}"
        if motor.state == "failed":
            return motor.fix
        before = [m.joint for m in self.motors.values() if m.state == "configured"]
        unplug = f"unplug the servo of {before[-1]}, " if before else ""
        return (
            f"{unplug}connect only the servo of {joint} to the adapter, with the power on,"
            f" then discover {joint}"
        )

    def _after_all(self) -> str:
        states = {motor.state for motor in self.motors.values()}
        if states == {"verified"}:
            return "all six servos are set up: put the arm together and calibrate it"
        if states <= {"verified", "skipped"}:
            return "the others are set up; set up the skipped ones, or calibrate the arm"
        return "connect all six servos in a chain, shoulder_pan at the adapter, then verify"

    def owner(self, servo_id: int | None, *, but: str) -> str | None:
        """The joint, other than ``but``, whose motor was given this id; None if there is none."""
        for joint, motor in self.motors.items():
            is_set_up = motor.state in ("configured", "verified")
            if joint != but and is_set_up and motor.target_id == servo_id != AS_NEW:
                return joint
        return None

    def with_motor(self, motor: MotorView) -> SetupView:
        motors = {**self.motors, motor.joint: motor}
        return replace(self, motors=motors, status=motor.sentence, fix=motor.fix, doing="")


# Results


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorCheck:
    """The result of checking one joint's servo in the finished chain."""

    joint: str
    servo_id: int
    # ``"ok"``, ``"not_responding"``, ``"duplicate"``, ``"model_detection_failed"``,
    # ``"wrong_model"``, ``"wrong_voltage"`` or ``"wrong_settings"``
    status: str
    facts: ServoFacts | None = None  # its registers; None if they could not be read
    error: str = ""  # what is wrong; empty when nothing is
    fix: str = ""  # what to do about it


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification:
    """The result of checking the finished chain."""

    motors: Mapping[str, MotorCheck]
    unexpected_ids: tuple[int, ...]
    notes: tuple[str, ...]
    sentence: str
    misplaced: str = ""  # what is wrong with the order of the ids; empty if nothing shows

    @property
    def ok(self) -> bool:
        return not self.misplaced and all(check.status == "ok" for check in self.motors.values())


PROGRESS_FILE = "setup.json"


class SetupProgress:
    """Which steps and motors are done, kept in a file, so that a later start continues there.

    The terminal and the page use the same file, so a setup begun on one can be ended on the other.
    Losing it does no harm: the setup then begins with its first step. Progress on another port is
    forgotten; None takes the port, or machine, from the file. What is not known is empty.
    """

    def __init__(self, path: Path, port: str | None) -> None:
        self._path = path
        self.port, self.workflow, self.step, self.arm = port or "", "", "", ""
        self.done: list[str] = []
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
            content = json.loads(path.read_text(encoding="utf-8"))
            done = [joint for joint in SETUP_ORDER if joint in content["done"]]
            if port is None or content["port"] == port:
                self.port, self.done = str(content["port"]), done
                texts = (str(content.get(name, "")) for name in ("workflow", "step", "arm"))
                self.workflow, self.step, self.arm = texts

    def add(self, joint: str) -> None:
        if joint not in self.done:
            self.done.append(joint)
            self._keep()

    def reach(self, workflow: str, step: str) -> None:
        if (workflow, step) != (self.workflow, self.step):
            self.workflow, self.step = workflow, step
            self._keep()

    def call(self, arm: str) -> None:
        self.arm = arm
        self._keep()

    def work_on(self, port: str) -> None:
        if port != self.port:
            self.port, self.done = port, []
            self._keep()

    def forget_motors(self, *joints: str) -> None:
        """Forget that the motors of these joints have their ids, or of all; the step stays."""
        self.done = [joint for joint in self.done if joints and joint not in joints]
        self._keep()

    def clear(self) -> None:
        self.done, self.workflow, self.step, self.arm = [], "", "", ""
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)

    def _keep(self) -> None:
        content = {name: value for name, value in vars(self).items() if name != "_path"}
        with contextlib.suppress(OSError):  # then the next start begins with the first step
            self._path.parent.mkdir(parents=True, exist_ok=True)
            atomic.write(self._path, json.dumps(content).encode() + b"\n")
