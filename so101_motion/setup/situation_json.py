"""Convert a calibrator's situation to the calibration sensor's readings and back.

Keys and types are the published module's, and a few more. Nulls are not sent, because they read
back as 0: unknown values have no key. The published module sends the extremes of a 32-bit number
for a travel that is not recorded yet; here it has no key.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from so101_motion.calib.motors.setup_view import MotorView, SetupView
from so101_motion.calib.procedure.steps import Command, State
from so101_motion.calib.procedure.travel_assessment import Verdict
from so101_motion.calib.procedure.view import CalibrationView, JointView
from so101_motion.calib.record.record import JOINTS
from so101_motion.common.errors import CalibrationError
from so101_motion.setup.calibrator import Situation

Json = Mapping[str, Any]
_Row = tuple[str, Callable[[Any], Any], Callable[[Any], Any]]


def _same(value: Any) -> Any:
    return value


def _whole(value: Any) -> int | None:
    return None if value is None else round(value)


def _text(value: Any) -> str:
    return "" if value is None else str(value)


def _tenths(value: float | None) -> float | None:
    return None if value is None else round(value, 1)


def _or_none(text: str) -> str | None:
    return text or None


_JOINT: Mapping[str, _Row] = {
    "servo_id": ("id", _same, round),
    "ticks": ("current_position", _same, _whole),
    "homing_offset": ("homing_offset", _same, round),
    "range_min": ("range_min", _same, round),
    "range_max": ("range_max", _same, round),
    "recorded_min": ("recorded_min", _same, _whole),
    "recorded_max": ("recorded_max", _same, _whole),
    "is_done": ("is_completed", _same, bool),
    "expected_deg": ("expected_range_degs", _tenths, float),
    "sentence": ("message", _or_none, _text),
}
"""Each field of a ``JointView``: its key, how it is written, and how it is read."""

_SERVO: Mapping[str, _Row] = {
    "found_id": ("current_id", _same, _whole),
    "model": ("model", _same, _same),
    "baud": ("found_baudrate", _same, _whole),
    "firmware": ("firmware", _same, _same),
    "volts": ("volts", _tenths, _same),
}
"""The same for the fields of a ``MotorView`` about the servo that was found."""

_MOTOR: Mapping[str, _Row] = {
    **_SERVO,
    "target_id": ("target_id", _same, round),
    "state": ("state", _same, str),
    "sentence": ("message", _or_none, _text),
    "fix": ("fix", _or_none, _text),
}


def _write(value: object, rows: Mapping[str, _Row]) -> dict[str, Any]:
    return {key: to_json(getattr(value, field)) for field, (key, to_json, _) in rows.items()}


def _read(values: Json, rows: Mapping[str, _Row]) -> dict[str, Any]:
    return {field: from_json(values.get(key)) for field, (key, _, from_json) in rows.items()}


# Writing


def readings(now: Situation) -> dict[str, Any]:
    """The readings under the sensor's keys; None values are not to be sent."""
    view, setup = now.view, now.setup
    values: dict[str, Any] = {
        "calibration_state": view.state.value,
        "instruction": view.instruction,
        "available_commands": [command.value for command in view.commands],
        "servo_count": len(now.joints),
        "joints": {joint: _joint(of_joint) for joint, of_joint in now.joints.items()},
        "motor_setup": {
            "in_progress": setup.in_progress,
            "step": setup.step,
            "status": setup.doing or setup.status,
            "next_motor": setup.next_joint,
            "next_step": setup.next_step,
            "fix": setup.fix or None,
            "motors": {joint: _write(motor, _MOTOR) for joint, motor in setup.motors.items()},
        },
        "calibration_file": str(now.calibration_file),
        "connected": now.is_connected,
        "torque_enabled": now.holds,
        "error": view.error,
    }
    if view.state in (State.RECORDING, State.COMPLETED):
        values["recording_time_seconds"] = round(view.recording_time, 3)
        values["position_samples"] = view.samples
    if now.notes:
        values["notes"] = list(now.notes)
    return values


def _joint(joint: JointView) -> dict[str, Any]:
    values = _write(joint, _JOINT)
    if joint.verdict is not None:
        values["verdict"] = joint.verdict.value
        values["recorded_range_degs"] = round(joint.travel_deg, 1)
    return values


def about_servo(motor: MotorView) -> dict[str, Any]:
    """The keys about the servo that was found for a motor."""
    return _write(motor, _SERVO)


# Reading


def from_readings(values: Json, angles: Mapping[str, float]) -> Situation:
    """Read a situation from a sensor's readings.

    Args:
        values: The readings.
        angles: The joint angles [rad].

    Raises:
        CalibrationError: They are not from a calibration sensor.
    """
    try:
        return _situation(values, angles)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CalibrationError(
            None,
            f"the readings are not those of so101_motion's calibration sensor: {error!r}",
            "name a sensor of the model devrel:so101:calibration, and update its module",
        ) from error


def _situation(values: Json, angles: Mapping[str, float]) -> Situation:
    state = State(values["calibration_state"])
    joints = {
        joint: _joint_view(joint, values["joints"][joint])
        for joint in JOINTS
        if joint in values["joints"]
    }
    motors, setup = values["motor_setup"]["motors"], values["motor_setup"]
    view = CalibrationView(
        state=state,
        instruction=str(values["instruction"]),
        joints={} if state is State.IDLE else joints,
        commands=tuple(map(Command, values["available_commands"])),
        error=values.get("error"),
        note=None,
        recording_time=float(values.get("recording_time_seconds", 0.0)),
        samples=round(values.get("position_samples", 0)),
    )
    return Situation(
        view=view,
        setup=SetupView(
            motors={
                joint: replace(motor, **_read(motors[joint], _MOTOR))
                for joint, motor in SetupView().motors.items()
            },
            status=_text(setup.get("status")),
            fix=_text(setup.get("fix")),
        ),
        joints=joints,
        angles={joint: angle for joint, angle in angles.items() if joint in joints},
        calibration_file=Path(str(values["calibration_file"])),
        is_connected=values.get("connected") is True,
        holds=values.get("torque_enabled"),
        notes=tuple(map(str, values.get("notes", ()))),
    )


def _joint_view(joint: str, values: Json) -> JointView:
    verdict = values.get("verdict")
    found = None if verdict is None else Verdict(verdict)
    return JointView(joint=joint, verdict=found, **_read(values, _JOINT))
