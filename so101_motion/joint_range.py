"""How far the joints of one arm may be sent: the model's limits, narrowed by its calibration.

An arm is calibrated by moving each joint from stop to stop by hand, and each arm's stops are a
little elsewhere. What was found is the range; nothing is sent beyond it but for ``TOLERANCE``,
because a joint at its very stop is measured now on this side of it, now on that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from so101_motion.errors import OutsideLimits
from so101_motion.geometry import Array, frozen_array
from so101_motion.state import ARM_JOINTS
from so101_motion.units import to_deg, to_rad

TOLERANCE = to_rad(0.2)
"""How far beyond its range a joint may be sent [rad]: two ticks."""


class JointRange(NamedTuple):
    """Between which angles the joints may be.

    Attributes:
        lower: Smallest joint angles, shape (5,), [rad].
        upper: Largest joint angles, shape (5,), [rad].
    """

    lower: Array
    upper: Array

    def narrowed(self, lower: Array, upper: Array) -> JointRange:
        """What is both in this range and between these angles, shapes (5,), [rad]."""
        return JointRange(
            frozen_array(np.maximum(self.lower, lower), (5,)),
            frozen_array(np.minimum(self.upper, upper), (5,)),
        )

    def with_tolerance(self) -> JointRange:
        """All that is not refused, ``TOLERANCE`` included."""
        return JointRange(self.lower - TOLERANCE, self.upper + TOLERANCE)

    def check(self, q: Array) -> None:
        """Refuse joint angles, shape (5,), [rad], that the arm cannot be sent to.

        Raises:
            OutsideLimits: Which joint, where to, and between what it may go.
        """
        excess = self._excess(q)
        i = int(np.argmax(excess))
        if not excess[i] <= TOLERANCE:
            value, lower, upper = (float(each[i]) for each in (q, self.lower, self.upper))
            raise OutsideLimits(
                f"{ARM_JOINTS[i]} at {to_deg(value):.2f} deg is outside its calibrated range,"
                f" {to_deg(lower):.2f} to {to_deg(upper):.2f} deg; choose a value between them, or"
                " calibrate the arm again",
                joint=ARM_JOINTS[i],
                value=value,
                lower=lower,
                upper=upper,
            )

    def check_way(self, q: Array) -> None:
        """Refuse a way, shape (n, 5), [rad], that leaves the range.

        One that starts outside may come in from there, but not go further out.

        Raises:
            OutsideLimits: As for ``check``, for the posture that is furthest off.
        """
        around = JointRange(np.minimum(self.lower, q[0]), np.maximum(self.upper, q[0]))
        excess = np.max(around._excess(q), axis=1)
        worst = int(np.argmax(excess))
        if not excess[worst] <= TOLERANCE:
            self.check(q[worst])

    def _excess(self, q: Array) -> Array:
        """How far joint angles, shape (..., 5), are outside [rad]; negative inside."""
        return np.asarray(np.maximum(self.lower - q, q - self.upper))
