"""Settings of the components that move real servos.

They are the published module's, those of its later versions included, so a machine's configuration
works as it is. Two things are read more kindly: a duration may be a number or text, and a gripper
may name its own port or the arm it belongs to.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from so101_motion.compliance import Compliance
from so101_motion.config import (
    ACCELERATION_RANGE_DEG,
    SPEED_RANGE_DEG,
    Attributes,
    LoadConfig,
    checked_number,
)
from so101_motion.errors import ConfigError
from so101_motion.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.units import to_m, to_rad

BAUDRATE = 1_000_000
"""Bits per second of the servos as new; the published module's default."""

TIMEOUT = 1.0
"""For how long servos that do not answer are asked at the start [s]; the published default."""

RATES = (50.0, 200.0)
"""Setpoints a second that can be asked for; 200 leave the bus a third of its time. Chosen."""

SERVO_IDS = (1, 2, 3, 4, 5)
"""The arm's servos, base to wrist."""

GRIPPER_ID = 6
"""The jaw's servo."""

CALIBRATION_FILE = "so101_calibration.json"
"""Where a calibration is saved when nobody says where; the published module's default."""

_SPEED_DEG, _ACCELERATION_DEG = 50.0, 100.0  # the seed's defaults
_NANOSECONDS = 1e5  # from here up a bare number was meant for the published module
_SECONDS = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "m": 60.0, "h": 3600.0}
_PART = re.compile(r"(\d+(?:\.\d*)?|\.\d+)(ns|us|µs|ms|s|m|h)")


