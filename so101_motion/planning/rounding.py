"""How far each corner of a path may be rounded.

A corner that has room is cut widely, so that the arm keeps its speed; one beside an obstacle less,
and where even that is blocked the arm stops. So one narrow place does not slow a whole motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

from so101_motion.geometry import Array
from so101_motion.planning.path_geometry import JointPath, blended_path

SMALLER = 0.35
"""By how much less a blocked corner is cut next. Chosen: three sizes between 0.1 and 0.01 rad."""

PER_CORNER = 12
"""Postures of a rounded corner that are looked at."""


def roomy_corners(
    waypoints: Array, tolerance: float, narrowest: float, is_free: Callable[[Array], bool]
) -> Array:
    """How far each joint may leave the polyline at each of its corners.

    Args:
        waypoints: Corners and ends, no two following ones equal, shape (m, 5), m >= 3, [rad].
        tolerance: The most anywhere [rad].
        narrowest: The least that is worth rounding [rad].
        is_free: Whether a posture, shape (5,), [rad], is free.

    Returns:
        Shape (m - 2,), [rad]; 0 where the arm has to stop.
    """
    tolerances = np.full(len(waypoints) - 2, tolerance)
    tight = list(range(len(tolerances)))
    while tight:
        path = blended_path(waypoints, np.maximum(tolerances, narrowest))
        tight = [k for k in tight if not all(map(is_free, _corner(path, k)))]
        tolerances[tight] *= SMALLER
        tolerances[tolerances < narrowest] = 0.0
        tight = [k for k in tight if tolerances[k] > 0.0]
    return tolerances


def _corner(path: JointPath, k: int) -> Array:
    """Postures on the rounding of corner ``k``, shape (n, 5), [rad]; none if it is straight."""
    bent = np.flatnonzero(np.any(path.coefficients[:, 2] != 0.0, axis=1))
    if k >= len(bent):
        return np.empty((0, path.n))
    piece = int(bent[k])
    length = float(path.knots[piece + 1] - path.knots[piece])
    return path.on_pieces(piece, length * np.linspace(0.0, 1.0, PER_CORNER)).q


def between_stops(waypoints: Array, tolerances: Array) -> Iterator[tuple[Array, Array]]:
    """The parts of a polyline between the corners at which the arm stops.

    Args:
        waypoints: Corners and ends, shape (m, 5), [rad].
        tolerances: How far each corner is cut, shape (m - 2,), [rad].

    Yields:
        The waypoints of each part, and how far its own corners are cut.
    """
    stops = [0, *(1 + np.flatnonzero(tolerances == 0.0)), len(waypoints) - 1]
    for begin, end in pairwise(stops):
        yield waypoints[begin : end + 1], tolerances[begin : end - 1]
