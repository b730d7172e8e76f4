"""Foresee where planned joints turn round, so that their servos do it in time.

Where a joint turns round, its friction changes sides, and unless its load presses its gears to one
side, its motor has to go through the play before the joint follows. Done when the joint has turned,
that takes so long that it is a degree behind by then. So friction changes sides shortly before, and
the motor is driven through the play about then, while the joint hardly moves. A load that changes
sides takes a joint through the play as well; then the motor has to bring it back.

That needs to be known beforehand, so it is done in planned motions only; and a motor is driven
through the play only if somebody has found out how much there is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from so101_motion.common.units import to_rad
from so101_motion.drivers.feetech.gravity_compensation import Trim
from so101_motion.drivers.feetech.lag_compensation import DELAY

EARLY = 0.045
"""How long before a joint turns round its friction begins to change sides [s]. Chosen by trial."""

FLIP = 0.04
"""In which time friction changes sides [s]; chosen by trial."""

CROSSING = 0.06
"""In which time a motor is driven through the play [s]; chosen by trial."""

STANDS = to_rad(1.0)
"""Nothing is foreseen of a slower joint [rad/s]. Chosen."""

PRESSED = 0.03
"""A smaller load does not surely keep the gears on its side [N m]; chosen by trial."""

_N = 5


class Reversals:
    """Where the friction and the play of the arm joints are, and where they will be.

    Args:
        trim: Knows the servos and what they bear.

    Attributes:
        crossing: How fast each motor is driven through the play [rad/s].
    """

    def __init__(self, trim: Trim) -> None:
        self._trim = trim
        self._side = [0.0] * _N  # of the play, on which the motor is, -1 to 1
        self.crossing = [0.0] * _N

    def unknown(self) -> None:
        """Nobody knows how the joints go on."""
        self.crossing = [0.0] * _N

    def foresee(self, qd: Sequence[float], qdd: Sequence[float], dt: float) -> list[float | None]:
        """Which way and how fully the friction of each joint is to be overcome now, -1 to 1.

        None for one that hardly moves: it may be coming to rest, or creep on for long.

        Args:
            qd: How fast the joints are wanted [rad/s].
            qdd: How that changes from now on [rad/s^2].
            dt: How long after the last time [s].
        """
        ways: list[float | None] = []
        for i, (speed, change) in enumerate(zip(qd, qdd, strict=True)):
            model, way = self._trim.models[i], None
            ahead = speed + (DELAY + model.kind.goal_delay + EARLY) * change
            weight, play = self._trim.weights[i], model.figures.play
            self.crossing[i] = 0.0
            if abs(ahead) > STANDS:
                way = _near(math.copysign(1.0, ahead), self._trim.ways[i], 2.0 * dt / FLIP)
            if play and (abs(ahead) > STANDS or abs(weight) > PRESSED):
                before = self._side[i]
                wanted = math.copysign(1.0, weight if abs(weight) > PRESSED else ahead)
                self._side[i] = _near(wanted, before, 2.0 * dt / CROSSING)
                self.crossing[i] = 0.5 * play * (self._side[i] - before) / dt
            ways.append(way)
        return ways


def _near(wanted: float, before: float, change: float) -> float:
    """``wanted``, or what is nearest to it within ``change`` from ``before``."""
    return min(max(wanted, before - change), before + change)
