"""The caps on speed and acceleration of an arm's joints, and the range of their angles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from numbers import Real
from typing import NamedTuple

import numpy as np

from so101_motion.common.attributes import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG, checked_kind
from so101_motion.common.errors import ConfigError, OutsideLimits
from so101_motion.common.geometry import Array, frozen_array, in_radians
from so101_motion.common.public import Complete
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import range_deg, to_deg, to_rad
from so101_motion.planning.timing.limits import MotionLimits, checked_limits
from so101_motion.planning.timing.torque import Drive

JERK_TIME = 0.1
"""Time to build up full acceleration [s]: jerk cap = acceleration cap / this. Chosen: at the
default 100 deg/s^2 the arm starts and stops without a visible jolt, and a move costs 0.1 s more."""

TOLERANCE = to_rad(0.2)
"""How far beyond its range a joint may be sent [rad]: two ticks, because a joint at its stop is
measured now on one side of it, now on the other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointCaps:
    """Caps on speed [rad/s] and acceleration [rad/s^2], the same for all joints.

    Raises:
        ConfigError: One is outside ``SPEED_RANGE_DEG`` or ``ACCELERATION_RANGE_DEG``.
    """

    speed: float
    acceleration: float

    def __post_init__(self) -> None:
        _check("speed", self.speed, SPEED_RANGE_DEG, "deg/s")
        _check("acceleration", self.acceleration, ACCELERATION_RANGE_DEG, "deg/s^2")

    def checked(self, wanted: JointCaps) -> JointCaps:
        """``wanted``; ``ConfigError``, which names the setting, if it is above these caps."""
        for name, setting, unit in (
            ("speed", "max_speed_degs_per_sec", "deg/s"),
            ("acceleration", "max_acceleration_degs_per_sec_per_sec", "deg/s^2"),
        ):
            value, most = (round(to_deg(getattr(each, name)), 9) for each in (wanted, self))
            if value > most:
                reason = f"is above this arm's {setting}, {most:g} {unit}; ask for less"
                raise ConfigError(name, f"{value:g} {unit}", reason)
        return wanted

    @property
    def limits(self) -> MotionLimits:
        """The caps as motion limits, with the jerk that belongs to them."""
        return MotionLimits.uniform(
            velocity=self.speed,
            acceleration=self.acceleration,
            jerk=self.acceleration / JERK_TIME,
        )


FOLLOWING_ACCELERATION = 0.92
"""Share of the servos' acceleration that joints use while they follow targets. Chosen by trial: it
is not known beforehand when they must brake, so servos begin late and then have to brake harder."""


class CappedJoints(Complete):
    """The caps of one arm: its own, and the ceiling that no motion may exceed.

    Attributes:
        slowdown: Called before each motion; returns the share of its caps that it may use, 0 to 1.
        drive: Called before each plan; returns what the servos can do then, None if not known.
        servo_acceleration: What each servo itself keeps up with, shape (5,), [rad/s^2].
    """

    def __init__(self, caps: JointCaps) -> None:
        self._caps = caps
        self._ceiling = JointCaps(
            speed=to_rad(SPEED_RANGE_DEG[1]), acceleration=to_rad(ACCELERATION_RANGE_DEG[1])
        )
        self.slowdown: Callable[[], float] = lambda: 1.0
        self.drive: Callable[[], Drive | None] = lambda: None
        self.servo_acceleration: Array = np.full(len(ARM_JOINTS), np.inf)

    @property
    def speed(self) -> float:
        """Joint speed cap [rad/s]."""
        return self._caps.speed

    @property
    def acceleration(self) -> float:
        """Joint acceleration cap [rad/s^2]."""
        return self._caps.acceleration

    def set_speed(self, speed: float) -> None:
        """Set the joint speed cap [rad/s]; ``ConfigError`` above ``ceiling`` or out of range."""
        self._caps = self._ceiling.checked(replace(self._caps, speed=speed))

    def set_acceleration(self, acceleration: float) -> None:
        """Set the joint acceleration cap [rad/s^2]; raises as ``set_speed`` does."""
        self._caps = self._ceiling.checked(replace(self._caps, acceleration=acceleration))

    @property
    def ceiling(self) -> JointCaps:
        """The caps that no motion may exceed; braking may."""
        return self._ceiling

    def set_ceiling(self, ceiling: JointCaps) -> None:
        """Set the caps that no motion may exceed; lowers the arm's own caps to them."""
        how = f"{JointCaps.__module__}.JointCaps(speed=..., acceleration=...)"
        self._ceiling = checked_kind("ceiling", ceiling, JointCaps, how)
        self._caps = JointCaps(
            speed=min(self._caps.speed, ceiling.speed),
            acceleration=min(self._caps.acceleration, ceiling.acceleration),
        )

    @property
    def limits(self) -> MotionLimits:
        """The caps of a motion without limits of its own; see also ``slowdown``."""
        return self._caps.limits

    def following_limits(self, limits: MotionLimits | None) -> MotionLimits:
        """The caps of a following that asks for ``limits``; None for the arm's own."""
        wanted = self._below_ceiling(limits)
        return wanted.lowered_to(wanted.velocity, FOLLOWING_ACCELERATION * self.servo_acceleration)

    def effective_limits(self, limits: MotionLimits | None) -> MotionLimits:
        """The caps of a motion that asks for ``limits``; None for the arm's own."""
        return self._below_ceiling(limits).eased(self.slowdown())

    def _below_ceiling(self, limits: MotionLimits | None) -> MotionLimits:
        wanted = checked_limits(limits, len(ARM_JOINTS)) or self.limits
        most = np.minimum(self._ceiling.acceleration, self.servo_acceleration)
        return wanted.lowered_to(self._ceiling.speed, most)


