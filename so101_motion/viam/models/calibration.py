"""``devrel:so101:calibration``: a sensor for motor setup and calibration."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

from viam.components.sensor import Sensor
from viam.resource.types import Model

from so101_motion.calib.record import store
from so101_motion.rig.hardware_rig import open_without_waiting
from so101_motion.viam.component_config import CALIBRATION_FILE, CalibrationConfig
from so101_motion.viam.conversion import convert
from so101_motion.viam.models.configured import Configured, Dependencies
from so101_motion.viam.requests.await_motion import run_to_end
from so101_motion.viam.requests.operation_commands import operation_commands

if TYPE_CHECKING:
    from so101_motion.calib.motors.setup_view import MotorView
    from so101_motion.calib.procedure.view import JointView
    from so101_motion.setup.calibrator import Calibrator, Situation


_CALIBRATING = (
    "start", "set_homing", "start_range_recording", "stop_range_recording", "save_calibration",
    "abort", "reset", "restore_calibration", "get_current_positions", "setup_steps",
)  # fmt: skip
_SETTING_UP = ("discover", "assign_id", "skip", "forget", "repair", "scan_bus", "reset_status")

COMMANDS = {
    **{key: ("calibration", key) for key in _CALIBRATING},
    **{f"motor_setup_{key}": ("motors", key) for key in _SETTING_UP},
    "motor_setup_verify": ("chain", "verify"),
}
"""For each published key the operation and its command."""


class So101Calibration(Configured, Sensor):
    """A sensor for motor setup and calibration: its readings give the state, commands do the steps.

    It shares the port with an arm and a gripper and needs neither. It only reads the servos until
    a command needs the bus for itself.
    """

    MODEL: ClassVar = Model.from_string("devrel:so101:calibration")
    CONFIG = CalibrationConfig

    def __init__(self, name: str, calibrator: Calibrator, first_try: Future[None]) -> None:
        from so101_motion.setup.calibration_operation import CalibrationOperation

        super().__init__(name)
        self._first_try = first_try
        self._calibrator = calibrator
        self._calibration = CalibrationOperation(calibrator)
        operations = {
            "calibration": self._calibration,
            "motors": calibrator.motors,
            "chain": calibrator.chain,
        }
        self._commands = operation_commands(operations, COMMANDS, beside={"success": True})

    @classmethod
    def build(
        cls, name: str, wanted: CalibrationConfig, dependencies: Dependencies
    ) -> So101Calibration:
        from so101_motion.setup.calibrator import Calibrator

        own = wanted.connection  # its servos are not the rig's
        settings = replace(
            own.servo_settings(),
            timeout=None,
            rate=None,
            fallback_file=store.resolve(own.calibration_file or CALIBRATION_FILE),
        )
        rig = open_without_waiting(settings)
        try:
            return cls(name, Calibrator(rig, wanted.joints), rig.first_try)
        except BaseException:
            rig.close()
            raise

    async def get_readings(self, **kwargs: Any) -> Mapping[str, Any]:
        await asyncio.shield(asyncio.wrap_future(self._first_try))  # a moment, once
        now = readings(self._calibrator.situation)
        return convert.to_result({**now, "last_save_error": self._calibration.last_save_error})

    async def get_status(self, **kwargs: Any) -> Mapping[str, Any]:
        now = self._calibrator.situation
        return {
            "calibration_state": now.view.state.value,
            "motor_setup_in_progress": now.setup.in_progress,
            "calibration_file": now.calibration_file,
            "connected": now.is_connected,
        }

    async def close(self) -> None:
        await run_to_end(self._calibrator.close)


def readings(now: Situation) -> dict[str, Any]:
    """The readings under the sensor's keys; None values are not to be sent: they read back as 0.

    Keys and types are the published module's, and a few more. It sends the extremes of a 32-bit
    number for a travel that is not recorded yet; here that has no key.
    """
    from so101_motion.calib.procedure.steps import State

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
    from so101_motion.setup.motor_operation import about_servo

    about = {"message": motor.sentence or None, "fix": motor.fix or None}
    return {**about_servo(motor), "target_id": motor.target_id, "state": motor.state, **about}