@dataclass(frozen=True, slots=True, kw_only=True)
class PortConfig:
    """How to get at the servos.

    Attributes:
        port: The serial port, however spelled.
        baudrate: Bits per second.
        timeout: For how long servos that do not answer are asked at the start [s].
        calibration_file: Where the calibration is, as given; None to ask the servos.
        rate: How many setpoints a second the servos get; None for the usual 100.
    """

    port: str
    baudrate: int
    timeout: float
    calibration_file: str | None
    rate: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class HardwareArmConfig:
    """Settings of ``devrel:so101:arm``.

    Attributes:
        connection: How to get at the servos.
        servo_ids: Ids of the five servos, base to wrist.
        zero_offsets: The model's angles in the middle of the joints' recorded travels [rad], of the
            joints for which they are given; None when none is.
        speed: Joint speed cap [rad/s].
        acceleration: Joint acceleration cap [rad/s^2].
        motion: Name of a motion service that plans MoveToPosition; None when we plan it.
        visualize_ee_frame: Whether the tool frame is drawn.
        use_urdf: Whether kinematics are served as URDF instead of SVA.
        floor_z: Height of the floor in the base frame [m].
        obstacles: What always stands around the arm, as in a scene file.
        load: What it carries and can bear.
        position_tolerance: Largest position error that counts as arrived [m]; None for ours.
        approach_tolerance: Largest error of the approach direction [rad]; None for ours.
        compliance: How it yields to a hand in manual mode.
        lets_go: Whether its joints are let go of when the process ends in order.
        unused: Settings that were given, are understood, and have no effect here.
    """

    connection: PortConfig
    servo_ids: tuple[int, ...]
    zero_offsets: Mapping[str, float] | None
    speed: float
    acceleration: float
    motion: str | None
    visualize_ee_frame: bool
    use_urdf: bool
    floor_z: float
    obstacles: tuple[Mapping[str, object], ...]
    load: LoadConfig
    position_tolerance: float | None
    approach_tolerance: float | None
    compliance: Compliance
    lets_go: bool
    unused: tuple[str, ...]

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> HardwareArmConfig:
        """Read and check the attributes of a component configuration.

        Raises:
            ConfigError: A name is unknown or a value cannot be used.
        """
        given = Attributes(attributes, _ARM)
        motion = given.text("motion", "builtin")
        position_mm = given.number("position_tolerance_mm", 0.0, lower=0.0, upper=1000.0, unit="mm")
        approach_deg = given.number(
            "orientation_tolerance_deg", 0.0, lower=0.0, upper=180.0, unit="deg"
        )
        given.numbers("mesh_decimation_ratios", count=5, lower=0.0, upper=1.0)
        manual = _manual_mode(attributes.get("manual_mode"))
        return cls(
            connection=_connection(given, attributes),
            servo_ids=_servo_ids(given, attributes),
            zero_offsets=_zero_offsets(given, attributes),
            speed=to_rad(_rate(given, "speed_degs_per_sec", _SPEED_DEG, SPEED_RANGE_DEG, "deg/s")),
            acceleration=to_rad(
                _rate(
                    given,
                    "acceleration_degs_per_sec_per_sec",
                    _ACCELERATION_DEG,
                    ACCELERATION_RANGE_DEG,
                    "deg/s^2",
                )
            ),
            motion=None if motion == "builtin" else motion,
            visualize_ee_frame=given.flag("visualize_ee_frame", False),
            use_urdf=given.flag("use_urdf", False),
            floor_z=to_m(given.number("floor_z_mm", -2.4, lower=-2000.0, upper=500.0, unit="mm")),
            obstacles=given.objects("obstacles"),
            load=LoadConfig.of(given),
            position_tolerance=to_m(position_mm) if position_mm > 0.0 else None,
            approach_tolerance=to_rad(approach_deg) if approach_deg > 0.0 else None,
            compliance=compliance(manual),
            lets_go=given.choice("at_end", ("hold", "release")) == "release",
            unused=(
                *(["mesh_decimation_ratios"] if given.given("mesh_decimation_ratios") else []),
                *(["manual_mode.loop_hz"] if manual.given("loop_hz") else []),
            ),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class HardwareGripperConfig:
    """Settings of ``devrel:so101:gripper``.

    Attributes:
        connection: How to get at the servo; None when the arm says it.
        arm: Name of the arm it belongs to; None when it has a port of its own.
        servo_id: Id of the jaw's servo.
        gripper_type: ``"follower"`` (moving jaw) or ``"leader"`` (handle and trigger).
        mesh_detail: ``"low"`` (convex hulls) or ``"high"`` (what the parts look like).
    """

    connection: PortConfig | None
    arm: str | None
    servo_id: int
    gripper_type: str
    mesh_detail: str

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> HardwareGripperConfig:
        """Read and check the attributes of a component configuration.

        Raises:
            ConfigError: A name is unknown or a value cannot be used, or neither port nor arm is
                named.
        """
        given = Attributes(attributes, _GRIPPER)
        arm = given.text("arm", "") or None
        if arm is None and not given.given("port"):
            raise ConfigError(
                "port", None, 'is missing; name the serial port, or the arm: "arm": "<its name>"'
            )
        return cls(
            connection=_connection(given, attributes) if given.given("port") else None,
            arm=arm,
            servo_id=_whole(given, "servo_id", GRIPPER_ID, lower=1, upper=6),
            gripper_type=given.choice("gripper_type", ("follower", "leader")),
            mesh_detail=given.choice("mesh_detail", ("low", "high")),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationConfig:
    """Settings of ``devrel:so101:calibration``.

    Attributes:
        connection: How to get at the servos; ``calibration_file`` is where a calibration is saved,
            None to leave that to the arm on the port, or to ``CALIBRATION_FILE``.
        joints: The joints to calibrate, base to jaw.
        unused: Settings that were given, are understood, and have no effect here.
    """

    connection: PortConfig
    joints: tuple[str, ...]
    unused: tuple[str, ...]

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> CalibrationConfig:
        """Read and check the attributes of a component configuration.

        Raises:
            ConfigError: A name is unknown or a value cannot be used.
        """
        given = Attributes(attributes, (*_PORT, "servo_ids"))
        return cls(
            connection=_connection(given, attributes),
            joints=_calibrated(given, attributes),
            unused=("timeout",) if given.given("timeout") else (),
        )


_PORT = ("port", "calibration_file", "baudrate", "timeout", "control_rate_hz")
_ARM = (
    *_PORT,
    "servo_ids",
    "joint_zero_offsets_deg",
    "speed_degs_per_sec",
    "acceleration_degs_per_sec_per_sec",
    "motion",
    "visualize_ee_frame",
    "use_urdf",
    "floor_z_mm",
    "obstacles",
    "position_tolerance_mm",
    "orientation_tolerance_deg",
    "mesh_decimation_ratios",
    "manual_mode",
    "at_end",
    *LoadConfig.KEYS,
)
_GRIPPER = (*_PORT, "arm", "servo_id", "gripper_type", "mesh_detail")


def duration(key: str, value: object) -> float:
    """A time span [s] as people write it.

    Text has its units with it: ``"5s"``, ``"500ms"``, ``"1m30s"``. A number is seconds; a huge one
    is nanoseconds, because the published module took nothing else.

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
    """How an arm shall yield to a hand.

    Args:
        given: With any of the keys of ``MANUAL_RANGES``; 0 counts as not given, as in the published
            module.
        otherwise: What holds where nothing is given; the defaults if None.

    Raises:
        ConfigError: A value is outside its range.
    """
    asked = {
        key: given.number(key, 0.0, lower=0.0, upper=upper) for key, upper in MANUAL_RANGES.items()
    }
    base = otherwise or Compliance()
    return Compliance(
        dead_band=to_rad(asked["pos_deadband_deg"]) or base.dead_band,
        p_gain=asked["p_gain"] or base.p_gain,
        resistance=asked["torque_limit"] / 1000.0 or base.resistance,
    )


def _manual_mode(value: object) -> Attributes:
    if value is not None and not isinstance(value, Mapping):
        raise ConfigError("manual_mode", value, "must be an object")
    return Attributes(value or {}, MANUAL_RANGES, kind="key of manual_mode")


MANUAL_RANGES = {"pos_deadband_deg": 45.0, "loop_hz": 200.0, "p_gain": 255.0, "torque_limit": 1e3}
"""Keys of ``manual_mode`` and their largest values; the published module's. Ours follows the hand
at the rate of the control loop, so ``loop_hz`` has no effect."""


def _connection(given: Attributes, attributes: Mapping[str, object]) -> PortConfig:
    if not given.given("port"):
        raise ConfigError(
            "port", attributes.get("port"), "is missing; name the serial port, e.g. /dev/ttyACM0"
        )
    timeout = duration("timeout", attributes["timeout"]) if given.given("timeout") else TIMEOUT
    return PortConfig(
        port=given.text("port", ""),
        baudrate=_whole(given, "baudrate", BAUDRATE, lower=38_400, upper=1_000_000) or BAUDRATE,
        timeout=timeout,
        calibration_file=given.text("calibration_file", "") or None,
        rate=(
            given.number("control_rate_hz", 0.0, lower=RATES[0], upper=RATES[1], unit="Hz")
            if given.given("control_rate_hz")
            else None
        ),
    )


def _servo_ids(given: Attributes, attributes: Mapping[str, object]) -> tuple[int, ...]:
    if not given.given("servo_ids"):
        return SERVO_IDS
    value = attributes["servo_ids"]
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
    """The joints whose servos are listed; all when none is."""
    joints = (*ARM_JOINTS, GRIPPER_JOINT)
    value = attributes.get("servo_ids")
    ids = [round(i) for i in given.numbers("servo_ids", count=253, lower=1.0, upper=6.0)]
    if ids and (len(set(ids)) != len(ids) or ids != value):
        raise ConfigError("servo_ids", value, "must list different whole numbers from 1 to 6")
    return tuple(joints[i - 1] for i in sorted(ids)) or joints


def _zero_offsets(
    given: Attributes, attributes: Mapping[str, object]
) -> Mapping[str, float] | None:
    """The configured zeros by joint: from an object by joint, or a list of five, base to wrist."""
    key = "joint_zero_offsets_deg"
    if not given.given(key):
        return None
    value = attributes[key]
    if isinstance(value, Mapping):
        named = Attributes(value, ARM_JOINTS, kind=f"joint of {key}")
        offsets_deg = {
            joint: named.number(joint, 0.0, lower=-180.0, upper=180.0, unit="deg")
            for joint in ARM_JOINTS
            if named.given(joint)
        }
    else:
        listed = given.numbers(key, count=len(ARM_JOINTS), lower=-180.0, upper=180.0)
        if len(listed) != len(ARM_JOINTS):
            raise ConfigError(
                key, value, "must list five angles, base to wrist, or be an object by joint"
            )
        offsets_deg = dict(zip(ARM_JOINTS, listed, strict=True))
    return {joint: to_rad(angle_deg) for joint, angle_deg in offsets_deg.items()} or None


def _whole(given: Attributes, key: str, default: int, *, lower: int, upper: int) -> int:
    value = given.number(key, default, lower=lower, upper=upper)
    if value != round(value):
        raise ConfigError(key, value, f"must be a whole number from {lower} to {upper}")
    return round(value)


def _rate(
    given: Attributes, key: str, default: float, bounds: tuple[float, float], unit: str
) -> float:
    """A speed or acceleration; 0 counts as not given, as in the published module."""
    lower, upper = bounds
    value = given.number(key, default, lower=-float("inf"), upper=float("inf"), unit=unit)
    if value == 0.0:
        return default
    return given.number(key, default, lower=lower, upper=upper, unit=unit)
