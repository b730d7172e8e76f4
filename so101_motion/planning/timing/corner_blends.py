"""Choose how far each corner of a path is rounded.

A corner with enough room is cut widely, so that the arm keeps its speed; a corner beside an
obstacle less, and if even that is blocked the arm stops there. So one narrow place does not slow a
whole motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.timing.path_geometry import JointPath, blended_path

SMALLER = 0.35
"""Factor by which a blocked corner is cut less. Chosen: three sizes between 0.1 and 0.01 rad."""

PER_CORNER = 12
"""Number of configurations of a rounded corner that are checked."""


def roomy_corners(
    waypoints: Array, tolerance: float, narrowest: float, is_free: Callable[[Array], bool]
) -> Array:
    """How far a joint may leave a polyline (m, 5) at its corners, (m - 2,) [rad]; 0 for a stop.

    ``tolerance`` is the largest and ``narrowest`` the smallest that is tried [rad]; ``is_free``
    checks single configurations (5,) on the rounded corner.
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
    """Configurations on the blend of corner ``k``, shape (n, 5), [rad]; none if it is straight."""
    bent = np.flatnonzero(np.any(path.coefficients[:, 2] != 0.0, axis=1))
    if k >= len(bent):
        return np.empty((0, path.n))
    piece = int(bent[k])
    length = float(path.knots[piece + 1] - path.knots[piece])
    return path.on_pieces(piece, length * np.linspace(0.0, 1.0, PER_CORNER)).q


def between_stops(waypoints: Array, tolerances: Array) -> Iterator[tuple[Array, Array]]:
    """The parts (k, 5) of a polyline between stops, with the cuts of their corners, (k - 2,)."""
    stops = [0, *(1 + np.flatnonzero(tolerances == 0.0)), len(waypoints) - 1]
    for begin, end in pairwise(stops):
        yield waypoints[begin : end + 1], tolerances[begin : end - 1]
