"""Lower the caps of a following while its target is still far away."""

from __future__ import annotations

import math

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad
from so101_motion.planning.timing.limits import MotionLimits

GATE = to_rad(5.0)
"""Within this distance of its target a joint follows at full speed [rad]; from the published
module's later gate for teleoperation."""

EASE = 0.5
"""How long the caps take to rise from those of the approach to the full ones [s]; chosen."""

CATCH_UP = 1.0
"""How long the caps take to rise again once nothing holds the joints back [s]; chosen: the target
moves on meanwhile and does not have to wait for them."""

APPROACH = MotionLimits.uniform(velocity=to_rad(30.0), acceleration=to_rad(100.0), jerk=50.0)
"""Caps of the approach; chosen."""


class Approach:
    """Chooses the caps of a following: low until the target is near, then rising to full.

    Args:
        full: Caps once the target is near.
        slow: Caps of the approach; None for ``full``.
        gate: A target is near when every joint is closer to it than this [rad].

    Attributes:
        is_under_way: Whether the target has not been near yet.
    """

    def __init__(self, full: MotionLimits, slow: MotionLimits | None, gate: float = GATE) -> None:
        self._full, self._gate, self._t_near, self._t_held = full, gate, -math.inf, math.inf
        self._slow = None if slow is None else slow.lowered_to(full.velocity, full.acceleration)
        self.is_under_way = slow is not None

    def begin(self) -> None:
        """Start the approach again."""
        self.is_under_way, self._t_held = self._slow is not None, math.inf

    def caps(self, t: float, off: Array, *, is_held: bool = False) -> MotionLimits:
        """The caps to use now.

        Args:
            t: Now [s].
            off: How far each joint is from its target, shape (n,), [rad].
            is_held: Whether something holds the joints back. If they are then farther off than the
                gate, they get the caps of the approach, which rise within ``CATCH_UP`` afterwards.
        """
        if self._slow is None:
            return self._full
        if max(map(abs, off.tolist())) > self._gate:
            if is_held and (not self.is_under_way or self._t_held < math.inf):
                self.is_under_way, self._t_held = True, t
        elif self.is_under_way:
            self.is_under_way, self._t_near, self._t_held = False, t, math.inf
        if self.is_under_way:
            return self._slow.eased_to(self._full, (t - self._t_held) / CATCH_UP)
        return self._slow.eased_to(self._full, (t - self._t_near) / EASE)
