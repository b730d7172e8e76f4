"""Sample how joints come to rest: in every control cycle, so it has to be quick.

The compiled library does it (``native/rest.c``); for many joints, and where it finds no motion,
ruckig does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.native.library import quick
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint

JOINTS = 8  # with more joints than this ruckig does it; as in rest.c
_ROOM = 64  # up to so many samples need no new memory; chosen: a stop of a second has fewer


class PathToRest(NamedTuple):
    """The path of a stop, coarsely sampled."""

    after: Setpoint  # the state one period later
    path: Array  # joint angles from now to rest, shape (m, n), m >= 2, [rad]
    step: float  # time between the samples [s]


class StopPaths:
    """Samples the shortest stops (:func:`~online.stop`) of some joints. Belongs to one thread.

    Args:
        limits: Acceleration and jerk caps of the n joints.
        dt: The period [s].
        every: Largest time between samples [s].

    Attributes:
        given_at: Address of what the library is given.
        told_at: Address of what it tells.
        room: How many samples there is room for.
        after: The state one period later that it has told, shape (3, n).
        along: A row for what ``following.c`` puts before the samples, and the samples.
    """

    def __init__(self, limits: MotionLimits, dt: float, every: float) -> None:
        self._limits, self._dt, self._every = limits, dt, every
        self._n = n = len(limits.velocity)
        given = np.concatenate(((dt, every), np.zeros(3 * n), limits.acceleration, limits.jerk))
        self._given, self._rows = given, given[2:][: 3 * n].reshape(3, n)
        self.given_at = given.ctypes.data
        self.make_room(_ROOM)

    def to_rest(self, now: Setpoint) -> PathToRest:
        """The path to rest from a state.

        Raises:
            PlanningError: ruckig finds no motion.
            ValueError: Shapes that do not fit, or values that are not finite.
        """
        n = self._n
        if n > JOINTS or not now.q.shape == now.qd.shape == now.qdd.shape == (n,):
            return self._by_ruckig(now)
        rows = self._rows
        rows[0], rows[1], rows[2] = now.q, now.qd, now.qdd
        count = quick().so101_path_to_rest(self.given_at, n, self.room, self.told_at)
        if count == 0:
            return self._by_ruckig(now)
        if count > self.room:
            self.make_room(count)
            return self.to_rest(now)
        q, qd, qdd = self.after.copy()
        path = self.along[1 : 1 + count].copy()
        return PathToRest(Setpoint(q=q, qd=qd, qdd=qdd), path, self.step)

    @property
    def step(self) -> float:
        """The time between the samples that it has told [s]."""
        return self._told.item(0)

    def _by_ruckig(self, now: Setpoint) -> PathToRest:
        period = min(self._dt, self._every)
        found = online.stop(now.q, now.qd, now.qdd, self._limits, period)
        path = np.array(found.q) if len(found) > 1 else np.repeat(found.q, 2, axis=0)
        return PathToRest(found.sample(self._dt), path, period)

    def make_room(self, samples: int) -> None:
        n, self.room = self._n, samples
        self._told = told = np.zeros(1 + 5 * n + samples * n)
        self.after, self.along = told[1:][: 3 * n].reshape(3, n), told[1 + 4 * n :].reshape(-1, n)
        self.told_at = told.ctypes.data
