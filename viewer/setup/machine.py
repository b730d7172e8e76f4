"""The arm of a running machine, calibrated and set up through its calibration sensor.

``MachineCalibrator`` has the face of ``Calibrator``: what that does with a port, it asks a sensor
for. A thread reads the sensor several times a second and makes of the readings what a calibrator
would show, so the pages need not know the difference and never wait. When the machine does not
answer, what was seen last stays and the situation says that the connection is lost; the calibration
itself goes on over there.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from so101_motion.calib.record import JOINTS
from so101_motion.calib.setup_view import MotorCheck, MotorView, SetupView, Verification
from so101_motion.calib.steps import Command, State
from so101_motion.calib.store import Stored
from so101_motion.calib.verdict import Verdict
from so101_motion.calib.view import CalibrationView, JointView
from so101_motion.calibrator import Ended, Situation
from so101_motion.errors import CalibrationError, So101Error

from .calibrating import held

PERIOD = 0.12
"""How often the sensor is read [s]; chosen: bars that move with the hand."""

Told = Mapping[str, Any]


class MachineCalibrator:
    """Calibrates the arm of a machine; fits ``Calibrates``.

    Args:
        ask: Sends the calibration sensor a command; raises ``So101Error``.
        read: The sensor's readings; likewise.
        hold: Has the machine's arm held; it is not the sensor's to do.

    Attributes:
        motor_setup: The setup of its motors.

    Raises:
        So101Error: It does not answer, or is no calibration sensor.
    """

    def __init__(
        self,
        ask: Callable[[Told], Told],
        read: Callable[[], Told],
        *,
        hold: Callable[[], None] | None = None,
    ) -> None:
        self._ask, self._read, self._hold = ask, read, hold
        self._situation = to_situation(read(), self._angles())
        self.motor_setup = MachineMotors(self._do, lambda: self._situation.setup)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="so101-setup-machine", daemon=True)
        self._thread.start()

    @property
    def situation(self) -> Situation:
        """What the machine said last; never waits."""
        return self._situation

    def start(self) -> CalibrationView:
        """Let go of the joints."""
        return self._step(Command.START)

    def set_homing(self) -> CalibrationView:
        """Take the present pose for the middle of each travel."""
        return self._step(Command.SET_HOMING)

    def start_recording(self) -> CalibrationView:
        """From now on, keep where the joints have been."""
        return self._step(Command.START_RECORDING)

    def stop_recording(self, *, accept: Collection[str] = ()) -> CalibrationView:
        """End the recording if all joints have been where they must go."""
        return self._step(Command.STOP_RECORDING, accept=list(accept))

    def save(self) -> Ended:
        """Let the motors and the machine's file hold the new calibration."""
        joints = self._situation.joints
        return _ended(self._do({"command": Command.SAVE.value}), joints)

    def abort(self) -> Ended:
        """Put everything back as it was."""
        return self._end(Command.ABORT)

    def reset(self) -> Ended:
        """``abort``, under the name it has after an error."""
        return self._end(Command.RESET)

    def hold(self) -> None:
        """Have the joints held where they stand.

        Raises:
            CalibrationError: The machine's arm is not known here.
        """
        if self._hold is None:
            raise CalibrationError(
                None, "nobody here can hold the machine's arm", "let the machine's arm hold itself"
            )
        self._hold()

    def restore(self) -> Ended:
        """Let the machine's file and motors hold what they held before the last calibration."""
        answer = self._do({"command": "restore_calibration"})
        return _ended(answer, self._situation.joints)

    def close(self) -> None:
        """Look no more. A calibration under way is the machine's own and goes on."""
        self._closing.set()
        self._thread.join()

    # How

    def _watch(self) -> None:
        while not self._closing.wait(PERIOD):
            self._look()

    def _look(self) -> None:
        try:
            self._situation = to_situation(self._read(), self._angles())
        except So101Error as error:
            lost = replace(self._situation.view, error=str(error))
            self._situation = replace(self._situation, view=lost, is_connected=False)

    def _angles(self) -> dict[str, float]:
        try:
            told = self._ask({"command": "get_current_positions"})
        except So101Error:  # no servo answers, which the readings tell as well
            return {}
        return {joint: float(one["radians"]) for joint, one in told["positions"].items()}

    def _do(self, command: Told) -> Told:
        try:
            return self._ask(command)
        finally:
            self._look()

    def _step(self, command: Command, **arguments: object) -> CalibrationView:
        self._do({"command": command.value, **arguments})
        return self._situation.view

    def _end(self, command: Command) -> Ended:
        answer = self._do({"command": command.value})
        return Ended(stored=None, holds=answer.get("torque_enabled") is True, trouble=None)


def _ended(answer: Told, joints: Mapping[str, JointView]) -> Ended:
    """What is in force now, from the answer and the joints that have it."""
    stored = Stored(
        path=Path(str(answer["calibration_file"])),
        calibration=held(joints),
        zeros={},
        notes=(f"On the machine: {answer.get('message', '')}",),
    )
    return Ended(stored=stored, holds=answer.get("torque_enabled") is True, trouble=None)


