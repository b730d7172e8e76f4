"""Prove that two arms on fixed paths keep apart at any timing of either.

Each arm may go at its own pace, wait, and begin again. So every configuration of one path is
checked against the whole path of the other. To keep that cheap, only the middle configuration of a
piece of the first path is checked, with as much more room as the bodies travel from there to the
ends of the piece. If that fails, the piece is halved.
"""

from __future__ import annotations

import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.apart import ROOM, are_apart
from so101_motion.planning.collision.arm_bodies import ArmBodies

SPACING = 0.008
"""Largest travel of any body from one configuration of a path to the next [m]. Chosen: less than
half the room between arms."""

_KEPT = 0.75
"""The share of its room that ``are_apart`` keeps between two checks."""


def evenly(bodies: ArmBodies, q: Array) -> Array:
    """Configurations of a path, ``SPACING`` apart.

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


def never_meet(a: ArmBodies, b: ArmBodies, T: SE3, q_a: Array, q_b: Array) -> bool:
    """Whether two arms keep ``ROOM`` apart, as plans do, at any timing of either.

    Args:
        a: An arm's bodies.
        b: Another's.
        T: The base of the second in the frame of the first's.
        q_a: Configurations of the first arm's path from ``evenly``, shape (n, 6), [rad].
        q_b: Those of the second arm's path, shape (m, 6).
    """
    q_b = np.ascontiguousarray(q_b)
    least = ROOM + SPACING / _KEPT  # half a step of either path

    def keeps_off(k: int, room: float) -> bool:
        stays = np.ascontiguousarray(np.broadcast_to(q_a[k], q_b.shape))
        return are_apart(a, b, T, stays, q_b, room=room)

    pieces = [(0, len(q_a) - 1)]
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
