"""Say how joints that are led accelerate, as far as that is known beforehand.

The driver makes up for what servos lag behind by it, which drives them ahead of their setpoints; so
nothing is told that could drive them elsewhere. A target may say of itself what it likes: joints
get faster no further than their setpoint does. That they will brake is told before it does, for a
servo needs time to, but never so much that they would turn round. How joints come to rest is known
exactly. Of a target that does not say how it accelerates nothing is known, and servos lag.
"""

from __future__ import annotations

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.timing.online import FORESIGHT
from so101_motion.planning.timing.trajectory import Setpoint

KNOWN_JERK = 200.0
"""How fast the acceleration that is told may rise [rad/s^3]. Chosen by trial: what is told of a
hand's acceleration is noisy."""

AHEAD = 0.5
"""For so long after it was last told something the driver is still ahead [s] and has to know how
the joints brake: it gives up what it makes up for that slowly (``goal_compensation.py``)."""


class Foreseen:
    """What the driver is told in each period.

    Args:
        dt: The period [s].

    Attributes:
        qdd: How the joints accelerate, shape (n,), [rad/s^2]; None if nobody knows.
    """

    def __init__(self, dt: float) -> None:
        self.qdd: Array | None = None
        self._dt, self._left = dt, 0.0

    @property
    def may_be_ahead(self) -> bool:
        """Whether the driver may still make up for something."""
        return self._left > 0.0

    def beside(self, led: Setpoint, qdd: Array) -> None:
        """The joints are led to ``led`` and will accelerate by ``qdd``, shape (n,), [rad/s^2]."""
        self._left, step = AHEAD, KNOWN_JERK * self._dt
        before = led.qdd if self.qdd is None else self.qdd
        known = np.clip(qdd, before - step, before + step)
        way = np.sign(led.qd)
        faster, to_rest = np.maximum(way * led.qdd, 0.0), -np.abs(led.qd) / FORESIGHT
        self.qdd = way * np.clip(way * known, np.minimum(way * led.qdd, to_rest), faster)

    def braking(self, now: Setpoint) -> None:
        """The joints brake and are at ``now``."""
        self._left -= self._dt
        self.qdd = now.qdd if self._left > 0.0 else None

    def unknown(self) -> None:
        """The joints are led by a target that does not say how it accelerates."""
        self._left -= self._dt
        self.qdd = None