class MachineMotors:
    """Sets the motors of a machine up; fits ``SetsUpMotors``.

    Args:
        ask: Sends the calibration sensor a command.
        view: How far everything is.
    """

    def __init__(self, ask: Callable[[Told], Told], view: Callable[[], SetupView]) -> None:
        self._ask, self._view = ask, view

    @property
    def view(self) -> SetupView:
        """How far everything is; never waits."""
        return self._view()

    def discover(self, joint: str) -> object:
        """Find the one motor that is connected."""
        return self._ask({"command": "motor_setup_discover", "motor_name": joint})

    def assign(self, joint: str) -> object:
        """Give the one motor that is connected its id."""
        return self._ask({"command": "motor_setup_assign_id", "motor_name": joint})

    def skip(self, joint: str) -> object:
        """Leave a joint's motor as it is."""
        return self._ask({"command": "motor_setup_skip", "motor_name": joint})

    def verify(self) -> Verification:
        """Look whether the six of the finished chain are as they must be."""
        told = self._ask({"command": "motor_setup_verify"})
        motors = {
            joint: MotorCheck(
                joint=joint,
                servo_id=round(one["id"]),
                status=str(one["status"]),
                error=str(one.get("error", "")),
                fix=str(one.get("fix", "")),
            )
            for joint, one in told["motors"].items()
        }
        return Verification(
            motors={joint: motors[joint] for joint in JOINTS if joint in motors},
            strangers=tuple(round(i) for i in told.get("unexpected_ids", ())),
            notes=tuple(map(str, told.get("notes", ()))),
            sentence=str(told["status"]),
        )

    def recall(self, joints: Collection[str]) -> None:
        """The machine remembers by itself."""

    def reset(self) -> None:
        """Forget how far the setup was."""
        self._ask({"command": "motor_setup_reset_status"})


# Out of readings


def to_situation(told: Told, angles: Mapping[str, float]) -> Situation:
    """What a calibrator would show, from the readings of a calibration sensor.

    Args:
        told: The readings.
        angles: Where the joints are [rad].

    Raises:
        CalibrationError: They are no calibration sensor's.
    """
    try:
        state = State(told["calibration_state"])
        joints = {
            joint: _joint(joint, told["joints"][joint])
            for joint in JOINTS
            if joint in told["joints"]
        }
        view = CalibrationView(
            state=state,
            instruction=str(told["instruction"]),
            joints={} if state is State.IDLE else joints,
            commands=tuple(Command(name) for name in told["available_commands"]),
            error=told.get("error"),
            note=None,
            recording_time=float(told.get("recording_time_seconds", 0.0)),
            samples=round(told.get("position_samples", 0)),
        )
        return Situation(
            view=view,
            setup=_setup(told["motor_setup"]),
            joints=joints,
            angles={joint: angle for joint, angle in angles.items() if joint in joints},
            calibration_file=Path(str(told["calibration_file"])),
            is_connected=told.get("connected") is True,
            holds=told.get("torque_enabled"),
            notes=tuple(map(str, told.get("notes", ()))),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CalibrationError(
            None,
            f"what the sensor reads is not what so101_motion's calibration sensor does: {error!r}",
            "name the sensor of the model devrel:so101:calibration, and update its module",
        ) from error


def _joint(joint: str, told: Told) -> JointView:
    verdict = told.get("verdict")
    return JointView(
        joint=joint,
        servo_id=round(told["id"]),
        ticks=_whole(told.get("current_position")),
        homing_offset=round(told["homing_offset"]),
        range_min=round(told["range_min"]),
        range_max=round(told["range_max"]),
        recorded_min=_whole(told.get("recorded_min")),
        recorded_max=_whole(told.get("recorded_max")),
        expected_deg=float(told["expected_range_degs"]),
        verdict=None if verdict is None else Verdict(verdict),
        sentence=str(told.get("message", "")),
        is_done=told["is_completed"] is True,
    )


def _setup(told: Told) -> SetupView:
    untouched = SetupView()
    motors = {
        joint: replace(
            motor,
            state=one["state"],
            found_id=_whole(one.get("current_id")),
            baud=_whole(one.get("found_baudrate")),
            model=one.get("model"),
            firmware=one.get("firmware"),
            volts=one.get("volts"),
            sentence=str(one.get("message", "")),
            fix=str(one.get("fix", "")),
        )
        for joint, motor, one in _paired(untouched.motors, told["motors"])
    }
    return SetupView(
        motors=motors, status=str(told.get("status", "")), fix=str(told.get("fix", ""))
    )


def _paired(
    motors: Mapping[str, MotorView], told: Mapping[str, Told]
) -> list[tuple[str, MotorView, Told]]:
    return [(joint, motor, told[joint]) for joint, motor in motors.items()]


def _whole(value: Any) -> int | None:
    return None if value is None else round(value)
