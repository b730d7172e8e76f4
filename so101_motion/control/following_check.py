"""Tell whether joints follow their setpoints, or something holds them up.

Two ways to see it. *A joint is far from where it was wanted*, whatever the reason: servos lag, so
it is measured against all the setpoints of the last ``following_lag``. *A joint stands while it is
led on*: over one of ``contact_windows`` it has moved much less than the setpoints have. That is
seen long before the joint is far off, because what makes joints stand off (weight, friction, delay)
changes little in so short a time; so it tells a contact from a load. The longer window is for slow
motions, in which a joint is led on no farther than play lets it stand.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.geometry import Array
from so101_motion.control.joint_group import Tolerances


class FollowingCheck:
    """Compares measured joints with the latest setpoints, tick by tick.

    Args:
        tolerances: From where on a joint does not follow.
        dt: The period of the ticks [s].
    """

    def __init__(self, tolerances: Tolerances, dt: float) -> None:
        self._tolerances = tolerances
        self._lag = round(tolerances.following_lag / dt)
        self._windows = tuple(round(span / dt) for span in tolerances.contact_windows)
        self._kept = 1 + self._lag + max(self._windows)
        self._wanted: deque[Array] = deque(maxlen=self._kept)
        self._seen: deque[Array] = deque(maxlen=1 + max(self._windows))

    def begin(self, q_ref: Array) -> None:
        """Forget everything; the joints have stood at ``q_ref``, shape (n,), [rad]."""
        self._wanted.extend([q_ref] * self._kept)
        self._seen.clear()

    def want(self, q_ref: Array) -> None:
        """The joints are wanted at ``q_ref`` in this tick, shape (n,), [rad]."""
        self._wanted.append(q_ref)

    def off(self, q: Array) -> Array:
        """How far the joints at ``q`` are from all the latest setpoints, shapes (n,), [rad]."""
        wanted = np.array(self._wanted)[-1 - self._lag :]
        off: Array = np.maximum(np.min(wanted, axis=0) - q, q - np.max(wanted, axis=0))
        return off

    def held_up(self, q: Array) -> NDArray[np.bool_]:
        """Which of the joints, seen at ``q`` in this tick, stand while they are led on; (n,)."""
        self._seen.append(q)
        held = np.zeros(len(q), dtype=np.bool_)
        if len(self._wanted) < self._kept:
            return held
        wanted = np.array(self._wanted)
        for window in self._windows:
            if len(self._seen) > window:
                before = self._seen[len(self._seen) - 1 - window]
                held |= self._stands(wanted[-1 - self._lag - window :], window, q - before, q)
        return held

    def _stands(self, wanted: Array, window: int, moved: Array, q: Array) -> NDArray[np.bool_]:
        led = wanted[window:] - wanted[:-window]
        # By whatever lag it is explained best: only then is it no lag.
        least, most = np.min(led, axis=0), np.max(led, axis=0)
        way = np.where(least > 0.0, least, np.where(most < 0.0, most, 0.0))
        # One that goes backwards has not met anything, it sags or turns round.
        missing = np.abs(way) - np.maximum(np.sign(way) * moved, 0.0)
        less = np.maximum(
            self._tolerances.contact_distance, self._tolerances.contact_share * np.abs(way)
        )
        # One that ran ahead may wait for its setpoints.
        behind = np.sign(way) * (wanted[-1] - q)
        held: NDArray[np.bool_] = (missing > less) & (behind > 0.5 * less)
        return held
