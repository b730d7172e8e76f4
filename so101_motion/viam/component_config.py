"""Check the attributes of a component or service, and convert them into settings in SI units.

The published module's attributes, of all its versions, are accepted, so a machine's configuration
works as it is; ``attribute_table`` lists them. A duration may be a number or text, and a gripper
may have a port of its own or name the arm it belongs to.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from so101_motion.calib.record import store
from so101_motion.common.attributes import (
    SERVO_VOLTAGES,
    Attribute,
    Attributes,
    LoadConfig,
    checked_number,
)
from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import ConfigError
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_deg, to_mm, to_rad
from so101_motion.drivers.bus.defaults import SERVO_IDS, TIMEOUT
from so101_motion.rig.servo_driver import ServoSettings
from so101_motion.viam import attribute_table as table

_NANOSECONDS = 1e5  # a bare number from here up is in nanoseconds, as the published module has it
_SECONDS = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "m": 60.0, "h": 3600.0}
_PART = re.compile(r"(\d+(?:\.\d*)?|\.\d+)(ns|us|µs|ms|s|m|h)")


@dataclass(frozen=True, slots=True, kw_only=True)
class PortConfig:
    """The settings of the serial port."""

    port: str  # the serial port, however spelled
    baudrate: int  # [bit/s]
    timeout: float  # how long to keep asking silent servos at the start [s]
    calibration_file: str | None  # as given; None to read the servos' registers
    rate: float | None = None  # setpoints a second; None for the usual 100

    @classmethod
    def of(cls, given: Attributes, attributes: Mapping[str, object]) -> PortConfig:
        """Read the attributes that arm, gripper and sensor share.

        Raises:
            ConfigError: A value cannot be used, or there is no port.
        """
        port, timeout = given.value("port"), attributes.get("timeout")
        if port is None:
            given_port = attributes.get("port")
            raise ConfigError(
                "port", given_port, "is missing; name the serial port, e.g. /dev/ttyACM0"
            )
        is_none = timeout in (None, "", 0) and timeout is not False
        return cls(
            port=port,
            baudrate=given.value("baudrate"),
            timeout=TIMEOUT if is_none else duration("timeout", timeout),
            calibration_file=given.value("calibration_file"),
            rate=given.value("control_rate_hz"),
        )

    def servo_settings(self) -> ServoSettings:
        """The settings of the port for ``rig``."""
        file = self.calibration_file
        return ServoSettings(
            port=self.port,
            baudrate=self.baudrate,
            timeout=self.timeout,
            calibration_file=store.resolve(file) if file else None,
            rate=self.rate,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SensesConfig:
    """The resources of the machine that report the arm's surroundings."""

    store: str | None  # a world-state store
    camera: str | None
    vision: str | None  # a vision service that looks through the camera

    @classmethod
    def of(cls, given: Attributes) -> SensesConfig:
        """Read the attributes that arms and motion services share."""
        names = {key: _short(given.value(key)) for key in ("camera", "vision")}
        if names["vision"] and not names["camera"]:
            raise ConfigError("vision", names["vision"], 'needs a camera; name it in "camera"')
        return cls(store=_short(given.value("world_state_store")), **names)

    @property
    def resources(self) -> list[str]:
        """The full names of those that are configured; the machine may lack them."""
        named = {
            "rdk:service:world_state_store": self.store,
            "rdk:component:camera": self.camera,
            "rdk:service:vision": self.vision,
        }
        return [f"{api}/{name}" for api, name in named.items() if name]


