"""Bound the jerk of a motion that arrives step by step, by a moving average (an FIR filter).

The output is the average of the latest inputs. It keeps every bound that the input keeps: position
limits, velocities, accelerations. In each step its acceleration changes by the acceleration that
enters the window of ``n`` steps less the one that leaves it, over ``n``: by at most ``2 a / n`` for
an input bounded by ``a``. So a window of ``2 a / j`` seconds bounds the jerk by ``j``. All joints
have the same window: they are late by the same time, half of it, and a straight line stays
straight.

When the input stands still, the output reaches it exactly, one window later.

Source: L. Biagiotti, C. Melchiorri, FIR filters for online trajectory planning with time- and
frequency-domain specifications, 2012.
"""

from __future__ import annotations

import math

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.timing.limits import MotionLimits


class MovingAverage:
    """Filters the positions of a reference that starts at rest.

    Args:
        q: Start position, shape (n,), [rad].
        limits: The reference's accelerations, and the jerk that the output shall keep.
        dt: Time step [s].

    Attributes:
        steps: How many steps are averaged.
    """

    def __init__(self, q: Array, limits: MotionLimits, dt: float) -> None:
        window = 2.0 * float((limits.acceleration / limits.jerk).max())
        self.steps = max(1, math.ceil(window / dt - 1e-9))
        self._trail = np.tile(q, (self.steps, 1))  # the oldest first

    def step(self, q: Array) -> Array:
        """The output after the reference has stepped to ``q``, shape (n,), [rad]."""
        self._trail[:-1] = self._trail[1:]
        self._trail[-1] = q
        # Relative to the reference, so that it is exact when all are the same.
        return np.asarray(q + (self._trail - q).sum(axis=0) / self.steps)

    def ahead(self, q: Array) -> Array:
        """The coming outputs, step by step, until they rest at the end of ``q``, (m, n) [rad]."""
        end, steps = q[-1], self.steps
        waiting = np.broadcast_to(end, (steps - 1, len(end)))
        sums = np.cumsum(np.concatenate((self._trail, q, waiting)) - end, axis=0)
        return np.asarray(end + (sums[steps:] - sums[:-steps]) / steps)
