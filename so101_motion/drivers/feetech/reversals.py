"""Compensate friction and play in advance where planned joints turn round.

Where a joint turns round, its friction changes sides, and unless its load presses its gears to one
side, its motor has to cross the play before the joint follows. If compensation starts only when the
joint has turned, the joint is a degree behind. So the compensation of friction changes sides
shortly before, and the motor is driven through the play while the joint hardly moves. A load that
changes sides takes a joint through the play as well; then the motor has to bring it back.

The turn has to be known in advance, so this is done in planned motions only; and a motor is driven
through the play only if an identification has measured it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from so101_motion.common.units import to_rad
from so101_motion.drivers.feetech.gravity_compensation import Trim
from so101_motion.drivers.feetech.lag_compensation import DELAY
from so101_motion.drivers.goal_limiter import within_change

EARLY = 0.045
"""How long before a joint turns round its friction begins to change sides [s]. Chosen by trial."""

FLIP = 0.04
"""Time in which friction changes sides [s]; chosen by trial."""

CROSSING = 0.06
"""Time in which a motor is driven through the play the way its joint goes [s]; chosen by trial."""

TAKEN_BACK = 0.25
"""Time in which it is driven through the play the other way, under a load that leads its joint on
[s]. Chosen: if the load is not what the driver takes it for, the joint is slower for that time
instead of standing."""

STANDS = to_rad(1.0)
"""Nothing is predicted for a slower joint [rad/s]. Chosen."""

PRESSED = 0.03
"""A smaller load may not keep the gears on its side [N m]; chosen by trial."""

_N = 5


class Reversals:
    """Predicts the sides of friction and play of the arm joints.

    Args:
        trim: The models of the servos and their loads.

    Attributes:
        crossing: Speed at which each motor is driven through the play now [rad/s].
    """

    def __init__(self, trim: Trim) -> None:
        self._trim = trim
        self._side = [0.0] * _N  # of the play, on which the motor is, -1 to 1
        self.crossing = [0.0] * _N

    def unknown(self) -> None:
        """Predict nothing, because the coming motion is not known."""
        self.crossing = [0.0] * _N

    def foresee(self, qd: Sequence[float], qdd: Sequence[float], dt: float) -> list[float | None]:
        """The side to which each joint's friction is to be compensated now, and how fully, -1 to 1.

        None for a joint that hardly moves: it may be coming to rest, or creep on for long.

        Args:
            qd: Commanded velocities [rad/s].
            qdd: Their change from now on [rad/s^2].
            dt: Time since the last call [s]; 0 if the clock has not gone on.
        """
        ways: list[float | None] = []
        for i, (speed, change) in enumerate(zip(qd, qdd, strict=True)):
            model, way = self._trim.models[i], None
            ahead = speed + (DELAY + model.kind.goal_delay + EARLY) * change
            weight, play = self._trim.weights[i], model.figures.play
            self.crossing[i] = 0.0
            if abs(ahead) > STANDS:
                way = within_change(math.copysign(1.0, ahead), self._trim.ways[i], 2.0 * dt / FLIP)
            if play and dt > 0.0 and (abs(ahead) > STANDS or abs(weight) > PRESSED):
                before = self._side[i]
                wanted = math.copysign(1.0, weight if abs(weight) > PRESSED else ahead)
                takes = CROSSING if wanted * ahead >= 0.0 else TAKEN_BACK
                self._side[i] = within_change(wanted, before, 2.0 * dt / takes)
                self.crossing[i] = 0.5 * play * (self._side[i] - before) / dt
            ways.append(way)
        return ways
