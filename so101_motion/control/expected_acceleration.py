"""Tell the driver how joints that follow a target will accelerate.

The driver uses it to make up for servo lag, which drives servos ahead of their setpoints, so a
wrong value must not drive them elsewhere. A target may claim any acceleration: the driver is told
that a joint speeds up only as far as its setpoint does. It is told of braking before the setpoint
brakes, because a servo needs time for it, but never so much that the joint would turn round. How
joints come to rest is known exactly. If a target does not say how it accelerates, the driver is
told nothing and the servos lag.
"""

from __future__ import annotations

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.timing.pursuit import FORESIGHT
from so101_motion.planning.timing.trajectory import Setpoint

KNOWN_JERK = 200.0
"""How fast the reported acceleration may rise [rad/s^3]. Chosen by trial: the acceleration of a
hand is noisy."""

AHEAD = 0.5
"""The driver may be ahead for so long after it was last told an acceleration [s], because its
compensation fades slowly (``goal_compensation.py``); so it must still know how joints brake."""


class ExpectedAcceleration:
    """The acceleration that the driver is told in each period.

    Args:
        dt: The period [s].

    Attributes:
        qdd: How the joints accelerate, shape (n,), [rad/s^2]; None if it is not known.
    """

    def __init__(self, dt: float) -> None:
        self.qdd: Array | None = None
        self._dt, self._left = dt, 0.0

    @property
    def may_be_ahead(self) -> bool:
        """Whether the driver may still drive servos ahead of their setpoints."""
        return self._left > 0.0

    def beside(self, setpoint: Setpoint, qdd: Array) -> None:
        """The joints are sent to ``setpoint``, to accelerate by ``qdd``, shape (n,), [rad/s^2]."""
        self._left, step = AHEAD, KNOWN_JERK * self._dt
        before = setpoint.qdd if self.qdd is None else self.qdd
        known = np.clip(qdd, before - step, before + step)
        way = np.sign(setpoint.qd)
        faster, to_rest = np.maximum(way * setpoint.qdd, 0.0), -np.abs(setpoint.qd) / FORESIGHT
        self.qdd = way * np.clip(way * known, np.minimum(way * setpoint.qdd, to_rest), faster)

    def braking(self, now: Setpoint) -> None:
        """The joints brake and are at ``now``."""
        self._left -= self._dt
        self.qdd = now.qdd if self._left > 0.0 else None

    def unknown(self) -> None:
        """The joints follow a target that does not say how it accelerates."""
        self._left -= self._dt
        self.qdd = None