def _short(name: str | None) -> str | None:
    return name and name.rpartition("/")[2]


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionConfig:
    """Settings of ``devrel:so101:motion``."""

    arm: str | None  # None for the only one
    senses: SensesConfig

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> MotionConfig:
        """Read and check the attributes; raises ``ConfigError`` for what cannot be used."""
        given = Attributes(attributes, table.MOTION)
        return cls(arm=_short(given.value("arm")), senses=SensesConfig.of(given))


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmConfig:
    """The settings of every arm, real or simulated."""

    speed: float  # cap of each joint [rad/s]
    acceleration: float  # cap of each joint [rad/s^2]
    max_speed: float  # no request may ask for more [rad/s]
    max_acceleration: float  # no request may ask for more [rad/s^2]
    motion: str | None  # the service that plans MoveToPosition; None for our planner
    visualize_ee_frame: bool
    guarded: bool  # whether what is not planned keeps clear of the arm and its surroundings
    use_urdf: bool
    floor_z: float  # [m]
    obstacles: tuple[Mapping[str, object], ...]  # as in a scene file
    load: LoadConfig
    position_tolerance: float | None  # [m]; None for the planner's
    approach_tolerance: float | None  # [rad]; None for the planner's
    ignored: tuple[str, ...]  # components of the machine that are not planned around
    senses: SensesConfig
    unused: tuple[str, ...]  # given, understood, and without effect here
    notes: tuple[str, ...]  # what is used instead of a given number

    TABLE: ClassVar[tuple[Attribute, ...]]

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> Self:
        """Read and check the attributes; raises ``ConfigError`` for what cannot be used."""
        given = Attributes(attributes, cls.TABLE)
        for each in cls.TABLE:
            if each.idle:
                given.value(each.name)  # only checked
        speed, max_speed = _cap(given, attributes, "speed_degs_per_sec")
        acceleration, max_acceleration = _cap(
            given, attributes, "acceleration_degs_per_sec_per_sec"
        )
        settings = {
            "speed": speed,
            "acceleration": acceleration,
            "max_speed": max_speed,
            "max_acceleration": max_acceleration,
            "load": _load(given),
            "floor_z": given.value("floor_z_mm"),
            "position_tolerance": given.value("position_tolerance_mm"),
            "approach_tolerance": given.value("orientation_tolerance_deg"),
            "guarded": given.value("collision_guard"),
            "ignored": given.value("ignore_components"),
            "senses": SensesConfig.of(given),
            "unused": given.idle,
            "notes": given.notes,
        }
        for key in ("motion", "visualize_ee_frame", "use_urdf", "obstacles"):
            settings[key] = given.value(key)
        return cls(**settings | cls._own(given, attributes))

    @classmethod
    def _own(cls, given: Attributes, attributes: Mapping[str, object]) -> dict[str, Any]:
        """The settings of only this kind of arm."""
        raise NotImplementedError


def _cap(given: Attributes, attributes: Mapping[str, object], key: str) -> tuple[float, float]:
    """The arm's own cap and the most a request may ask for; refuses a cap above that."""
    cap, most = given.value(key), given.value(f"max_{key}")
    if attributes.get(key) and cap > most:
        reason = f"is above max_{key}, {to_deg(most):g}; lower it, or raise that"
        raise ConfigError(key, attributes[key], reason)
    return min(cap, most), most


def _load(given: Attributes) -> LoadConfig:
    com, voltage = given.value("payload_com_mm"), given.value("servo_voltage")
    if len(com) not in (0, 3):
        com_mm = [to_mm(each) for each in com]
        raise ConfigError("payload_com_mm", com_mm, "must be three numbers, x, y, z [mm]")
    if voltage not in SERVO_VOLTAGES:
        known = " or ".join(f"{each:g}" for each in SERVO_VOLTAGES)
        raise ConfigError("servo_voltage", voltage, f"must be {known}: the rating of the servos")
    return LoadConfig(mass=given.value("payload_kg"), com=com or None, servo_voltage=voltage)


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedArmConfig(ArmConfig):
    """Settings of ``devrel:so101:simulated``."""

    simulate_time: bool  # whether simulated motions take time; if not, they end at once

    TABLE = table.SIMULATED_ARM

    @classmethod
    def _own(cls, given: Attributes, attributes: Mapping[str, object]) -> dict[str, Any]:
        return {"simulate_time": given.value("simulate_time")}


