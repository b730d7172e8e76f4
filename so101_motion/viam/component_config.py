"""The attributes of every model but teleoperation, read into settings in SI units.

Each field has its attribute beside it; what it is for stands in ``docs/``. Those of teleoperation
are in ``tasks/teleop/config.py``, because the command line uses them too.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from so101_motion.calib.record import store
from so101_motion.calib.record.zero import CONVENTIONS
from so101_motion.common.attributes import (
    ACCELERATION_CAP,
    HEAVIEST,
    SERVO_VOLTAGES,
    SPEED_CAP,
    Attribute,
    Attributes,
    Config,
    LoadConfig,
    attribute,
    changed,
    checked_number,
    derived,
    part,
)
from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import ConfigError
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_deg, to_mm, to_rad
from so101_motion.drivers.bus.defaults import BAUDRATE, GRIPPER_ID, SERVO_IDS, TIMEOUT
from so101_motion.planning.collision.scene import Tool
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.rig.session_end import ENDS

CALIBRATION_FILE = "so101_calibration.json"
"""Where a calibration is saved by default; the published module's default."""

_RATES = (50.0, 200.0)  # setpoints a second; 200 leave the bus a third of its time; chosen
_NANOSECONDS = 1e5  # a bare number from here up is in nanoseconds, as the published module has it
_SECONDS = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "m": 60.0, "h": 3600.0}
_PART = re.compile(r"(\d+(?:\.\d*)?|\.\d+)(ns|us|µs|ms|s|m|h)")

MANUAL_RANGES = {
    "pos_deadband_deg": 45.0,
    "loop_hz": 200.0,
    "p_gain": 255.0,
    "torque_limit": 1000.0,
    "wall_torque_limit": 1000.0,
}
"""Keys of ``manual_mode`` and their largest values; the last is ours, the others are the published
module's. Ours follows the hand at the rate of the control loop, so ``loop_hz`` has no effect."""


# How values are read that need more than their row


def duration(key: str, value: object) -> float:
    """Read a duration [s]: text has units (``"1m30s"``), a number is in seconds.

    A huge number is in nanoseconds, because the published module took nothing else.
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
    """Read the settings of manual mode; ``otherwise`` is used for keys that are not given.

    0 counts as not given, as in the published module, but for ``wall_torque_limit``.
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


def _manual_mode(given: Attributes) -> Attributes:
    value = given.raw("manual_mode")
    if value is not None and not isinstance(value, Mapping):
        raise ConfigError("manual_mode", value, "must be an object")
    return Attributes(value or {}, MANUAL_RANGES, kind="key of manual_mode")


def _compliance(given: Attributes, key: str) -> Compliance:
    base = Compliance() if given.value("collision_guard") else Compliance(wall=0.0)
    return compliance(_manual_mode(given), base)


def _port(given: Attributes, key: str) -> str:
    port: str | None = given.value("port")
    if port is None:
        reason = "is missing; name the serial port, e.g. /dev/ttyACM0"
        raise ConfigError("port", given.raw("port"), reason)
    return port


def _timeout(given: Attributes, key: str) -> float:
    value = given.raw("timeout")
    is_none = value in (None, "", 0) and value is not False
    return TIMEOUT if is_none else duration("timeout", value)


def _short(given: Attributes, key: str) -> str | None:
    """The last part of a resource's name; None if it is not given."""
    name: str | None = given.value(key)
    return name and name.rpartition("/")[2]


def _capped(given: Attributes, key: str) -> float:
    """The arm's own cap; refuses one above what a request may ask for."""
    cap, most = float(given.value(key)), float(given.value(f"max_{key}"))
    if given.raw(key) and cap > most:
        reason = f"is above max_{key}, {to_deg(most):g}; lower it, or raise that"
        raise ConfigError(key, given.raw(key), reason)
    return min(cap, most)


def _zero_offsets(given: Attributes, key: str) -> Mapping[str, float] | None:
    zeros_deg = given.angles("joint_zero_offsets_deg", ARM_JOINTS)
    return {joint: to_rad(angle) for joint, angle in zeros_deg.items()} or None


def _servo_ids(given: Attributes, key: str) -> tuple[int, ...]:
    value = given.raw("servo_ids")
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


def _calibrated(given: Attributes, key: str) -> tuple[str, ...]:
    """The joints whose servos are listed; all if none is."""
    joints = (*ARM_JOINTS, GRIPPER_JOINT)
    value = given.raw("servo_ids")
    ids = [round(i) for i in given.numbers("servo_ids", count=253, lower=1.0, upper=6.0)]
    if ids and (len(set(ids)) != len(ids) or ids != value):
        raise ConfigError("servo_ids", value, "must list different whole numbers from 1 to 6")
    return tuple(joints[i - 1] for i in sorted(ids)) or joints


