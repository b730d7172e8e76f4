"""Convert a calibrator's situation to the calibration sensor's readings.

Keys and types are the published module's, and a few more. Nulls are not sent, because they read
back as 0: unknown values have no key. The published module sends the extremes of a 32-bit number
for a travel that is not recorded yet; here it has no key.
"""

from __future__ import annotations

from typing import Any

from so101_motion.calib.motors.setup_view import MotorView
from so101_motion.calib.procedure.steps import State
from so101_motion.calib.procedure.view import JointView
from so101_motion.setup.calibrator import Situation
from so101_motion.setup.motor_operation import about_servo


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
            "motors": {joint: _motor(motor) for joint, motor in setup.motors.items()},
        },
        "calibration_file": now.calibration_file,
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
    values = {
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
        values["verdict"] = joint.verdict.value
        values["recorded_range_degs"] = round(joint.travel_deg, 1)
    return values


def _motor(motor: MotorView) -> dict[str, Any]:
    about = {"message": motor.sentence or None, "fix": motor.fix or None}
    return {**about_servo(motor), "target_id": motor.target_id, "state": motor.state, **about}
