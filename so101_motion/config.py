"""Settings as they arrive, JSON-like values under names, turned into types once.

A wrong setting is the most common first meeting with this package, so the errors are written by
hand: an unknown name is answered with the nearest known one, a wrong value with what was given and
what is allowed. Numbers arrive as floats, because that is how Viam carries them. An empty string
and a null count as not given, as they did for the published module.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from so101_motion.errors import ConfigError
from so101_motion.units import to_m, to_rad

SPEED_RANGE_DEG = (3.0, 180.0)
"""Joint speeds that can be set [deg/s]; the published module's range."""

ACCELERATION_RANGE_DEG = (10.0, 500.0)
"""Joint accelerations that can be set [deg/s^2]; the published module's range."""


SERVO_VOLTAGES = (7.4, 12.0)
"""Rated voltages of the servos the arm is sold with [V]. The weaker is meant when nobody says."""

HEAVIEST = 5.0
"""Largest payload that is taken for one [kg]; more was meant as grams."""


class Attributes:
    """Named values, read one at a time and checked on the way.

    Args:
        values: What was given.
        known: Every name that may occur.
        kind: What a name is called in messages.

    Raises:
        ConfigError: A name is not known.
    """

    def __init__(
        self, values: Mapping[str, object], known: Iterable[str], *, kind: str = "attribute"
    ) -> None:
        self._values = values
        names = tuple(known)
        for key, value in values.items():
            if key not in names:
                raise ConfigError(key, value, f"unknown {kind}; {suggest(key, names)}")

    def given(self, key: str) -> bool:
        """Whether there is a value under ``key``; null and the empty string are none."""
        return self._values.get(key) not in (None, "")

    def number(
        self, key: str, default: float, *, lower: float, upper: float, unit: str = ""
    ) -> float:
        """A finite number within bounds.

        Raises:
            ConfigError: It is no number, or outside.
        """
        if not self.given(key):
            return default
        return checked_number(key, self._values[key], lower=lower, upper=upper, unit=unit)

    def numbers(self, key: str, *, count: int, lower: float, upper: float) -> tuple[float, ...]:
        """A list of at most ``count`` finite numbers within bounds; empty when not given.

        Raises:
            ConfigError: It is no list, too long, or an entry is wrong.
        """
        if not self.given(key):
            return ()
        value = self._values[key]
        if not isinstance(value, (list, tuple)) or len(value) > count:
            raise ConfigError(key, value, f"must be a list of at most {count} numbers")
        return tuple(
            checked_number(f"{key}[{i}]", entry, lower=lower, upper=upper)
            for i, entry in enumerate(value)
        )

    def objects(self, key: str) -> tuple[Mapping[str, object], ...]:
        """A list of objects; empty when not given.

        Raises:
            ConfigError: It is something else.
        """
        value = self._values[key] if self.given(key) else ()
        if not isinstance(value, (list, tuple)) or not all(isinstance(e, Mapping) for e in value):
            raise ConfigError(key, value, 'must be a list of objects, [{"name": "mug", ...}]')
        return tuple(value)

    def flag(self, key: str, default: bool) -> bool:
        """True or false, and nothing that merely looks like it.

        Raises:
            ConfigError: It is something else.
        """
        if not self.given(key):
            return default
        value = self._values[key]
        if not isinstance(value, bool):
            raise ConfigError(key, value, "must be true or false")
        return value

    def text(self, key: str, default: str) -> str:
        """A string.

        Raises:
            ConfigError: It is something else.
        """
        if not self.given(key):
            return default
        value = self._values[key]
        if not isinstance(value, str):
            raise ConfigError(key, value, "must be a string")
        return value

    def choice(self, key: str, options: tuple[str, ...]) -> str:
        """One of ``options``; the first when not given.

        Raises:
            ConfigError: It is none of them.
        """
        value = self.text(key, options[0])
        if value not in options:
            raise ConfigError(key, value, suggest(value, options))
        return value


