"""Map the leader's joint angles to the follower's."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from so101_motion.common.geometry import Array, frozen_array
from so101_motion.common.state import ARM_JOINTS

MIRRORED = ("shoulder_pan", "wrist_roll")
"""The joints that turn the other way in an upright mirror in front of the arm."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mirror:
    """Angle of the follower = factor x angle of the leader + offset, joint by joint.

    The jaw needs none: it opens by the same share of its own travel.
    """

    factors: Array = field(default_factory=lambda: np.ones(5))  # shape (5,)
    offsets: Array = field(default_factory=lambda: np.zeros(5))  # shape (5,), [rad]

    def __post_init__(self) -> None:
        for name in ("factors", "offsets"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (5,)))
        if not (np.all(np.isfinite(self.factors)) and np.all(np.isfinite(self.offsets))):
            raise ValueError(f"must be finite, got {self.factors}, {self.offsets}")

    def facing(self) -> Mirror:
        """This mapping for arms that face each other, as in a mirror."""
        signs = np.where(np.isin(ARM_JOINTS, MIRRORED), -1.0, 1.0)
        return Mirror(factors=signs * self.factors, offsets=self.offsets)

    def of(self, q_leader: Array) -> Array:
        """The follower's angles for the leader's, shapes (5,), [rad]."""
        return np.asarray(self.factors * q_leader + self.offsets)
