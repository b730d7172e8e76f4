"""Limit the speed of several arms on a common path where they are near each other.

A proof asks for more room where both arms are fast (``apart.py``). A path that leaves less room is
slowed down there, instead of everywhere. The result will probably pass the proof; it is not one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.apart import EARLY, ROOM, distances
from so101_motion.planning.collision.arm_bodies import ArmBodies
from so101_motion.planning.timing.path_geometry import JointPath

LOOKS = 64
"""Number of places of a path at which distances are measured; chosen, a millisecond."""

FAR = 0.3
"""Bodies further apart than this limit no speed [m]; chosen."""

SHARE = 0.8
"""Share of the spare room that may be used; chosen: between two places there may be less."""

SLOWEST = 0.02
"""Lowest limit of a speed [m/s]; chosen."""


class PacedArm(NamedTuple):
    """An arm on a common path.

    Attributes:
        bodies: Its bodies, with those it holds.
        T_cell_base: Pose of its base.
        q_jaw: Its jaw angle [rad].
    """

    bodies: ArmBodies
    T_cell_base: SE3
    q_jaw: float


def pace_on(path: JointPath, arms: Sequence[PacedArm]) -> Callable[[Array, Array], Array] | None:
    """Make a function for the speed of arms on a path, as a share of what will probably be proven.

    Args:
        path: Path of all joints, five for each arm.
        arms: The arms in the order of their joints.

    Returns:
        A function from joint angles (m, n) on the path and their rates (m, n) to that share, (m,);
        None if arms come so near to each other that they could not move at all.
    """
    places = path.evaluate(np.linspace(0.0, path.length, LOOKS)).q
    q = [
        np.column_stack([places[:, 5 * k : 5 * k + 5], np.full(LOOKS, each.q_jaw)])
        for k, each in enumerate(arms)
    ]
    allowed = []
    for i, j in combinations(range(len(arms)), 2):
        T = arms[i].T_cell_base.inverse @ arms[j].T_cell_base
        near = distances(arms[i].bodies, arms[j].bodies, T, q[i], q[j], need=ROOM, enough=FAR)
        room = near - ROOM
        if room.min() <= 0.0:
            return None
        allowed.append((i, j, np.maximum(SHARE * room / EARLY, SLOWEST)))
    square = np.sum(places**2, axis=1)

    def pace(q: Array, qd: Array) -> Array:
        k = np.argmin(square - 2.0 * q @ places.T, axis=1)  # the nearest
        fast = [
            np.abs(qd[:, 5 * i : 5 * i + 5]) @ each.bodies.levers[:, :5].T
            for i, each in enumerate(arms)
        ]
        shares = [
            (np.minimum(fast[i][:, :, None], fast[j][:, None]) / most[k]).max(axis=(1, 2))
            for i, j, most in allowed
        ]
        return np.asarray(np.max(shares, axis=0))

    return pace
