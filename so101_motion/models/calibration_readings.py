"""What the calibration sensor reads: the published module's keys and types, and a little more.

Nulls are never sent, for they read back as 0: what is not known has no key. The published module
sends the extremes of a 32-bit number for a travel that was not recorded yet; here it is absent.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from so101_motion.calib.setup_view import MotorView, SetupView
from so101_motion.calib.steps import State
from so101_motion.calib.view import JointView
from so101_motion.calibrator import Situation

_RECORDED = (State.RECORDING, State.COMPLETED)


def readings(now: Situation) -> dict[str, Any]:
    """Everything there is to know, under the sensor's keys; what is None is not to be sent."""
    view = now.view
    told: dict[str, Any] = {
        "calibration_state": view.state.value,
        "instruction": view.instruction,
        "available_commands": [command.value for command in view.commands],
        "servo_count": len(now.joints),
        "joints": {joint: _joint(of_joint) for joint, of_joint in now.joints.items()},
        "motor_setup": motor_setup(now.setup),
        "calibration_file": str(now.calibration_file),
        "connected": now.is_connected,
        "torque_enabled": now.holds,
        "error": view.error,
    }
    if view.state in _RECORDED:
        told["recording_time_seconds"] = round(view.recording_time, 3)
        told["position_samples"] = view.samples
    if now.notes:
        told["notes"] = list(now.notes)
    return told


def _joint(joint: JointView) -> dict[str, Any]:
    told: dict[str, Any] = {
        "id": joint.servo_id,
        "current_position": joint.ticks,
        "homing_offset": joint.homing_offset,
        "range_min": joint.range_min,
        "range_max": joint.range_max,
        "recorded_min": joint.recorded_min,
        "recorded_max": joint.recorded_max,
        "is_completed": joint.is_done,
        "expected_range_degs": round(joint.expected_deg, 1),
        "message": joint.sentence or None,
    }
    if joint.verdict is not None:
        told["verdict"] = joint.verdict.value
        told["recorded_range_degs"] = round(joint.travel_deg, 1)
    return told


def motor_setup(setup: SetupView) -> dict[str, Any]:
    """How far the motor setup is."""
    return {
        "in_progress": setup.in_progress,
        "step": setup.step,
        "status": setup.doing or setup.status,
        "next_motor": setup.next_joint,
        "next_step": setup.next_step,
        "fix": setup.fix or None,
        "motors": {joint: _motor(motor) for joint, motor in setup.motors.items()},
    }


def _motor(motor: MotorView) -> dict[str, Any]:
    return {
        "target_id": motor.target_id,
        "state": motor.state,
        **about_servo(motor),
        "message": motor.sentence or None,
        "fix": motor.fix or None,
    }


def about_servo(motor: MotorView) -> dict[str, Any]:
    """What is known of the servo that was found for a motor."""
    return {
        "current_id": motor.found_id,
        "model": motor.model,
        "found_baudrate": motor.baud,
        "firmware": motor.firmware,
        "volts": None if motor.volts is None else round(motor.volts, 1),
    }


def ranges(joints: Mapping[str, JointView]) -> dict[str, Any]:
    """The travels that were recorded [tick]."""
    return {
        joint: {
            "min": of_joint.recorded_min,
            "max": of_joint.recorded_max,
            "range": of_joint.recorded_max - of_joint.recorded_min,
        }
        for joint, of_joint in joints.items()
        if of_joint.recorded_min is not None and of_joint.recorded_max is not None
    }
