"""Bound the jerk of a motion that arrives step by step, by a moving average (an FIR filter).

The follower is where the leader was on average lately. Averages keep whatever bound the leader
keeps: positions between limits, velocities, accelerations. Over ``n`` steps of ``dt`` acceleration
changes by what comes in at one end of the window less what leaves at the other, so by no more than
``2 a / n`` in a step for a leader that keeps ``a``; a window of ``2 a / j`` bounds jerk by ``j``.
One window for all joints: they are late by the same time, half of it, and what was a straight line
of the leader's stays one.

A leader that stands is caught up with exactly, a window later.

Source: L. Biagiotti, C. Melchiorri, FIR filters for online trajectory planning with time- and
frequency-domain specifications, 2012.
"""

from __future__ import annotations

import math

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.timing.limits import MotionLimits


class MovingAverage:
    """Follows one leader from where it is at rest.

    Args:
        q: Where that is, shape (n,), [rad].
        limits: What accelerations the leader keeps, and what jerk the follower shall keep.
        dt: How long a step takes [s].

    Attributes:
        steps: How many steps are averaged.
    """

    def __init__(self, q: Array, limits: MotionLimits, dt: float) -> None:
        window = 2.0 * float((limits.acceleration / limits.jerk).max())
        self.steps = max(1, math.ceil(window / dt - 1e-9))
        self._trail = np.tile(q, (self.steps, 1))  # the oldest first

    def follow(self, lead: Array) -> Array:
        """Where it is when the leader has stepped to ``lead``, shape (n,), [rad]."""
        self._trail[:-1] = self._trail[1:]
        self._trail[-1] = lead
        # Seen from the leader: that is exact when all are the same.
        return np.asarray(lead + (self._trail - lead).sum(axis=0) / self.steps)

    def ahead(self, lead: Array) -> Array:
        """Where it will be, step by step, until it stands where ``lead`` (m, n) ends."""
        end, steps = lead[-1], self.steps
        waiting = np.broadcast_to(end, (steps - 1, len(end)))
        sums = np.cumsum(np.concatenate((self._trail, lead, waiting)) - end, axis=0)
        return np.asarray(end + (sums[steps:] - sums[:-steps]) / steps)
