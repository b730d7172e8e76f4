"""Whether a motion of the joints touches anything: a proof, and a quicker look.

Both rest on *travel*. No point of the arm moves further along a joint motion than the joint angles
passed, each times the distance of the furthest point from that joint's axis.

*The proof.* If all pairs of bodies keep ``c`` apart at some posture, nothing touches within ``c``
of travel before and after it. So a motion is cut into parts, each with a posture in its middle that
has to clear half the part's travel. What fails is cut into smaller parts, down to those that the
margins themselves clear. Far from everything a few postures clear a whole move; what comes out is
that the bodies keep at least their margins at every smallest part looked at, and never touch in
between.

*The look.* The margins at postures that are some way of travel apart. It costs a third of a proof
near obstacles, and misses little: the search for a path looks, and what it finds is proven.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import cache
from math import ceil
from typing import NamedTuple

import numpy as np

from so101_motion.geometry import Array

WIDER = (0.012, 0.048)
"""Clearances beyond the margins that a proof asks for [m]. Chosen with the next: of nine sets, none
was faster on the paths of four scenes, and the ones as fast had more clearances."""

CUT = 4
"""Into so many parts a part is cut that is not clear."""

Touches = Callable[[Array], bool]
"""Whether any pair is too close at a posture of all six joints, shape (6,), [rad]."""


class Level(NamedTuple):
    """A check of postures.

    Attributes:
        clearance: What all pairs keep apart, at least, if it does not find one too close [m].
        touches: The check itself.
    """

    clearance: float
    touches: Touches


def travel(reach: Array, points: Array) -> Array:
    """A bound on how far any point of the arm moves along a polyline.

    Args:
        reach: For each joint, how far from its axis the arm can be, shape (5,), [m].
        points: Joint angles, shape (n, 5), [rad].

    Returns:
        Accumulated from the first point, shape (n,), [m].
    """
    steps: Array = np.abs(np.diff(points, axis=0)) @ reach
    return np.concatenate(([0.0], np.cumsum(steps)))


def blocked_posture(
    levels: Sequence[Level], reach: Array, points: Array, q_jaw: float
) -> Array | None:
    """A posture on the straight lines through ``points`` that is too close, or None, a proof.

    Args:
        levels: From the margins themselves to the widest clearance.
        reach: As for ``travel``.
        points: Joint angles, shape (n, 5), n >= 1, [rad].
        q_jaw: Jaw angle [rad].
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
        postures = _postures(points, travelled, middles, q_jaw)
        touches = levels[k].touches
        failed = [i for i, posture in enumerate(postures) if touches(posture)]
        if not failed:
            return None
        if k == 0:
            return np.array(postures[failed[0], :5])
        if k == len(levels) - 1:
            # Most of what is blocked is seen here already.
            for i in failed:
                if levels[0].touches(postures[i]):
                    return np.array(postures[i, :5])
        half /= CUT
        middles = (middles[failed, None] + half * np.arange(1 - CUT, CUT, 2)).ravel()


def _postures(points: Array, travelled: Array, at: Array, q_jaw: float) -> Array:
    """The postures after some travel along a polyline, all six joints, shape (len(at), 6)."""
    postures = np.empty((len(at), 6))
    postures[:, 5] = q_jaw
    if len(points) == 2 and travelled[-1] > 0.0:
        postures[:, :5] = points[0] + (at / travelled[-1])[:, None] * (points[1] - points[0])
        return postures
    k = np.minimum(np.searchsorted(travelled, at, "right"), len(points) - 1)
    before = np.maximum(k - 1, 0)
    length = travelled[k] - travelled[before]
    part = (at - travelled[before]) / np.where(length > 0.0, length, 1.0)
    postures[:, :5] = points[before] + part[:, None] * (points[k] - points[before])
    return postures


class Sight:
    """Looks at postures, and at straight joint lines between them: quick, and no proof.

    Args:
        touches: The check of a posture.
        reach: As for ``travel``.
        q_jaw: Jaw angle [rad].
        spacing: Travel between the postures that are looked at on a line, at most [m].
    """

    def __init__(self, touches: Touches, reach: Array, *, q_jaw: float, spacing: float) -> None:
        self._touches, self._reach, self._spacing = touches, reach, spacing
        self._postures = np.full((64, 6), q_jaw)

    def is_free(self, q: Array) -> bool:
        """Whether nothing is too close at joint angles ``q``, shape (5,), [rad]."""
        posture = self._postures[0]
        posture[:5] = q
        return not self._touches(posture)

    def first_free(self, postures: Array) -> int | None:
        """The first of several postures, shape (n, 5), [rad], that is free, None if none is."""
        looked_at = self._room_for(len(postures))
        looked_at[:, :5] = postures
        touches = self._touches
        return next((k for k, posture in enumerate(looked_at) if not touches(posture)), None)

    def sees(self, q_from: Array, q_to: Array) -> bool:
        """Whether nothing is seen between two postures, themselves not looked at."""
        way = q_to - q_from
        count = int(np.abs(way) @ self._reach / self._spacing)
        postures = self._room_for(count)
        np.multiply(_middle_first(count), way, out=postures[:, :5])
        postures[:, :5] += q_from
        return not any(map(self._touches, postures))

    def _room_for(self, count: int) -> Array:
        """Postures of all six joints, the jaw's angle set, shape (count, 6)."""
        if count > len(self._postures):
            self._postures = np.full((2 * count, 6), self._postures[0, 5])
        return self._postures[:count]


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
