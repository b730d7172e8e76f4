"""Convert servo ticks to joint angles and back, and speeds and accelerations to servo units.

A turn has 4096 ticks. (Two known programs divide by 4095, which stretches half a turn by 0.04 deg.)
Positions are as the servo reports them, with its homing offset already subtracted. They lie on a
circle: tick 4095 is next to tick 0. ``to_rad`` unrolls that circle at the point opposite to the
middle of the joint's range, which the joint cannot reach. So a position a little outside the range
becomes an angle a little outside, and never one a turn away.

Reading and writing back never moves a joint: ``to_ticks(to_rad(t)) == t`` for every tick of the
unrolled circle, exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NewType

from so101_motion.drivers.bus.registers import TICKS_PER_TURN

Ticks = NewType("Ticks", int)
"""A position or a difference of positions as the servo counts."""

RAD_PER_TICK = 2.0 * math.pi / TICKS_PER_TURN
TICKS_PER_RAD = TICKS_PER_TURN / (2.0 * math.pi)

TOP_SPEED_TICKS = 7500
"""Largest speed the servo accepts [tick/s]: register 84 at its factory value."""

TOP_ACCELERATION_UNITS = 100
"""Largest value of register 41 the servo uses while register 85 has its factory value."""

_UNIT_TICKS, _OFFSET_TICKS = 108.0, 386.0
"""Real acceleration by the acceleration register [tick/s^2]: 386 + 108 per count, the mean of three
joints measured by the authors of the published module; the manual says 100 per count."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointMap:
    """Maps one joint's angle to its servo's ticks.

    Raises:
        ValueError: Limits or direction make no sense.
    """

    servo_id: int  # the servo's id on the bus
    zero_ticks: float = 2048.0  # the position at joint angle zero [tick]; may lie between two ticks
    direction: int = 1  # 1 if the servo counts up with the angle, else -1
    lower_ticks: Ticks = Ticks(0)  # smallest position the joint may be sent to
    upper_ticks: Ticks = Ticks(TICKS_PER_TURN - 1)  # largest
    # the servo's homing offset for which these ticks are valid [tick]; the servo gets the limits
    # until it loses its power. None leaves its limits alone
    homing_offset: int | None = None

    def __post_init__(self) -> None:
        if self.direction not in (1, -1):
            raise ValueError(f"direction is 1 or -1, not {self.direction}")
        if not 0 <= self.lower_ticks < self.upper_ticks < TICKS_PER_TURN:
            raise ValueError(f"no range of ticks: {self.lower_ticks} to {self.upper_ticks}")
        if not math.isfinite(self.zero_ticks):
            raise ValueError(f"zero_ticks must be finite, not {self.zero_ticks}")

    @property
    def lower(self) -> float:
        """Smallest angle the joint may be sent to [rad]."""
        return min(self._angle(self.lower_ticks), self._angle(self.upper_ticks))

    @property
    def upper(self) -> float:
        """Largest angle the joint may be sent to [rad]."""
        return max(self._angle(self.lower_ticks), self._angle(self.upper_ticks))

    def to_rad(self, ticks: Ticks) -> float:
        """The joint angle at a reported position [rad]."""
        return self._angle(self.unrolled(ticks))

    def to_ticks(self, q: float) -> Ticks:
        """The position nearest to joint angle ``q`` [rad], on the unrolled circle, not clamped."""
        return Ticks(round(self.zero_ticks + self.direction * q * TICKS_PER_RAD))

    def to_goal(self, q: float) -> Ticks:
        """The position to send the joint to for angle ``q`` [rad], clamped to its limits."""
        return Ticks(min(max(self.to_ticks(q), self.lower_ticks), self.upper_ticks))

    @property
    def seam(self) -> int:
        """The first position of the unrolled circle."""
        return (self.lower_ticks + self.upper_ticks + 1) // 2 - TICKS_PER_TURN // 2

    def unrolled(self, ticks: Ticks) -> Ticks:
        """The same position, less than half a turn from the middle of the joint's range."""
        return Ticks(self.seam + (ticks - self.seam) % TICKS_PER_TURN)

    def _angle(self, ticks: Ticks) -> float:
        return self.direction * (ticks - self.zero_ticks) * RAD_PER_TICK


def to_speed_ticks(speed: float) -> int:
    """The speed register's value for a cap of ``speed`` [rad/s], which must be positive.

    At least 1, because 0 means maximum. (The servo itself turns no slower than about 9 deg/s;
    slower motions are sent as slowly changing setpoints.)
    """
    if not speed > 0.0:
        raise ValueError(f"a speed cap must be positive, not {speed}")
    return max(1, math.floor(min(speed * TICKS_PER_RAD, TOP_SPEED_TICKS)))


def to_acceleration_units(acceleration: float) -> int:
    """The acceleration register's value for a cap of ``acceleration`` [rad/s^2], positive.

    At least 1, because 0 means maximum; 1 is already 43 deg/s^2.
    """
    if not acceleration > 0.0:
        raise ValueError(f"an acceleration cap must be positive, not {acceleration}")
    units = (acceleration * TICKS_PER_RAD - _OFFSET_TICKS) / _UNIT_TICKS
    return math.floor(min(max(units, 1.0), TOP_ACCELERATION_UNITS))
