"""Answer the commands of the calibration sensor, with the published module's keys.

Each command runs in a thread, because it waits for the bus, and is finished even if the client goes
away. ``docs/calibration.md`` lists the keys that the published module does not have.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from typing import Any

from so101_motion.calib.motors.setup_view import MotorCheck, ScannedServo
from so101_motion.calib.procedure import steps
from so101_motion.calib.procedure.view import JointView
from so101_motion.common.attributes import Attributes, suggest
from so101_motion.common.errors import CalibrationError, ConfigError, So101Error
from so101_motion.common.units import to_deg
from so101_motion.setup import setup_steps
from so101_motion.setup.calibrator import Calibrator, StepResult
from so101_motion.setup.situation_json import about_servo
from so101_motion.viam.requests.await_motion import run_to_end
from so101_motion.viam.requests.commands import Command, Taking


class CalibrationCommands:
    """Answers the commands of the calibration sensor.

    Args:
        calibrator: Carries them out.

    Attributes:
        commands: The method for each ``command``.
        last_save_error: Why the last ``save_calibration`` failed; empty if it did not.
    """

    def __init__(self, calibrator: Calibrator) -> None:
        self.last_save_error = ""
        self._calibrator, self._setup = calibrator, calibrator.motor_setup
        self.commands: Mapping[str, Command] = {
            "start": partial(self._step, steps.Command.START),
            "set_homing": self._set_homing,
            "start_range_recording": partial(self._step, steps.Command.START_RECORDING),
            "stop_range_recording": Taking(self._stop_recording, ("accept",)),
            "save_calibration": self._save,
            "abort": self._abort,
            "reset": self._reset,
            "restore_calibration": Taking(self._restore, ("number",)),
            "get_current_positions": self._get_positions,
            "motor_setup_discover": Taking(self._discover, ("motor_name",)),
            "motor_setup_assign_id": Taking(
                self._assign, ("motor_name", "current_id", "target_id", "current_baudrate")
            ),
            "motor_setup_skip": Taking(self._skip, ("motor_name",)),
            "motor_setup_forget": Taking(self._forget, ("motor_name",)),
            "motor_setup_verify": self._verify,
            "motor_setup_repair": self._repair,
            "motor_setup_scan_bus": self._scan,
            "motor_setup_reset_status": self._reset_status,
            "setup_steps": Taking(self._list_steps, ("workflow",)),
        }

    # The workflow

    async def _step(self, step: steps.Command) -> dict[str, Any]:
        """Carry out a step that leads to the next one."""
        await self._carry_out(step)
        return self._next()

    async def _set_homing(self) -> dict[str, Any]:
        await self._carry_out(steps.Command.SET_HOMING)
        joints = self._calibrator.situation.view.joints
        offsets = {str(joint.servo_id): joint.homing_offset for joint in joints.values()}
        return {**self._next(), "homing_offsets": offsets}

    async def _stop_recording(self, given: Attributes) -> dict[str, Any]:
        await self._carry_out(steps.Command.STOP_RECORDING, accept=given.names("accept"))
        view = self._calibrator.situation.view
        return {
            **self._next(),
            "recording_duration": round(view.recording_time, 3),
            "samples_collected": view.samples,
            "ranges": ranges(view.joints),
        }

    async def _save(self) -> dict[str, Any]:
        try:
            done = await self._carry_out(steps.Command.SAVE)
        except So101Error as error:
            self.last_save_error = str(error)
            raise
        self.last_save_error = ""
        stored = done.stored
        assert stored is not None
        said = (
            f"The calibration is saved in {stored.path} and stored in the servos.",
            *(f"{note}." for note in stored.notes),
        )
        return {
            **self._over(done, " ".join(said)),
            "calibration_file": str(stored.path),
            "joints_calibrated": len(self._calibrator.situation.joints),
        }

    async def _abort(self) -> dict[str, Any]:
        done = await self._carry_out(steps.Command.ABORT)
        return self._over(done, "The calibration was aborted; everything is as it was before.")

    async def _reset(self) -> dict[str, Any]:
        done = await self._carry_out(steps.Command.RESET)
        return self._over(done, "Ready to start anew; everything is as it was before.")

    async def _restore(self, given: Attributes) -> dict[str, Any]:
        number = _whole(given, "number", 9999)
        ended = await run_to_end(lambda: self._calibrator.restore(number))
        stored = ended.stored
        assert stored is not None
        return {
            **self._over(
                ended, f"{stored.path} and the servos have the earlier calibration again."
            ),
            "calibration_file": str(stored.path),
        }

    async def _get_positions(self) -> dict[str, Any]:
        now = self._calibrator.situation
        found = {joint: view for joint, view in now.joints.items() if view.ticks is not None}
        if not found:
            raise CalibrationError(
                None,
                "no servo answers" if now.is_connected else "the port is not connected",
                "check the arm's power supply and its cables",
            )
        return {
            "success": True,
            "positions": {
                joint: {
                    "servo_id": view.servo_id,
                    "raw_position": view.ticks,
                    "radians": now.angles[joint],
                    "degrees": to_deg(now.angles[joint]),
                }
                for joint, view in found.items()
            },
            "silent": [joint for joint in now.joints if joint not in found],
        }

    async def _carry_out(self, step: steps.Command, *, accept: Collection[str] = ()) -> StepResult:
        return await run_to_end(partial(self._calibrator.step, step, accept=accept))

    def _next(self) -> dict[str, Any]:
        view = self._calibrator.situation.view
        message = view.instruction if view.note is None else f"{view.note} {view.instruction}"
        return {"success": True, "state": view.state.value, "message": message}

    def _over(self, ended: StepResult, message: str) -> dict[str, Any]:
        state = self._calibrator.situation.view.state
        joints = "The joints are held." if ended.holds else "The joints are limp."
        return {
            "success": True,
            "state": state.value,
            "message": f"{message} {joints if ended.trouble is None else f'But {ended.trouble}'}",
            "torque_enabled": ended.holds,
        }

    # The motor setup

    async def _discover(self, given: Attributes) -> dict[str, Any]:
        joint = _motor_name(given)
        found = await run_to_end(lambda: self._setup.discover(joint))
        return {
            "success": True,
            "motor_name": joint,
            "target_id": found.target_id,
            **about_servo(found),
            "status": found.sentence,
            "fix": found.fix or None,
            "next_step": self._setup.view.next_step,
        }

    async def _assign(self, given: Attributes) -> dict[str, Any]:
        joint = _motor_name(given)
        current, target = _whole(given, "current_id", 253), _whole(given, "target_id", 253)
        baud = _whole(given, "current_baudrate", 10_000_000)
        done = await run_to_end(
            lambda: self._setup.assign(
                joint, current_id=current, target_id=target, current_baud=baud
            )
        )
        return {
            "success": True,
            "motor_name": joint,
            "old_id": done.old_id,
            "new_id": done.new_id,
            "old_baudrate": done.old_baud,
            "new_baudrate": done.new_baud,
            "changed": list(done.changed),
            "status": done.sentence,
            "next_step": self._setup.view.next_step,
        }

    async def _skip(self, given: Attributes) -> dict[str, Any]:
        joint = _motor_name(given)
        skipped = await run_to_end(lambda: self._setup.skip(joint))
        return {
            "success": True,
            "motor_name": joint,
            "status": skipped.sentence,
            "next_step": self._setup.view.next_step,
        }

    async def _forget(self, given: Attributes) -> dict[str, Any]:
        joint = _motor_name(given)
        await run_to_end(lambda: self._setup.forget(joint))
        return {"success": True, "motor_name": joint, "next_step": self._setup.view.next_step}

    async def _verify(self) -> dict[str, Any]:
        found = await run_to_end(self._setup.verify)
        error = {} if found.ok else {"error": found.sentence}  # the published setup page shows it
        return {
            "success": found.ok,
            **error,
            "all_ok": found.ok,
            "motors": {joint: _checked(check) for joint, check in found.motors.items()},
            "unexpected_ids": list(found.unexpected_ids),
            "notes": list(found.notes),
            "status": found.sentence,
            "next_step": self._setup.view.next_step,
        }

    async def _repair(self) -> dict[str, Any]:
        done = await run_to_end(self._setup.repair)
        return {"success": True, "changed": list(done), "next_step": self._setup.view.next_step}

    async def _scan(self) -> dict[str, Any]:
        found = await run_to_end(self._setup.scan)
        return {
            "success": True,
            "servos_found": len(found.servos),
            "unexpected_count": found.unexpected_count,
            "servos": [_scanned(servo) for servo in found.servos],
            "status": found.sentence,
        }

    async def _reset_status(self) -> dict[str, Any]:
        await run_to_end(self._setup.reset)
        return {"success": True, "status": self._setup.view.status}

    # All steps of a workflow

    async def _list_steps(self, given: Attributes) -> dict[str, Any]:
        name = given.text("workflow", setup_steps.FULL.name)
        wanted = next((each for each in setup_steps.WORKFLOWS if each.name == name), None)
        if wanted is None:
            names = [each.name for each in setup_steps.WORKFLOWS]
            raise ConfigError("workflow", name, suggest(name, names))
        known = setup_steps.SetupState.of(self._calibrator)
        left = wanted.next_open(known)
        return {
            "success": True,
            "workflow": wanted.name,
            "title": wanted.title,
            "minutes": wanted.minutes,
            "steps": [_about_step(step, known) for step in wanted.steps],
            "next_step": None if left is None else left.name,
        }


# Values of requests


def _motor_name(given: Attributes) -> str:
    if not given.given("motor_name"):
        raise ConfigError("motor_name", None, 'is missing; name the motor, such as "gripper"')
    return given.text("motor_name", "")


def _whole(given: Attributes, key: str, upper: int) -> int | None:
    if not given.given(key):
        return None
    value = given.number(key, 0.0, lower=0.0, upper=upper)
    if value % 1.0:
        raise ConfigError(key, value, f"must be a whole number from 0 to {upper}")
    return round(value)


# Parts of answers


def ranges(joints: Mapping[str, JointView]) -> dict[str, Any]:
    """The recorded travels [tick]."""
    return {
        joint: {"min": view.recorded_min, "max": view.recorded_max, "range": view.travel}
        for joint, view in joints.items()
        if view.recorded_min is not None
    }


def _about_step(step: setup_steps.SetupStep, known: setup_steps.SetupState) -> dict[str, Any]:
    check = step.check(known)
    return {
        "name": step.name,
        "title": step.title,
        "instruction": step.instruction,
        "minutes": step.minutes,
        "verdict": check.verdict,
        "message": check.sentence,
        "fix": check.fix or None,
    }


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


def _scanned(servo: ScannedServo) -> dict[str, Any]:
    return {
        "id": servo.servo_id,
        "model": servo.model or "unknown",
        "status": "unexpected" if servo.expected_joint is None else "expected",
        "expected_name": servo.expected_joint,
        "baudrate": servo.baud,
    }
