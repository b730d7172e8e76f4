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

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array

WIDER = (0.012, 0.048)
"""Clearances beyond the margins that a proof asks for [m]. Chosen with the next: of nine sets, none
was faster on the paths of four scenes, and equally fast ones had more clearances."""

CUT = 4  # a part that is not clear is cut into so many parts

Touches = Callable[[Array], bool]
"""Whether any pair is too close at a configuration of all six joints, shape (6,), [rad]."""


class Level(NamedTuple):
    """A check of configurations."""

    clearance: float  # distance that all pairs keep if the check finds none too close [m]
    touches: Touches  # the check itself
    # distances that it demands of pairs of links and of all other pairs [m]
    margins: tuple[float, float] = (0.0, 0.0)


def travel(reach: Array, points: Array) -> Array:
    """Like :meth:`CollisionModel.travel`, for ``points`` (n, 5); ``reach`` (5,), per joint, [m]."""
    steps: Array = np.abs(np.diff(points, axis=0)) @ reach
    return np.concatenate(([0.0], np.cumsum(steps)))