def _check(name: str, value: float, bounds_deg: tuple[float, float], unit: str) -> None:
    (lower, upper), per = bounds_deg, unit.removeprefix("deg")
    if not isinstance(value, Real):
        raise ConfigError(name, value, f"must be a number [rad{per}]")
    in_radians(name, np.array(value), 2.0 * to_rad(upper), per)
    value_deg = round(to_deg(value), 9)  # 180 deg came in as a float in radians
    if not lower <= value_deg <= upper:
        least, most = (f"{to_rad(each):.3g}" for each in bounds_deg)
        reason = (
            f"is {value_deg:.4g} {unit}; must be from {lower:g} to {upper:g} {unit}, that is"
            f" {least} to {most} rad{per}"
        )
        raise ConfigError(name, value, reason)


class JointRange(NamedTuple):
    """The range of the joint angles, shapes (5,), [rad].

    It is the model's, narrowed by the calibration, because the stops differ a little from arm to
    arm.
    """

    lower: Array
    upper: Array

    def narrowed(self, lower: Array, upper: Array) -> JointRange:
        """This range, narrowed to these angles, shapes (5,), [rad]."""
        return JointRange(
            frozen_array(np.maximum(self.lower, lower), (5,)),
            frozen_array(np.minimum(self.upper, upper), (5,)),
        )

    def with_tolerance(self) -> JointRange:
        """This range, widened by ``TOLERANCE``: all angles that ``check`` accepts."""
        return JointRange(self.lower - TOLERANCE, self.upper + TOLERANCE)

    def check(self, q: Array) -> None:
        """Raise ``OutsideLimits`` for joint angles, shape (5,), [rad], outside the range."""
        excess = self._excess(q)
        i = int(np.argmax(excess))
        if not excess[i] <= TOLERANCE:
            value, lower, upper = (float(each[i]) for each in (q, self.lower, self.upper))
            raise OutsideLimits(
                f"{ARM_JOINTS[i]} at {to_deg(value):.2f} deg is outside its calibrated range,"
                f" {range_deg(lower, upper)} deg; choose a value between them, or"
                " calibrate the arm again",
                joint=ARM_JOINTS[i],
                value=value,
                lower=lower,
                upper=upper,
            )

    def check_path(self, q: Array) -> None:
        """Refuse a path, shape (n, 5), [rad], that leaves the range, as ``check`` does.

        A path that starts outside may come in from there, but not go farther out.
        """
        around = JointRange(np.minimum(self.lower, q[0]), np.maximum(self.upper, q[0]))
        excess = np.max(around._excess(q), axis=1)
        worst = int(np.argmax(excess))
        if not excess[worst] <= TOLERANCE:
            self.check(q[worst])

    def _excess(self, q: Array) -> Array:
        """How far joint angles, shape (..., 5), are outside [rad]; negative inside."""
        return np.asarray(np.maximum(self.lower - q, q - self.upper))