def _articulated(given: Attributes, key: str) -> bool:
    if given.value("articulated_jaw"):
        reason = "is not supported: a planner that may move the jaw drops what it holds; leave"
        raise ConfigError("articulated_jaw", True, f"{reason} it out, and use open and grab")
    return False


def _ports(given: Attributes, key: str) -> tuple[str, ...]:
    value = given.raw(key) if given.given(key) else ()
    if not isinstance(value, (list, tuple)):
        raise ConfigError(key, value, 'must be a list of serial ports, e.g. ["/dev/ttyAMA0"]')
    for name in value:
        if not isinstance(name, str) or not name:
            raise ConfigError(key, value, f"must hold names of serial ports, not {name!r}")
    return tuple(value)


def _tool(given: Attributes, key: str) -> Tool | None:
    from so101_motion.files.tool_file import find_tool  # with all that reads shapes

    return find_tool(given.raw(key)) if given.given(key) else None


def _gripper_arm(given: Attributes, key: str) -> str | None:
    arm: str | None = given.value("arm")
    if arm is None and not given.given("port"):
        raise ConfigError(
            "port", None, 'is missing; name the serial port, or the arm: "arm": "<its name>"'
        )
    return arm


def _load(given: Attributes, key: str) -> LoadConfig:
    com, voltage = given.value("payload_com_mm"), given.value("servo_voltage")
    if len(com) not in (0, 3):
        com_mm = [to_mm(each) for each in com]
        raise ConfigError("payload_com_mm", com_mm, "must be three numbers, x, y, z [mm]")
    if voltage not in SERVO_VOLTAGES:
        known = " or ".join(f"{each:g}" for each in SERVO_VOLTAGES)
        raise ConfigError("servo_voltage", voltage, f"must be {known}: the rating of the servos")
    return LoadConfig(mass=given.value("payload_kg"), com=com or None, servo_voltage=voltage)


# The settings


