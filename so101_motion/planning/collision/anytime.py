"""Prove that two arms keep apart wherever on its own way either of them is.

Nothing is known of when: each goes at its own pace, waits as long as it likes, and begins again. So
every configuration of the one is held against the whole way of the other. How that stays cheap: of
a piece of the first's way only the configuration in the middle is looked at, with as much more room
as the bodies travel from there to the ends of the piece. Is that not enough, its halves are.
"""

from __future__ import annotations

import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.apart import ROOM, are_apart
from so101_motion.planning.collision.arm_bodies import ArmBodies

SPACING = 0.008
"""How far any body travels at most from one configuration of a way to the next [m]. Chosen: less
than half the room between arms."""

_KEPT = 0.75
"""The share of its room that ``are_apart`` keeps between two looks."""


def evenly(bodies: ArmBodies, q: Array) -> Array:
    """Configurations of a way, ``SPACING`` apart.

    Args:
        bodies: The arm's.
        q: Joints and jaw, straight from one row to the next, shape (n, 6), [rad].

    Returns:
        Shape (m, 6), [rad], both ends included.
    """
    if len(q) == 1:
        return q
    passed = np.concatenate([[0.0], np.cumsum(bodies.travel(q).max(axis=1))])
    count = int(np.ceil(passed[-1] / SPACING - 1e-9)) + 1
    at = np.linspace(0.0, passed[-1], count)
    return np.column_stack([np.interp(at, passed, column) for column in q.T])


def never_meet(a: ArmBodies, b: ArmBodies, T: SE3, way_a: Array, way_b: Array) -> bool:
    """Whether two arms keep ``ROOM`` apart as plans do, whatever the time of either.

    Args:
        a: An arm's bodies.
        b: Another's.
        T: Where its base is in the first's.
        way_a: Where the first is, ``SPACING`` apart, as of ``evenly``, shape (n, 6), [rad].
        way_b: The same of the second, shape (m, 6).
    """
    way_b = np.ascontiguousarray(way_b)
    least = ROOM + SPACING / _KEPT  # half a step of either way

    def keeps_off(k: int, room: float) -> bool:
        stays = np.ascontiguousarray(np.broadcast_to(way_a[k], way_b.shape))
        return are_apart(a, b, T, stays, way_b, room=room)

    pieces = [(0, len(way_a) - 1)]
    while pieces:
        first, last = pieces.pop(0)
        middle = (first + last + 1) // 2
        if keeps_off(middle, least + (middle - first) * SPACING / _KEPT):
            continue
        if first == last or not keeps_off(middle, least):
            return False
        pieces += [(first, middle - 1)]
        if middle < last:
            pieces += [(middle + 1, last)]
    return True
