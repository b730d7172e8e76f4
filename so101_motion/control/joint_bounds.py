"""Find joints that could not stop within their range, and lower caps to those of a stop.

This runs several times in every control cycle, so it uses plain numbers: for five joints numpy
takes five times as long.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint

_ROUNDING = 1e-9
_THERE = 1e-7  # [rad], [rad/s]: closer and slower is there, at rest


def stoppable(limits: MotionLimits, stop: MotionLimits, *, with_jerk: bool) -> MotionLimits:
    """Lower the velocity and acceleration of ``limits`` to those of a stop.

    With more jerk than a stop has joints creep up on the end of their range. That only matters to a
    motion that is to end there, so jerk is lowered on request.
    """
    lowered = limits.lowered_to(stop.velocity, stop.acceleration)
    return gentle(lowered, stop) if with_jerk else lowered


@lru_cache(maxsize=8)
def gentle(limits: MotionLimits, stop: MotionLimits) -> MotionLimits:
    """Lower the jerk of ``limits`` to that of a stop."""
    return replace(limits, jerk=np.minimum(limits.jerk, stop.jerk))


def landed(setpoint: Setpoint, q: Array, qd: Array) -> Setpoint:
    """Put joints that have arrived at a goal that stands still exactly there, at rest.

    Args:
        setpoint: The setpoint of the joints.
        q: Their goal, shape (n,), [rad].
        qd: How fast that goal moves, shape (n,), [rad/s].
    """
    there = [
        w == 0.0 and abs(v) < _THERE and abs(a) < 100.0 * _THERE and abs(x - goal) < _THERE
        for x, v, a, goal, w in zip(
            setpoint.q.tolist(),
            setpoint.qd.tolist(),
            setpoint.qdd.tolist(),
            q.tolist(),
            qd.tolist(),
            strict=True,
        )
    ]
    if not any(there):
        return setpoint
    return Setpoint(
        q=np.where(there, q, setpoint.q),
        qd=np.where(there, 0.0, setpoint.qd),
        qdd=np.where(there, 0.0, setpoint.qdd),
    )


class JointBounds:
    """Says which joints could not stop within their range and below their speed cap.

    Args:
        least: Lowest angles, shape (n,), [rad].
        most: Highest angles, shape (n,), [rad].
        limits: Largest caps of their setpoints.
        stop: How hard they brake.
        begin: Where they begin; joints that are faster there may be as fast.
    """

    def __init__(
        self, least: Array, most: Array, limits: MotionLimits, stop: MotionLimits, begin: Setpoint
    ) -> None:
        hardest = limits.acceleration + _ROUNDING
        there = np.abs(begin.qd + 0.5 * begin.qdd * np.abs(begin.qdd) / stop.jerk)
        fastest = np.maximum(limits.velocity, there) + _ROUNDING
        rows = least - _ROUNDING, most + _ROUNDING, hardest, stop.jerk, fastest
        self._rows = np.column_stack(rows).tolist()

    def outside(
        self, setpoint: Setpoint, limits: MotionLimits, lowest: list[float], highest: list[float]
    ) -> list[bool]:
        """Which joints could not stop in time, or would turn round too hard.

        Args:
            setpoint: Their next setpoint.
            limits: Their caps now.
            lowest: Their lowest angles on the path to rest from there [rad].
            highest: Their highest [rad].
        """
        found = list[bool]()
        for low, high, qd, qdd, jerk, row in zip(
            lowest, highest, setpoint.qd.tolist(), setpoint.qdd.tolist(), limits.jerk.tolist(),
            self._rows, strict=True,
        ):  # fmt: skip
            least, most, hardest, stop_jerk, fastest = row
            more = 0.5 * qdd * abs(qdd)
            # One that has braked harder than it may speed up must not turn round with that.
            turns = abs(qdd) > hardest and ((qd + more / jerk) * qd <= 0.0 or qdd * qd > 0.0)
            found.append(
                turns
                or low < least
                or high > most
                # While its acceleration is taken back, a joint still gets faster.
                or abs(qd + more / stop_jerk) > fastest
            )
        return found

    def too_fast(self, setpoint: Setpoint) -> bool:
        """Whether a joint would exceed its speed cap while its acceleration is taken back."""
        return any(
            abs(qd + 0.5 * qdd * abs(qdd) / stop_jerk) > fastest
            for qd, qdd, (_, _, _, stop_jerk, fastest) in zip(
                setpoint.qd.tolist(), setpoint.qdd.tolist(), self._rows, strict=True
            )
        )
