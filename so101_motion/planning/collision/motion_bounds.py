"""Upper bounds on the distance of moved points from the axis of each joint.

They are computed from the gripper back to the base: the parts that the next joint carries stay in a
ball around that joint, whatever its angle, and the link between offsets that ball from this joint's
axis. The jaw does not move during a motion, so its angle is known. ``continuous_check.py`` proves
motions free with these bounds.

Source: F. Schwarzer, M. Saha, J.-C. Latombe, Adaptive Dynamic Collision Checking for Single and
Multiple Articulated Robots in Complex Environments, IEEE T-RO 2005.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import SE3, Array, frozen_array, rot_z


class _Extent(NamedTuple):
    """How far points are from a joint: from its axis, and from its origin [m]."""

    across: float
    around: float


class MotionBounds:
    """Bounds for one arm with the objects it holds.

    Args:
        offsets: Pose of each joint of the arm in the frame of the one before, ``T_before_joint``,
            and last that of the jaw.
        points: For each joint of the arm and for the jaw, points whose hull contains the parts on
            it, in its frame, shape (n, 3), [m].

    Attributes:
        longest: For each joint of the arm, the bound whatever the jaw does, shape (5,), [m].
    """

    def __init__(self, offsets: Sequence[SE3], points: Sequence[Array]) -> None:
        self._offsets = [offset.p for offset in offsets]
        self._own = [_extent(each) for each in points[:-1]]
        self._hand, self._jaw, self._T_hand_jaw = points[-2], points[-1], offsets[-1]
        around_jaw = float(np.linalg.norm(self._T_hand_jaw.p)) + _extent(self._jaw).around
        self.longest = self._chained(_Extent(around_jaw, around_jaw))
        self.at = lru_cache(maxsize=8)(self._at)

    def _at(self, q_jaw: float) -> Array:
        """The bound for each joint of the arm with the jaw at ``q_jaw`` [rad], shape (5,), [m]."""
        return self._chained(_extent(self._T_hand_jaw @ (self._jaw @ rot_z(q_jaw).T)))

    def _chained(self, jaw: _Extent) -> Array:
        last = len(self._own) - 1
        hand = self._own[last]
        levers = np.zeros(len(self._own))
        levers[last], ball = max(hand.across, jaw.across), max(hand.around, jaw.around)
        for joint in range(last - 1, -1, -1):
            own, offset = self._own[joint], self._offsets[joint + 1]
            levers[joint] = max(own.across, float(np.linalg.norm(offset[:2])) + ball)
            ball = max(own.around, float(np.linalg.norm(offset)) + ball)
        return frozen_array(levers)


def _extent(points: Array) -> _Extent:
    return _Extent(
        float(np.linalg.norm(points[:, :2], axis=1).max()),
        float(np.linalg.norm(points, axis=1).max()),
    )
