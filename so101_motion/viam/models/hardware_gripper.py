"""``devrel:so101:gripper``: the real gripper, the sixth servo of the arm."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, ClassVar

from grpclib import GRPCError, Status
from viam.components.gripper import Gripper
from viam.resource.types import Model

from so101_motion.common.attributes import Attributes
from so101_motion.common.errors import ConfigError, ServoAlarm, So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.common.units import to_rad
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.hardware_rig import HardwareRig, open_without_waiting
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.rig.shared_port import HARDWARE_JAW_LIMITS
from so101_motion.viam.component_config import HardwareGripperConfig
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.convert import grpc_statuses
from so101_motion.viam.models.configured import Dependencies
from so101_motion.viam.models.gripper_resource import GripperResource, clamped
from so101_motion.viam.models.hardware_arm import HardwareArm
from so101_motion.viam.requests.await_motion import log_failure_of, wait_for_arrival
from so101_motion.viam.requests.commands import Taking, in_deg
from so101_motion.viam.requests.servo_commands import controller, health, out_of_fault, ready

OPEN_PERCENT = 95.0  # where ``open`` moves the jaw; the published module's figure
CLOSED_PERCENT = 0.0  # where ``grab`` moves the jaw if it meets nothing
FASTEST_DEG = 120.0  # the jaw's largest speed [deg/s]; half of its drive reaches it with a reserve

_SILENT = "its servo does not answer; check its cable and the arm's power supply"


class HardwareGripper(GripperResource):
    """The SO-101 gripper."""

    MODEL: ClassVar = Model.from_string("devrel:so101:gripper")
    CONFIG = HardwareGripperConfig
    NEEDS_NO_SERVO = frozenset(
        {
            "controller_status", "calibrate_positions", "set_motion_params", "get_motion_params",
            "health",
        }
    )  # fmt: skip

    rig: HardwareRig

    def __init__(self, name: str, rig: HardwareRig, config: HardwareGripperConfig) -> None:
        super().__init__(name, rig, config)
        self._servo_id = config.servo_id
        self._open_percent, self._closed_percent = OPEN_PERCENT, CLOSED_PERCENT
        self._is_closed = False
        self._commands |= {
            "get_position": self._get_position,
            "get_load": self._get_load,
            "set_position": Taking(
                self._set_position, ("servo_position", "percentage", "position_percentage", "wait")
            ),
            "controller_status": self._controller_status,
            "calibrate_positions": Taking(
                self._calibrate_positions, ("open_position", "closed_position")
            ),
            "set_motion_params": Taking(self._set_motion_params, ("speed", "acceleration")),
            "get_motion_params": self._get_motion_params,
            "health": self._health,
        }

    @classmethod
    def build(
        cls, name: str, wanted: HardwareGripperConfig, dependencies: Dependencies
    ) -> HardwareGripper:
        rig = open_without_waiting(_settings(wanted).with_gripper(wanted.servo_id))
        gripper = cls(name, rig, wanted)
        own = wanted.connection
        if wanted.arm and own and not rig.is_on(own.port):
            words = "port %s is not the port of arm %s; the arm's port is used"
            gripper.logger.warning(words, own.port, wanted.arm)
        return gripper

    # Moving

    async def is_holding_something(self, **kwargs: Any) -> Gripper.HoldingStatus:
        await self.found()
        load = health(self.rig.servos).get(GRIPPER_JOINT, {})
        meta = {key: load[key] for key in ("load_percent", "amps") if key in load}
        return Gripper.HoldingStatus(
            is_holding_something=self._gripper.is_holding,
            meta={**meta, "position_percentage": self._percentage()},
        )

    async def _prepare(self, percentage: float, *, closes: bool) -> None:
        await out_of_fault(self.rig)
        if not closes:
            await self._unload()

    async def _unload(self) -> None:
        """Clear an overload of the jaw's servo, so that it can open.

        The servo clears the alarm when its goal is where it stands. The motion to there ends with
        the alarm.
        """
        if "overload" not in self._own_health().get("faults", ()):
            return
        with suppress(ServoAlarm):
            here = min(max(self._gripper.aperture, 0.0), 1.0)
            await wait_for_arrival(self._watched(self._gripper.move(here, wait=False)))
        for _ in range(10):
            if GRIPPER_JOINT not in self.rig.arm.state.reading.alarms:
                return
            await asyncio.sleep(0.05)

    async def found(self) -> None:
        with grpc_statuses():
            await ready(self.rig)

    # Requests

    async def _get_position(self) -> dict[str, Any]:
        return {
            **self._position(),
            "open_position": self._open_percent,
            "closed_position": self._closed_percent,
            **self._condition(),
        }

    async def _get_load(self) -> dict[str, Any]:
        """The servo's own figure in thousandths of full drive; its sign is the direction."""
        percent = self._own_health().get("load_percent", 0.0)
        return {"load": round(10.0 * percent), **self._condition()}

    def _condition(self) -> dict[str, str]:
        """The faults that the servo reports, in words, or that it is silent; empty without any."""
        if self._is_silent:
            return {"condition": _SILENT}
        faults = self._own_health().get("faults", ())
        return {"condition": ", ".join(faults)} if faults else {}

    async def _set_position(self, given: Attributes) -> dict[str, Any]:
        if given.given("servo_position"):
            ticks = given.required("servo_position", unit="ticks")
            jaw = self._gripper
            q = self.rig.servos.to_angle(GRIPPER_JOINT, round(min(max(ticks, 0.0), 4095.0)))
            percentage = 100.0 * (q - jaw.closed) / (jaw.opened - jaw.closed)
            log_failure_of(await self._start(clamped(percentage)), self.logger)
            return {"success": True}
        for key in ("percentage", "position_percentage"):
            if given.given(key):
                await self._go(given.required(key, unit="%"), given)
                return {"success": True}
        raise ConfigError(
            "servo_position",
            None,
            'is missing; send "servo_position" in ticks, or "percentage" from 0 (closed) to 100',
        )

    async def _controller_status(self) -> dict[str, Any]:
        return {"servo_id": self._servo_id, **controller(self.rig)}

    async def _calibrate_positions(self, given: Attributes) -> dict[str, Any]:
        opened = given.number("open_position", self._open_percent, lower=0.0, upper=100.0)
        closed = given.number("closed_position", self._closed_percent, lower=0.0, upper=100.0)
        if closed >= opened:
            raise ConfigError("closed_position", closed, f"must be below open_position, {opened:g}")
        self._open_percent, self._closed_percent = opened, closed
        return {"success": True, "open_position": opened, "closed_position": closed}

    async def _set_motion_params(self, given: Attributes) -> dict[str, Any]:
        now = await self._get_motion_params()
        speed = given.number("speed", now["speed"], lower=1.0, upper=180.0, unit="deg/s")
        top = float(HARDWARE_JAW_LIMITS.acceleration[0])
        acceleration = given.number(
            "acceleration", now["acceleration"], lower=1.0, upper=in_deg(top), unit="deg/s^2"
        )
        self._gripper.limits = MotionLimits.uniform(
            velocity=to_rad(min(speed, FASTEST_DEG)),
            acceleration=min(to_rad(acceleration), top),
            jerk=float(HARDWARE_JAW_LIMITS.jerk[0]),
            n=1,
        )
        return {"success": True, **await self._get_motion_params()}

    async def _get_motion_params(self) -> dict[str, Any]:
        limits = self._gripper.limits
        return {
            "speed": in_deg(float(limits.velocity[0])),
            "acceleration": in_deg(float(limits.acceleration[0])),
        }

    async def _health(self) -> dict[str, Any]:
        return {"connected": self.rig.servos.is_connected, **self._own_health()}

    # State

    async def get_status(self, **kwargs: Any) -> Mapping[str, Any]:
        state, not_ready = self.rig.arm.state, self.rig.not_ready
        is_silent = not not_ready and self._is_silent
        status = {
            **({} if not_ready else self._position()),
            "not_ready": not_ready,
            "is_moving": await self.is_moving(),
            "state": Mode.FAULT.value if is_silent else state.mode.value,
            "fault": state.fault or (_SILENT if is_silent else None),
            "health": self._own_health(),
        }
        return convert.to_result(status)

    def _own_health(self) -> dict[str, Any]:
        figures: dict[str, Any] = health(self.rig.servos).get(GRIPPER_JOINT, {})
        return figures

    @property
    def _is_silent(self) -> bool:
        return self._gripper.is_silent or not self.rig.servos.is_connected

    def _percentage(self) -> float:
        if self._is_silent:
            raise GRPCError(Status.UNAVAILABLE, _SILENT)
        return super()._percentage()

    def _position(self) -> dict[str, Any]:
        if self._is_silent:
            return {}
        q_jaw = self._gripper.q_jaw
        return {
            "position_percentage": self._percentage(),
            "position_radians": q_jaw,
            "servo_position": self.rig.servos.to_ticks(GRIPPER_JOINT, q_jaw),
            "is_holding_something": self._gripper.is_holding,
        }

    async def close(self) -> None:
        if not self._is_closed:
            self._is_closed = True
            try:
                await self._stop()
            except So101Error as error:
                self.logger.warning("the jaw could not be stopped properly: %s", error)
        await super().close()


def _settings(wanted: HardwareGripperConfig) -> ServoSettings:
    """The settings of the port that the gripper names, or the port of its arm.

    Of the arm's settings only port and baudrate are taken: the others stay the arm's own, which may
    come back with different ones while the gripper stays.
    """
    if wanted.arm is None:
        assert wanted.connection is not None  # the configuration has one of the two
        return wanted.connection.servo_settings()
    arm = HardwareArm.here.get(wanted.arm.rpartition("/")[2])
    if not isinstance(arm, HardwareArm):
        real = (name for name, arm in HardwareArm.here.items() if isinstance(arm, HardwareArm))
        known = ", ".join(real) or "none so far"
        raise ConfigError(
            "arm", wanted.arm, f"is not a {HardwareArm.MODEL} of this module; there are: {known}"
        )
    now = arm.rig.settings
    return ServoSettings(port=now.port, baudrate=now.baudrate, timeout=None, goes_with_arm=True)
