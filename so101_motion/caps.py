"""How fast an arm goes when a motion names no limits of its own."""

from __future__ import annotations

from dataclasses import dataclass

from so101_motion.config import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG, checked_number
from so101_motion.planning.limits import MotionLimits
from so101_motion.units import to_deg

JERK_TIME = 0.1
"""Time to build up full acceleration [s]: jerk cap = acceleration cap / this. Chosen: at the
default 100 deg/s^2 the arm starts and stops without a visible jolt, and a move costs 0.1 s more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Caps:
    """Caps that hold for every joint alike.

    Attributes:
        speed: [rad/s].
        acceleration: [rad/s^2].

    Raises:
        ConfigError: One is outside ``config.SPEED_RANGE_DEG``, ``config.ACCELERATION_RANGE_DEG``.
    """

    speed: float
    acceleration: float

    def __post_init__(self) -> None:
        _check("speed", self.speed, SPEED_RANGE_DEG, "deg/s")
        _check("acceleration", self.acceleration, ACCELERATION_RANGE_DEG, "deg/s^2")

    @property
    def limits(self) -> MotionLimits:
        """The same, with the jerk that goes with them."""
        return MotionLimits.uniform(
            velocity=self.speed,
            acceleration=self.acceleration,
            jerk=self.acceleration / JERK_TIME,
        )


def _check(name: str, value: float, bounds_deg: tuple[float, float], unit: str) -> None:
    lower, upper = bounds_deg
    value_deg = round(to_deg(value), 9)  # 180 deg came in as a float in radians
    checked_number(name, value_deg, lower=lower, upper=upper, unit=unit)
