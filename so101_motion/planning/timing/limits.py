"""The velocity, acceleration and jerk limits that a trajectory keeps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.attributes import ABOVE_ZERO, checked_kind, checked_number
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array, given_array, in_metres, in_radians
from so101_motion.common.public import Public

ToolSpeed = Callable[[Array, Array], Array]
"""From joint angles (m, n) and their rates (m, n) to the speed of the tool point, (m,)."""

_MOST = {"velocity": (20.0, "/s"), "acceleration": (100.0, "/s^2")}
"""Larger caps are probably in degrees. Chosen: five times what the joints can do."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionLimits(Public):
    """Velocity, acceleration and jerk caps per joint, all positive and finite.

    Attributes:
        velocity: Shape (n,), [rad/s].
        acceleration: Shape (n,), [rad/s^2].
        jerk: Shape (n,), [rad/s^3].
        tool_speed: Cap on the speed of the tool point [m/s], or None.
    """

    velocity: Array
    acceleration: Array
    jerk: Array
    tool_speed: float | None = None

    def __post_init__(self) -> None:
        for name in ("velocity", "acceleration", "jerk"):
            values = given_array(name, getattr(self, name), (-1,), "numbers, one a joint")
            if len(values) != len(np.asarray(self.velocity)):
                joints = len(np.asarray(self.velocity))
                raise ConfigError(name, values.tolist(), f"must be {joints}, as many as velocities")
            if not all(0.0 < value < math.inf for value in values.tolist()):
                raise ConfigError(name, values.tolist(), "must be positive and finite")
            if name in _MOST and len(values) == 5:  # of an arm
                in_radians(name, values, *_MOST[name])
            object.__setattr__(self, name, values)
        if self.tool_speed is not None:
            checked_number("tool_speed", self.tool_speed, lower=ABOVE_ZERO, unit="m/s")
            in_metres("tool_speed", np.array(self.tool_speed), per="/s")

    def __repr__(self) -> str:
        units = {"velocity": "rad/s", "acceleration": "rad/s^2", "jerk": "rad/s^3"}
        caps = []
        for name, unit in units.items():
            given = getattr(self, name).round(3).tolist()
            caps.append(f"{name} {given[0] if len(set(given)) == 1 else given} {unit}")
        if self.tool_speed is not None:
            caps.append(f"tool_speed {self.tool_speed:g} m/s")
        return f"<MotionLimits: {', '.join(caps)}>"

    @classmethod
    def uniform(
        cls,
        *,
        velocity: float,
        acceleration: float,
        jerk: float,
        n: int = 5,
        tool_speed: float | None = None,
    ) -> MotionLimits:
        """The same caps for all ``n`` joints."""
        caps = {"velocity": velocity, "acceleration": acceleration, "jerk": jerk}
        each = {
            name: np.full(n, checked_number(name, cap, lower=ABOVE_ZERO))
            for name, cap in caps.items()
        }
        return cls(**each, tool_speed=tool_speed)

    def for_one(self) -> MotionLimits:
        """The smallest cap of each kind, for a single joint; none on the tool's speed.

        One joint alone, such as the jaw, does not tell how fast the tool point goes.
        """
        return MotionLimits.uniform(
            velocity=float(np.min(self.velocity)),
            acceleration=float(np.min(self.acceleration)),
            jerk=float(np.min(self.jerk)),
            n=1,
        )

    def eased(self, share: float) -> MotionLimits:
        """These limits with this share of velocity and acceleration, 0 to 1."""
        if share >= 1.0:
            return self
        return self.lowered_to(share * self.velocity, share * self.acceleration)

    def eased_to(self, other: MotionLimits, share: float) -> MotionLimits:
        """Interpolate from these limits to others; ``share`` is clamped to 0 to 1.

        Below 1 the result has no cap on the tool's speed: this eases followings, which have none.
        """
        if share >= 1.0:
            return other
        if share <= 0.0 and self.tool_speed is None:
            return self
        u = max(share, 0.0)
        return MotionLimits(
            velocity=self.velocity + u * (other.velocity - self.velocity),
            acceleration=self.acceleration + u * (other.acceleration - self.acceleration),
            jerk=self.jerk + u * (other.jerk - self.jerk),
        )

    def lowered_to(self, velocity: ArrayLike, acceleration: ArrayLike) -> MotionLimits:
        """These limits with velocity and acceleration lowered to given caps where those are less.

        Args:
            velocity: Scalar or shape (n,), [rad/s].
            acceleration: Scalar or shape (n,), [rad/s^2].
        """
        return MotionLimits(
            velocity=np.minimum(self.velocity, velocity),
            acceleration=np.minimum(self.acceleration, acceleration),
            jerk=self.jerk,
            tool_speed=self.tool_speed,
        )


def checked_limits(given: MotionLimits | None, n: int, key: str = "limits") -> MotionLimits | None:
    """The caps of ``n`` joints that a calling program gives; ``ConfigError`` for anything else."""
    how = "MotionLimits, as MotionLimits.uniform(velocity=..., acceleration=..., jerk=...)"
    checked_kind(key, given, MotionLimits | None, how)
    if given is not None and len(given.velocity) != n:
        raise ConfigError(key, given, f"has caps of {len(given.velocity)} joints instead of {n}")
    return given
