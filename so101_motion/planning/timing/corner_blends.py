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
from so101_motion.planning.timing.path_geometry import rounded_corners

SMALLER = 0.35
"""Factor by which a blocked corner is cut less. Chosen: three sizes between 0.1 and 0.01 rad."""

PER_CORNER = 12
"""Number of configurations of a rounded corner that are checked."""


def roomy_corners(
    waypoints: Array, tolerance: float, narrowest: float, touching: Callable[[Array], Array]
) -> Array:
    """How far a joint may leave a polyline (m, 5) at its corners, (m - 2,) [rad]; 0 for a stop.

    ``tolerance`` is the largest and ``narrowest`` the smallest that is tried [rad]; ``touching``
    tells which of several configurations (n, 5) touch something, (n,).
    """
    tolerances = np.full(len(waypoints) - 2, tolerance)
    tight = np.arange(len(tolerances))
    while len(tight):
        corners = rounded_corners(waypoints, np.maximum(tolerances, narrowest))
        tight = tight[corners.reach[tight] > 0.0]  # the others are straight
        q = corners.at(np.linspace(0.0, 1.0, PER_CORNER))[tight]
        blocked = touching(q.reshape(-1, q.shape[2])).reshape(-1, PER_CORNER).any(axis=1)
        tight = tight[blocked]
        tolerances[tight] *= SMALLER
        tolerances[tolerances < narrowest] = 0.0
        tight = tight[tolerances[tight] > 0.0]
    return tolerances


def between_stops(waypoints: Array, tolerances: Array) -> Iterator[tuple[Array, Array]]:
    """The parts (k, 5) of a polyline between stops, with the cuts of their corners, (k - 2,)."""
    stops = [0, *(1 + np.flatnonzero(tolerances == 0.0)), len(waypoints) - 1]
    for begin, end in pairwise(stops):
        yield waypoints[begin : end + 1], tolerances[begin : end - 1]