@dataclass(frozen=True, slots=True, kw_only=True)
class PortConfig(Config):
    """The settings of the serial port, which arm, gripper and sensor share."""

    port: str = attribute("port", kind="text", by=_port)
    calibration_file: str | None = attribute(
        "calibration_file", kind="text"
    )  # as given; None to read the servos' registers
    baudrate: int = attribute(
        "baudrate",
        kind="whole",
        unit="bit/s",
        range=(38400, 1000000),
        default=BAUDRATE,
        zero_is_none=True,
    )
    timeout: float = attribute("timeout", kind="own", by=_timeout)  # [s]
    rate: float | None = attribute("control_rate_hz", unit="Hz", range=_RATES, ours=True)

    def servo_settings(self) -> ServoSettings:
        file = self.calibration_file
        return ServoSettings(
            port=self.port,
            baudrate=self.baudrate,
            timeout=self.timeout,
            calibration_file=store.resolve(file) if file else None,
            rate=self.rate,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SensesConfig(Config):
    """The resources of the machine that report the arm's surroundings."""

    store: str | None = attribute("world_state_store", kind="text", ours=True, by=_short)
    camera: str | None = attribute("camera", kind="text", ours=True, by=_short)
    vision: str | None = attribute("vision", kind="text", ours=True, by=_short)

    def __post_init__(self) -> None:
        if self.vision and not self.camera:
            raise ConfigError("vision", self.vision, 'needs a camera; name it in "camera"')

    @property
    def resources(self) -> list[str]:
        """The full names of those that are configured; the machine may lack them."""
        named = {
            "rdk:service:world_state_store": self.store,
            "rdk:component:camera": self.camera,
            "rdk:service:vision": self.vision,
        }
        return [f"{api}/{name}" for api, name in named.items() if name]


@dataclass(frozen=True, slots=True, kw_only=True)
class ForAnArmConfig(Config):
    """Settings of a service for an arm."""

    arm: str | None = attribute("arm", kind="text", by=_short)


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionConfig(ForAnArmConfig):
    """Settings of ``devrel:so101:motion``."""

    senses: SensesConfig = part(SensesConfig)


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmConfig(Config):
    """The settings of every arm, real or simulated."""

    speed: float = derived(_capped, replace(SPEED_CAP, default=50.0, zero_is_none=True, ours=False))
    acceleration: float = derived(
        _capped, replace(ACCELERATION_CAP, default=100.0, zero_is_none=True, ours=False)
    )
    max_speed: float = derived(Attributes.value, replace(SPEED_CAP, name=f"max_{SPEED_CAP.name}"))
    max_acceleration: float = derived(
        Attributes.value, replace(ACCELERATION_CAP, name=f"max_{ACCELERATION_CAP.name}")
    )
    motion: str | None = attribute("motion", kind="text")
    tool: Tool | None = attribute("tool", kind="own", ours=True, by=_tool)
    floor_z: float = attribute(
        "floor_z_mm", unit="mm", range=(-2000.0, 500.0), default=-2.4, ours=True
    )
    obstacles: tuple[Mapping[str, object], ...] = attribute("obstacles", kind="objects", ours=True)
    ignored: tuple[str, ...] = attribute("ignore_components", kind="names", ours=True)
    senses: SensesConfig = part(SensesConfig)
    load: LoadConfig = derived(
        _load,
        Attribute("payload_kg", unit="kg", range=(0.0, HEAVIEST), default=0.0, ours=True),
        Attribute(
            "payload_com_mm", kind="numbers", unit="mm", range=(-1000.0, 1000.0), count=3, ours=True
        ),
        Attribute("servo_voltage", unit="V", range=(0.0, 100.0), default=7.4, ours=True),
    )
    position_tolerance: float | None = attribute(  # None for the planner's
        "position_tolerance_mm", unit="mm", range=(0.0, 1000.0), zero_is_none=True
    )
    approach_tolerance: float | None = attribute(
        "orientation_tolerance_deg", unit="deg", range=(0.0, 180.0), zero_is_none=True
    )
    use_urdf: bool = attribute("use_urdf", kind="flag", default=False)
    visualize_ee_frame: bool = attribute("visualize_ee_frame", kind="flag", default=False)
    guarded: bool = attribute("collision_guard", kind="flag", default=True, ours=True)
    unused: tuple[str, ...] = derived(lambda given, _: given.idle)  # given, and without effect here
    notes: tuple[str, ...] = derived(lambda given, _: given.notes)  # what replaces a given number

    CHECKED: ClassVar[tuple[Attribute, ...]] = (
        Attribute(
            "mesh_decimation_ratios",
            kind="numbers",
            range=(0.0, 1.0),
            idle="the meshes here are light as they are",
        ),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedArmConfig(ArmConfig):
    """Settings of ``devrel:so101:simulated``."""

    speed: float = changed(ArmConfig, "speed", default=90.0, takes_nearest=True)
    acceleration: float = changed(ArmConfig, "acceleration", ours=True)
    simulate_time: bool = attribute("simulate_time", kind="flag", default=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class HardwareArmConfig(ArmConfig):
    """Settings of ``devrel:so101:arm``."""

    connection: PortConfig = part(PortConfig)
    servo_ids: tuple[int, ...] = attribute("servo_ids", kind="own", by=_servo_ids)
    zero_offsets: Mapping[str, float] | None = attribute(
        "joint_zero_offsets_deg", kind="own", ours=True, by=_zero_offsets
    )
    joint_zero: str | None = attribute(  # None if it is not given
        "joint_zero",
        kind="choice",
        options=CONVENTIONS,
        ours=True,
        by=lambda given, key: given.value(key) if given.given(key) else None,
    )
    at_end: str = attribute("at_end", kind="choice", options=ENDS, ours=True)
    compliance: Compliance = attribute("manual_mode", kind="own", by=_compliance)
    unused: tuple[str, ...] = derived(
        lambda given, _: (
            *given.idle,
            *(("manual_mode.loop_hz",) if _manual_mode(given).given("loop_hz") else ()),
        )
    )

    CHECKED = (
        *ArmConfig.CHECKED,
        Attribute(
            "waypoint_lookahead_deg",
            unit="deg",
            range=(0.1, 45.0),
            idle="waypoints are on a planned path here, which is followed at every instant",
        ),
        Attribute(
            "disable_servo_gains",
            kind="flag",
            idle="the servos' gains are never changed; the driver reads them and reckons with them",
        ),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedGripperConfig(Config):
    """Settings of ``devrel:so101:simulated-gripper``."""

    arm: str | None = attribute("arm", kind="text", ours=True)  # None for one by itself
    gripper_type: str = attribute("gripper_type", kind="choice", options=("follower", "leader"))
    mesh_detail: str = attribute("mesh_detail", kind="choice", options=("low", "high"))


@dataclass(frozen=True, slots=True, kw_only=True)
class HardwareGripperConfig(SimulatedGripperConfig):
    """Settings of ``devrel:so101:gripper``."""

    connection: PortConfig | None = part(PortConfig, only_with="port")  # None for the arm's
    arm: str | None = attribute("arm", kind="text", by=_gripper_arm)
    servo_id: int = attribute(
        "servo_id", kind="whole", range=(1, 6), default=GRIPPER_ID, zero_is_none=True
    )
    articulated_jaw: bool = attribute(
        "articulated_jaw", kind="flag", default=False, by=_articulated
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationConfig(Config):
    """Settings of ``devrel:so101:calibration``."""

    connection: PortConfig = part(
        PortConfig, timeout={"idle": "a calibration waits for servos as long as it takes"}
    )  # a calibration is saved in its file
    joints: tuple[str, ...] = attribute("servo_ids", kind="own", by=_calibrated)  # base to jaw
    unused: tuple[str, ...] = derived(lambda given, _: given.idle)


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscoveryConfig(Config):
    """Settings of ``devrel:so101:discovery``; the published module has none."""

    ports: tuple[str, ...] = attribute("ports", kind="own", ours=True, by=_ports)
