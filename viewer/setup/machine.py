"""Calibrate a running machine's arm, and set up its motors, through its calibration sensor.

A thread reads the sensor several times a second, so ``situation`` never waits. When the machine
does not answer, the last situation stays, marked as not connected; the calibration itself goes on
over there.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path

from so101_motion.calib.motors.setup_view import MotorCheck, SetupView, Verification
from so101_motion.calib.procedure import summary
from so101_motion.calib.procedure.steps import Command
from so101_motion.calib.procedure.view import JointView
from so101_motion.calib.record.record import JOINTS
from so101_motion.calib.record.store import Stored
from so101_motion.common.errors import CalibrationError, So101Error
from so101_motion.setup.calibrator import BaseCalibrator, Situation, StepResult
from so101_motion.setup.situation_json import Json, from_readings

PERIOD = 0.12
"""How often the sensor is read [s]; chosen: bars that move with the hand."""


class MachineCalibrator(BaseCalibrator):
    """Calibrates the arm of a machine through its calibration sensor.

    Args:
        ask: Sends the calibration sensor a command; raises ``So101Error``.
        read: Reads it.
        set_torque: Holds the machine's arm or lets it go; None if there is no arm.

    Raises:
        So101Error: It does not answer, or is no calibration sensor.
    """

    def __init__(
        self,
        ask: Callable[[Json], Json],
        read: Callable[[], Json],
        *,
        set_torque: Callable[[bool], None] | None = None,
    ) -> None:
        self._ask, self._read, self._set_torque = ask, read, set_torque
        self._situation = from_readings(read(), self._angles())
        self.motor_setup = MachineMotors(self._do, lambda: self._situation.setup)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="so101-setup-machine", daemon=True)
        self._thread.start()

    @property
    def situation(self) -> Situation:
        """The machine's newest readings; never waits."""
        return self._situation

    def step(self, command: Command, *, accept: Collection[str] = ()) -> StepResult:
        """Carry out a step; raises the machine's errors."""
        accepted = {"accept": list(accept)} if command is Command.STOP_RECORDING else {}
        joints = self._situation.joints
        return _result(self._do({"command": command.value, **accepted}), joints)

    def hold(self) -> None:
        """Hold the joints where they stand.

        Raises:
            CalibrationError: The machine's arm is not known here.
        """
        self._torque(True)

    def let_go(self) -> None:
        """Let the joints sink.

        Raises:
            CalibrationError: The machine's arm is not known here.
        """
        self._torque(False)

    def restore(self, number: int | None = None) -> StepResult:
        """Restore an earlier version in the machine's file and motors."""
        which = {} if number is None else {"number": number}
        answer = self._do({"command": "restore_calibration", **which})
        return _result(answer, self._situation.joints)

    def close(self) -> None:
        """Stop reading. A running calibration continues on the machine."""
        self._closing.set()
        self._thread.join()

    # Helpers

    def _torque(self, on: bool) -> None:
        if self._set_torque is None:
            raise CalibrationError(
                None,
                "the machine has no arm yet, so its joints can neither be held nor let go of",
                "add the arm to the machine's configuration",
            )
        self._set_torque(on)

    def _watch(self) -> None:
        while not self._closing.wait(PERIOD):
            self._look()

    def _look(self) -> None:
        try:
            self._situation = from_readings(self._read(), self._angles())
        except So101Error as error:
            lost = replace(self._situation.view, error=str(error))
            self._situation = replace(self._situation, view=lost, is_connected=False)

    def _angles(self) -> dict[str, float]:
        try:
            answer = self._ask({"command": "get_current_positions"})
        except So101Error:  # no servo answers; the readings say so as well
            return {}
        return {joint: float(one["radians"]) for joint, one in answer["positions"].items()}

    def _do(self, command: Json) -> Json:
        try:
            return self._ask(command)
        finally:
            self._look()


def _result(answer: Json, joints: Mapping[str, JointView]) -> StepResult:
    """The result of a step, from the answer and the joints before it."""
    stored = None
    if "calibration_file" in answer:
        stored = Stored(
            path=Path(str(answer["calibration_file"])),
            calibration=summary.calibration_of(joints),
            zeros={},
            notes=(f"On the machine: {answer.get('message', '')}",),
        )
    return StepResult(stored=stored, holds=answer.get("torque_enabled") is True)


class MachineMotors:
    """Sets the motors of a machine up; fits ``MotorSetupLike``."""

    def __init__(self, ask: Callable[[Json], Json], view: Callable[[], SetupView]) -> None:
        self._ask, self._view = ask, view

    @property
    def view(self) -> SetupView:
        """The state of the setup; never waits."""
        return self._view()

    def discover(self, joint: str) -> object:
        """Find the one connected motor."""
        return self._ask({"command": "motor_setup_discover", "motor_name": joint})

    def assign(self, joint: str) -> object:
        """Give the one connected motor its id."""
        return self._ask({"command": "motor_setup_assign_id", "motor_name": joint})

    def skip(self, joint: str) -> object:
        """Leave a joint's motor as it is."""
        return self._ask({"command": "motor_setup_skip", "motor_name": joint})

    def verify(self) -> Verification:
        """Check the six motors of the finished chain."""
        answer = self._ask({"command": "motor_setup_verify"})
        motors = {
            joint: MotorCheck(
                joint=joint,
                servo_id=round(one["id"]),
                status=str(one["status"]),
                error=str(one.get("error", "")),
                fix=str(one.get("fix", "")),
            )
            for joint, one in answer["motors"].items()
        }
        return Verification(
            motors={joint: motors[joint] for joint in JOINTS if joint in motors},
            unexpected_ids=tuple(round(i) for i in answer.get("unexpected_ids", ())),
            notes=tuple(map(str, answer.get("notes", ()))),
            sentence=str(answer["status"]),
        )

    def forget(self, joint: str) -> None:
        """Ask for a joint's motor again."""
        self._ask({"command": "motor_setup_forget", "motor_name": joint})

    def recall(self, joints: Collection[str]) -> None:
        """Does nothing: the machine remembers by itself."""

    def reset(self) -> None:
        """Start the setup again."""
        self._ask({"command": "motor_setup_reset_status"})
