"""Check joint motions for contact: a proof by motion bounds, and a quicker sampled check.

Both use *travel*, an upper bound on how far any point of the arm moves: the sum of the joint angles
passed, each times the distance of the furthest point from that joint's axis.

*The proof.* If all pairs of bodies keep ``c`` apart at some configuration, nothing touches within
``c`` of travel before and after it. So a motion is cut into parts, and the configuration in the
middle of each must clear half the part's travel. A part that fails is cut into smaller ones, down
to those that the margins themselves clear. Far from everything a few configurations clear a whole
move. The result: the bodies keep at least their margins in the middle of every smallest part, and
never touch in between.

*The sampled check.* The margins at configurations a fixed travel apart. Near obstacles it costs a
third of a proof and misses little: the search for a path uses it, and the result is proven.

Source: F. Schwarzer, M. Saha, J.-C. Latombe, Adaptive Dynamic Collision Checking for Single and
Multiple Articulated Robots in Complex Environments, IEEE T-RO 2005.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import cache
from math import ceil
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.checkpoint import Checkpoint, never_abandoned

WIDER = (0.012, 0.048)
"""Clearances beyond the margins that a proof asks for [m]. Chosen with the next: of nine sets, none
was faster on the paths of four scenes, and equally fast ones had more clearances."""

CUT = 4
"""A part that is not clear is cut into so many parts."""

Touches = Callable[[Array], bool]
"""Whether any pair is too close at a configuration of all six joints, shape (6,), [rad]."""


class Level(NamedTuple):
    """A check of configurations.

    Attributes:
        clearance: Distance that all pairs keep if the check finds none too close [m].
        touches: The check itself.
        margins: Distances that it demands of pairs of links and of all other pairs [m].
    """

    clearance: float
    touches: Touches
    margins: tuple[float, float] = (0.0, 0.0)


def travel(reach: Array, points: Array) -> Array:
    """Like :meth:`CollisionModel.travel`, for ``points`` (n, 5); ``reach`` (5,), per joint, [m]."""
    steps: Array = np.abs(np.diff(points, axis=0)) @ reach
    return np.concatenate(([0.0], np.cumsum(steps)))


def first_blocked(
    levels: Sequence[Level],
    reach: Array,
    points: Array,
    q_jaw: float,
    checkpoint: Checkpoint = never_abandoned,
) -> Array | None:
    """A configuration (5,) on the straight lines through ``points`` that is too close, or None.

    None is a proof that the motion is free. ``levels`` go from the margins themselves to the widest
    clearance; ``points`` are (n, 5) [rad]; ``reach`` is as for :func:`travel`.
    """
    points = np.asarray(points, dtype=np.float64)
    travelled = travel(reach, points)
    total = float(travelled[-1])
    widest = levels[-1].clearance
    count = max(1, ceil(0.5 * total / widest))
    half = 0.5 * total / count
    middles = np.linspace(half, total - half, count)
    while True:
        k = next((k for k, level in enumerate(levels) if level.clearance >= half), -1)
        configurations = _configurations(points, travelled, middles, q_jaw)
        failed = _touching(levels[k].touches, configurations, checkpoint)
        if not failed:
            return None
        if k == 0:
            return np.array(configurations[failed[0], :5])
        if k == len(levels) - 1:
            # Most contacts are found here already.
            for i in failed:
                if levels[0].touches(configurations[i]):
                    return np.array(configurations[i, :5])
        half /= CUT
        middles = (middles[failed, None] + half * np.arange(1 - CUT, CUT, 2)).ravel()


def _touching(touches: Touches, configurations: Array, checkpoint: Checkpoint) -> list[int]:
    """Which of the configurations, shape (n, 6), [rad], are too close to something."""
    failed = []
    for i, configuration in enumerate(configurations):
        checkpoint()
        if touches(configuration):
            failed.append(i)
    return failed


def _configurations(points: Array, travelled: Array, at: Array, q_jaw: float) -> Array:
    """The configurations after some travel along a polyline, all six joints, shape (len(at), 6)."""
    configurations = np.empty((len(at), 6))
    configurations[:, 5] = q_jaw
    if len(points) == 2 and travelled[-1] > 0.0:
        configurations[:, :5] = points[0] + (at / travelled[-1])[:, None] * (points[1] - points[0])
        return configurations
    k = np.minimum(np.searchsorted(travelled, at, "right"), len(points) - 1)
    before = np.maximum(k - 1, 0)
    length = travelled[k] - travelled[before]
    part = (at - travelled[before]) / np.where(length > 0.0, length, 1.0)
    configurations[:, :5] = points[before] + part[:, None] * (points[k] - points[before])
    return configurations


class SampledCheck:
    """Checks configurations and, at samples, straight joint lines: quick, and no proof.

    Args:
        touches: The check of a configuration.
        reach: As for ``travel``.
        q_jaw: Jaw angle [rad].
        spacing: Largest travel between two samples of a line [m].
        checkpoint: Called with every check.
    """

    def __init__(
        self,
        touches: Touches,
        reach: Array,
        *,
        q_jaw: float,
        spacing: float,
        checkpoint: Checkpoint = never_abandoned,
    ) -> None:
        self._touches, self._reach, self._spacing = touches, reach, spacing
        self._checkpoint = checkpoint
        self._configurations = np.full((64, 6), q_jaw)

    def is_free(self, q: Array) -> bool:
        """Whether nothing is too close at joint angles ``q``, shape (5,), [rad]."""
        self._checkpoint()
        configuration = self._configurations[0]
        configuration[:5] = q
        return not self._touches(configuration)

    def first_free(self, configurations: Array) -> int | None:
        """The first free one of several configurations (n, 5) [rad], None if none is."""
        self._checkpoint()
        looked_at = self._room_for(len(configurations))
        looked_at[:, :5] = configurations
        touches = self._touches
        return next(
            (k for k, configuration in enumerate(looked_at) if not touches(configuration)), None
        )

    def is_clear(self, q_from: Array, q_to: Array) -> bool:
        """Whether no sample between two configurations touches; the two are not checked."""
        self._checkpoint()
        step = q_to - q_from
        count = int(np.abs(step) @ self._reach / self._spacing)
        configurations = self._room_for(count)
        np.multiply(_middle_first(count), step, out=configurations[:, :5])
        configurations[:, :5] += q_from
        return not any(map(self._touches, configurations))

    def _room_for(self, count: int) -> Array:
        """Configurations of all six joints, the jaw's angle set, shape (count, 6)."""
        if count > len(self._configurations):
            self._configurations = np.full((2 * count, 6), self._configurations[0, 5])
        return self._configurations[:count]


@cache
def _middle_first(count: int) -> Array:
    """Shares of a line cut into ``count + 1`` parts, its middle first, shape (count, 1)."""
    order, spans = [], deque([(1, count)])
    while spans:
        first, last = spans.popleft()
        if first <= last:
            middle = (first + last) // 2
            order.append(middle)
            spans += [(first, middle - 1), (middle + 1, last)]
    return np.array(order, dtype=np.float64)[:, None] / (count + 1)