def checked_number(
    key: str, value: object, *, lower: float = -math.inf, upper: float = math.inf, unit: str = ""
) -> float:
    """``value`` as a float, if it is a finite number within bounds.

    Raises:
        ConfigError: It is not; the message holds the allowed range.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigError(key, value, f"must be a number{_range(lower, upper, unit)}")
    if not math.isfinite(value):
        raise ConfigError(key, value, f"must be a finite number{_range(lower, upper, unit)}")
    if not lower <= value <= upper:
        raise ConfigError(key, value, f"out of range; must be a number{_range(lower, upper, unit)}")
    return float(value)


def suggest(word: str, known: Iterable[str]) -> str:
    """Which known word was meant, if one is near, and all that could have been."""
    names = tuple(known)
    near = max(names, key=lambda name: _likeness(word, name), default="")
    hint = f'did you mean "{near}"? ' if near and _likeness(word, near) >= 0.6 else ""
    return hint + ("known: " + ", ".join(names) if names else "none is known here")


def _likeness(word: str, name: str) -> float:
    """How near two words are, 0 to 1; "speed" is near "speed_degs_per_sec" by its first part."""

    def ratio(other: str) -> float:
        return difflib.SequenceMatcher(None, word.lower(), other).ratio()

    return max(ratio(name.lower()), 0.8 * max(ratio(part) for part in name.lower().split("_")))


def _range(lower: float, upper: float, unit: str) -> str:
    behind = f" {unit}" if unit else ""
    if math.isinf(lower) and math.isinf(upper):
        return f" [{unit}]" if unit else ""
    if math.isinf(upper):
        return f" of at least {lower:g}{behind}"
    return f" from {lower:g} to {upper:g}{behind}"


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadConfig:
    """What an arm always carries, and what its servos are made for.

    Attributes:
        mass: Of what the gripper carries [kg].
        com: Its centre of mass in the tool frame, x, y, z [m]; None for the jaw's tip.
        servo_voltage: The servos' rated voltage, one of ``SERVO_VOLTAGES`` [V].
    """

    mass: float = 0.0
    com: tuple[float, float, float] | None = None
    servo_voltage: float = SERVO_VOLTAGES[0]

    KEYS: ClassVar = ("payload_kg", "payload_com_mm", "servo_voltage")

    @classmethod
    def of(cls, given: Attributes) -> LoadConfig:
        """Read and check the attributes named in ``KEYS``.

        Raises:
            ConfigError: A value cannot be used.
        """
        com_mm = given.numbers("payload_com_mm", count=3, lower=-1000.0, upper=1000.0)
        if len(com_mm) not in (0, 3):
            raise ConfigError("payload_com_mm", list(com_mm), "must be three numbers, x, y, z [mm]")
        voltage = given.number("servo_voltage", SERVO_VOLTAGES[0], lower=0.0, upper=100.0, unit="V")
        if voltage not in SERVO_VOLTAGES:
            known = " or ".join(f"{each:g}" for each in SERVO_VOLTAGES)
            raise ConfigError(
                "servo_voltage", voltage, f"must be {known}: the rating of the servos"
            )
        return cls(
            mass=given.number("payload_kg", 0.0, lower=0.0, upper=HEAVIEST, unit="kg"),
            com=(to_m(com_mm[0]), to_m(com_mm[1]), to_m(com_mm[2])) if com_mm else None,
            servo_voltage=voltage,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedArmConfig:
    """Settings of ``devrel:so101:simulated``.

    Attributes:
        speed: Joint speed cap [rad/s].
        acceleration: Joint acceleration cap [rad/s^2].
        motion: Name of a motion service that plans MoveToPosition; None when we plan it.
        simulate_time: Whether time passes by itself.
        visualize_ee_frame: Whether the tool frame is drawn.
        use_urdf: Whether kinematics are served as URDF instead of SVA.
        obstacles: What always stands around the arm, as in a scene file.
        floor_z: Height of the floor in the base frame [m].
        load: What it carries and can bear.
        position_tolerance: Largest position error that counts as arrived [m]; None for ours.
        approach_tolerance: Largest error of the approach direction [rad]; None for ours.
        mesh_ratios_given: Whether mesh decimation was asked for, which has no effect here.
    """

    speed: float
    acceleration: float
    motion: str | None
    simulate_time: bool
    visualize_ee_frame: bool
    use_urdf: bool
    floor_z: float
    obstacles: tuple[Mapping[str, object], ...]
    load: LoadConfig
    position_tolerance: float | None
    approach_tolerance: float | None
    mesh_ratios_given: bool

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> SimulatedArmConfig:
        """Read and check the attributes of a component configuration.

        Raises:
            ConfigError: A name is unknown or a value cannot be used.
        """
        given = Attributes(attributes, _SIMULATED_ARM)
        motion = given.text("motion", "builtin")
        position_mm = given.number("position_tolerance_mm", 0.0, lower=0.0, upper=1000.0, unit="mm")
        approach_deg = given.number(
            "orientation_tolerance_deg", 0.0, lower=0.0, upper=180.0, unit="deg"
        )
        ratios = given.numbers("mesh_decimation_ratios", count=5, lower=0.0, upper=1.0)
        return cls(
            speed=to_rad(_speed_deg(given)),
            acceleration=to_rad(_acceleration_deg(given)),
            motion=None if motion == "builtin" else motion,
            simulate_time=given.flag("simulate_time", True),
            visualize_ee_frame=given.flag("visualize_ee_frame", False),
            use_urdf=given.flag("use_urdf", False),
            floor_z=to_m(given.number("floor_z_mm", -2.4, lower=-2000.0, upper=500.0, unit="mm")),
            obstacles=given.objects("obstacles"),
            load=LoadConfig.of(given),
            position_tolerance=to_m(position_mm) if position_mm > 0.0 else None,
            approach_tolerance=to_rad(approach_deg) if approach_deg > 0.0 else None,
            mesh_ratios_given=bool(ratios),
        )


_SIMULATED_ARM = (
    "speed_degs_per_sec",
    "acceleration_degs_per_sec_per_sec",
    "motion",
    "simulate_time",
    "visualize_ee_frame",
    "use_urdf",
    "floor_z_mm",
    "obstacles",
    "position_tolerance_mm",
    "orientation_tolerance_deg",
    "mesh_decimation_ratios",
    *LoadConfig.KEYS,
)


def _speed_deg(given: Attributes) -> float:
    lower, upper = SPEED_RANGE_DEG
    return given.number("speed_degs_per_sec", 90.0, lower=lower, upper=upper, unit="deg/s")


def _acceleration_deg(given: Attributes) -> float:
    lower, upper = ACCELERATION_RANGE_DEG
    return given.number(
        "acceleration_degs_per_sec_per_sec", 100.0, lower=lower, upper=upper, unit="deg/s^2"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedGripperConfig:
    """Settings of ``devrel:so101:simulated-gripper``.

    Attributes:
        gripper_type: ``"follower"`` (moving jaw) or ``"leader"`` (handle and trigger).
        mesh_detail: ``"low"`` (convex hulls) or ``"high"`` (what the parts look like).
    """

    gripper_type: str
    mesh_detail: str

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, object]) -> SimulatedGripperConfig:
        """Read and check the attributes of a component configuration.

        Raises:
            ConfigError: A name is unknown or a value cannot be used.
        """
        given = Attributes(attributes, ("gripper_type", "mesh_detail"))
        return cls(
            gripper_type=given.choice("gripper_type", ("follower", "leader")),
            mesh_detail=given.choice("mesh_detail", ("low", "high")),
        )
