"""Go to a first target slowly, and come up to the full pace once it is near."""

from __future__ import annotations

import math

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad
from so101_motion.planning.timing.limits import MotionLimits

GATE = to_rad(5.0)
"""From how near on a target is followed at the full pace [rad]; the published module's later gate
for teleoperation."""

EASE = 0.5
"""How long the pace takes from that of the approach to the full one [s]; chosen."""

CATCH_UP = 1.0
"""How long the pace takes to the full one once nothing holds the joints back any more [s]; chosen:
whoever leads them goes on meanwhile, and need not wait for them."""

APPROACH = MotionLimits.uniform(velocity=to_rad(30.0), acceleration=to_rad(100.0), jerk=50.0)
"""Caps of the approach; chosen."""


class Approach:
    """Which caps count: those of an approach until the target is near, then more and more.

    Args:
        full: Caps from then on.
        slow: Caps of the approach; None for ``full``.
        gate: How near that is, for every joint [rad].

    Attributes:
        is_under_way: Whether the target has not been near yet.
    """

    def __init__(self, full: MotionLimits, slow: MotionLimits | None, gate: float = GATE) -> None:
        self._full, self._gate, self._t_near, self._t_held = full, gate, -math.inf, math.inf
        self._slow = None if slow is None else slow.scaled_to(full.velocity, full.acceleration)
        self.is_under_way = slow is not None

    def begin(self) -> None:
        """Approach anew."""
        self.is_under_way, self._t_held = self._slow is not None, math.inf

    def caps(self, t: float, off: Array, *, is_held: bool = False) -> MotionLimits:
        """The caps that count now.

        Args:
            t: Now [s].
            off: How far each joint is from its target, shape (n,), [rad].
            is_held: Whether something holds the joints back; further than the gate, their pace is
                that of the approach, and rises to the full one within ``CATCH_UP`` afterwards.
        """
        if self._slow is None:
            return self._full
        if float(np.max(np.abs(off))) > self._gate:
            if is_held and (not self.is_under_way or self._t_held < math.inf):
                self.is_under_way, self._t_held = True, t
        elif self.is_under_way:
            self.is_under_way, self._t_near, self._t_held = False, t, math.inf
        if self.is_under_way:
            return self._slow.eased_to(self._full, (t - self._t_held) / CATCH_UP)
        return self._slow.eased_to(self._full, (t - self._t_near) / EASE)