@dataclass(frozen=True, slots=True, kw_only=True)
class HardwareArmConfig(ArmConfig):
    """Settings of ``devrel:so101:arm``."""

    connection: PortConfig
    servo_ids: tuple[int, ...]  # base to wrist
    zero_offsets: Mapping[str, float] | None  # the model's angle mid-travel, by joint [rad]
    joint_zero: str | None  # "middle" or "homing", for joints whose zero is not known better
    compliance: Compliance  # how it yields to a hand in manual mode
    releases_at_end: bool  # whether its joints go limp when the process ends normally

    TABLE = table.ARM

    @classmethod
    def _own(cls, given: Attributes, attributes: Mapping[str, object]) -> dict[str, Any]:
        manual = _manual_mode(attributes.get("manual_mode"))
        zeros_deg = given.angles("joint_zero_offsets_deg", ARM_JOINTS)
        idle = ("manual_mode.loop_hz",) if manual.given("loop_hz") else ()
        return {
            "connection": PortConfig.of(given, attributes),
            "servo_ids": _servo_ids(given, attributes),
            "zero_offsets": {joint: to_rad(angle) for joint, angle in zeros_deg.items()} or None,
            "joint_zero": given.value("joint_zero") if given.given("joint_zero") else None,
            "compliance": compliance(
                manual, Compliance() if given.value("collision_guard") else Compliance(wall=0.0)
            ),
            "releases_at_end": given.value("at_end") == "release",
            "unused": (*given.idle, *idle),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedGripperConfig:
    """Settings of ``devrel:so101:simulated-gripper``."""

    gripper_type: str  # "follower" or "leader"
    mesh_detail: str  # "low" or "high"

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> SimulatedGripperConfig:
        """Read and check the attributes; raises ``ConfigError`` for what cannot be used."""
        given = Attributes(attributes, table.SIMULATED_GRIPPER)
        return cls(gripper_type=given.value("gripper_type"), mesh_detail=given.value("mesh_detail"))


@dataclass(frozen=True, slots=True, kw_only=True)
class HardwareGripperConfig(SimulatedGripperConfig):
    """Settings of ``devrel:so101:gripper``."""

    connection: PortConfig | None  # None for the arm's
    arm: str | None  # its name; None for a gripper with a port of its own
    servo_id: int

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> HardwareGripperConfig:
        """Read and check the attributes; raises ``ConfigError`` for what cannot be used."""
        given = Attributes(attributes, table.GRIPPER)
        arm = given.value("arm")
        if given.value("articulated_jaw"):
            reason = "is not supported: a planner that may move the jaw drops what it holds; leave"
            raise ConfigError("articulated_jaw", True, f"{reason} it out, and use open and grab")
        if arm is None and not given.given("port"):
            raise ConfigError(
                "port", None, 'is missing; name the serial port, or the arm: "arm": "<its name>"'
            )
        return cls(
            connection=PortConfig.of(given, attributes) if given.given("port") else None,
            arm=arm,
            servo_id=given.value("servo_id"),
            gripper_type=given.value("gripper_type"),
            mesh_detail=given.value("mesh_detail"),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationConfig:
    """Settings of ``devrel:so101:calibration``."""

    connection: PortConfig  # a calibration is saved in its file
    joints: tuple[str, ...]  # those to calibrate, base to jaw
    unused: tuple[str, ...]  # given, understood, and without effect here

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> CalibrationConfig:
        """Read and check the attributes; raises ``ConfigError`` for what cannot be used."""
        given = Attributes(attributes, table.CALIBRATION)
        return cls(
            connection=PortConfig.of(given, attributes),
            joints=_calibrated(given, attributes),
            unused=given.idle,
        )


def arm_served(attributes: Mapping[str, object]) -> str | None:
    """The arm that a service names; None for the only one.

    Raises:
        ConfigError: There are other attributes, or it is not a name.
    """
    return _short(Attributes(attributes, table.FOR_AN_ARM).value("arm"))


def duration(key: str, value: object) -> float:
    """Read a duration [s].

    Text has units: ``"5s"``, ``"500ms"``, ``"1m30s"``. A number is in seconds; a huge one is in
    nanoseconds, because the published module took nothing else.

    Raises:
        ConfigError: It is neither, or not positive.
    """
    if isinstance(value, str):
        parts = _PART.findall(value.strip())
        if not parts or "".join(number + unit for number, unit in parts) != value.strip():
            raise ConfigError(key, value, 'must be a duration such as "5s", "500ms" or 5 (seconds)')
        seconds = sum(float(number) * _SECONDS[unit] for number, unit in parts)
    else:
        seconds = checked_number(key, value, unit="s")
        seconds *= 1e-9 if seconds >= _NANOSECONDS else 1.0
    if not 0.0 < seconds <= 600.0:
        raise ConfigError(key, value, "must be more than 0 and at most 10 minutes")
    return seconds


def compliance(given: Attributes, otherwise: Compliance | None = None) -> Compliance:
    """Read the settings of manual mode.

    Args:
        given: With any of the keys of ``MANUAL_RANGES``; 0 counts as not given, as in the published
            module, but for ``wall_torque_limit``.
        otherwise: Used for keys that are not given; the defaults if None.

    Raises:
        ConfigError: A value is outside its range.
    """
    asked = {
        key: given.number(key, 0.0, lower=0.0, upper=upper) for key, upper in MANUAL_RANGES.items()
    }
    base = otherwise or Compliance()
    has_wall = given.given("wall_torque_limit")  # where 0 is for no wall
    return Compliance(
        dead_band=to_rad(asked["pos_deadband_deg"]) or base.dead_band,
        p_gain=asked["p_gain"] or base.p_gain,
        resistance=asked["torque_limit"] / 1000.0 or base.resistance,
        wall=asked["wall_torque_limit"] / 1000.0 if has_wall else base.wall,
    )


def _manual_mode(value: object) -> Attributes:
    if value is not None and not isinstance(value, Mapping):
        raise ConfigError("manual_mode", value, "must be an object")
    return Attributes(value or {}, MANUAL_RANGES, kind="key of manual_mode")


MANUAL_RANGES = {
    "pos_deadband_deg": 45.0,
    "loop_hz": 200.0,
    "p_gain": 255.0,
    "torque_limit": 1000.0,
    "wall_torque_limit": 1000.0,
}
"""Keys of ``manual_mode`` and their largest values; the last is ours, the others are the published
module's. Ours follows the hand at the rate of the control loop, so ``loop_hz`` has no effect."""


def _servo_ids(given: Attributes, attributes: Mapping[str, object]) -> tuple[int, ...]:
    value = attributes.get("servo_ids")
    if value in (None, "", []):
        return SERVO_IDS
    ids = tuple(round(i) for i in given.numbers("servo_ids", count=253, lower=1.0, upper=5.0))
    if len(ids) != len(SERVO_IDS) or len(set(ids)) != len(ids) or list(ids) != value:
        raise ConfigError(
            "servo_ids",
            value,
            "must list five different whole numbers, the servos from base to wrist;"
            f" usually {list(SERVO_IDS)}",
        )
    return ids


def _calibrated(given: Attributes, attributes: Mapping[str, object]) -> tuple[str, ...]:
    """The joints whose servos are listed; all if none is."""
    joints = (*ARM_JOINTS, GRIPPER_JOINT)
    value = attributes.get("servo_ids")
    ids = [round(i) for i in given.numbers("servo_ids", count=253, lower=1.0, upper=6.0)]
    if ids and (len(set(ids)) != len(ids) or ids != value):
        raise ConfigError("servo_ids", value, "must list different whole numbers from 1 to 6")
    return tuple(joints[i - 1] for i in sorted(ids)) or joints
