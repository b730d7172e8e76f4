"""Targets of a jog: a velocity, a pose or a point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array, frozen_array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Twist:
    """A velocity of the tool."""

    linear: Array  # velocity of its origin, shape (3,), [m/s]
    angular: Array  # its turning, shape (3,), [rad/s]
    in_tool: bool = False  # whether both are in the axes of the tool instead of those of the base

    def __post_init__(self) -> None:
        for name in ("linear", "angular"):
            values = frozen_array(getattr(self, name), (3,))
            if not np.all(np.isfinite(values)):
                raise ConfigError(name, values.tolist(), "must be three finite speeds")
            object.__setattr__(self, name, values)

    def same_as(self, other: Twist) -> bool:
        """Whether another twist is equal."""
        return (
            self.in_tool == other.in_tool
            and np.array_equal(self.linear, other.linear)
            and np.array_equal(self.angular, other.angular)
        )


STILL = Twist(linear=np.zeros(3), angular=np.zeros(3))  # the twist of a tool at rest

Target = Twist | SE3 | Array
"""A velocity of the tool, a pose of it, or a point (3,) [m] for its origin, in the base frame."""
