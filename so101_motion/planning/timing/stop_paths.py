"""Sample how joints come to rest: in every control cycle, so it has to be quick.

The compiled library does it (``native/rest.c``); for many joints, and where it finds no motion,
ruckig does.
"""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.native.library import native
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint

_JOINTS = 8  # with more joints than this ruckig does it; as in rest.c
_ROOM = 64  # up to so many samples need no new memory; chosen: a stop of a second has fewer


class PathToRest(NamedTuple):
    """The path of a stop, coarsely sampled."""

    after: Setpoint  # the state one period later
    path: Array  # joint angles from now to rest, shape (m, n), m >= 2, [rad]
    least: list[float]  # the smallest of each joint's [rad]
    largest: list[float]  # the largest of each joint's [rad]
    step: float  # time between the samples [s]


class StopPaths:
    """Samples the shortest stops (:func:`~online.stop`) of some joints. Belongs to one thread.

    Args:
        limits: Acceleration and jerk caps of the n joints.
        dt: The period [s].
        every: Largest time between samples [s].
    """

    def __init__(self, limits: MotionLimits, dt: float, every: float) -> None:
        self._limits, self._dt, self._every = limits, dt, every
        self._n = n = len(limits.velocity)
        given = np.concatenate(((dt, every), np.zeros(3 * n), limits.acceleration, limits.jerk))
        self._given, self._state = ctypes.c_void_p(given.ctypes.data), given[2:][: 3 * n]
        self._rows = self._state.reshape(3, n)
        self._make_room(_ROOM)

    def to_rest(self, now: Setpoint) -> PathToRest:
        """The path to rest from a state.

        Raises:
            PlanningError: ruckig finds no motion.
            ValueError: Shapes that do not fit, or values that are not finite.
        """
        library, n = native().library, self._n
        if n > _JOINTS or not now.q.shape == now.qd.shape == now.qdd.shape == (n,):
            return self._by_ruckig(now)
        rows = self._rows
        rows[0], rows[1], rows[2] = now.q, now.qd, now.qdd
        count = library.so101_path_to_rest(self._given, n, len(self._path), self._told)
        if count == 0:
            return self._by_ruckig(now)
        if count > len(self._path):
            self._make_room(count)
            return self.to_rest(now)
        after = self._after.copy()
        least, largest = self._span.tolist()
        return PathToRest(
            Setpoint(q=after[0], qd=after[1], qdd=after[2]),
            self._path[:count].copy(),
            least,
            largest,
            self._step.item(),
        )

    def _by_ruckig(self, now: Setpoint) -> PathToRest:
        period = min(self._dt, self._every)
        found = online.stop(now.q, now.qd, now.qdd, self._limits, period)
        path = np.array(found.q) if len(found) > 1 else np.repeat(found.q, 2, axis=0)
        least, largest = path.min(axis=0).tolist(), path.max(axis=0).tolist()
        return PathToRest(found.sample(self._dt), path, least, largest, period)

    def _make_room(self, samples: int) -> None:
        n = self._n
        told = np.zeros(1 + 5 * n + samples * n)
        self._step, self._after = told[:1], told[1:][: 3 * n].reshape(3, n)
        self._span = told[1 + 3 * n :][: 2 * n].reshape(2, n)
        self._path = told[1 + 5 * n :].reshape(samples, n)
        self._told = ctypes.c_void_p(told.ctypes.data)
