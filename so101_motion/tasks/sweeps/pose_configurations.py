"""Find the arm's configurations for a pose with tolerances, in closed form."""

from __future__ import annotations

import math

import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.kinematics.batch_ik import (
    angles_between,
    configurations,
    facing,
    facing_turned,
    hands,
    pitch_towards,
    roll_for,
)
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.sweeps.placement_task import TaskPose

MOST = 24
"""How many configurations of a pose are kept, evenly spread. Chosen."""

_PITCHES: Array = 2.0 * math.pi / 16 * np.arange(-8.0, 8.0)
"""Pitches that are tried if only the point counts [rad]. Chosen."""

_ROLLS = np.radians([-90.0, 0.0, 90.0])
"""Rolls that are tried if the rotation about the approach is free [rad]. Chosen."""

_SHARES = (-0.9, 0.0, 0.9)
"""Tilts of the approach that are tried, as shares of its tolerance. Chosen."""

_EXACT = 1e-5
"""A configuration whose frame is farther off its point is dropped [m]."""


class PoseConfigurations:
    """Finds configurations for one arm.

    Args:
        model: The arm.
        frame: The frame that is brought to the points: ``"tool"`` or ``"jaw_tip"``.
    """

    def __init__(self, model: RobotModel, frame: str = "tool") -> None:
        self._structure, self._frame = IkSolver(model).structure, frame
        self._tool, self._point = ArmChain(model), ArmChain(model, frame)

    def at(self, pose: TaskPose, T_base_cell: SE3) -> Array:
        """Configurations that bring the frame to a pose, shape (n, 5), [rad], within the limits.

        Args:
            pose: The pose in the cell.
            T_base_cell: Pose of the cell in the base frame.
        """
        p = T_base_cell @ pose.p
        if not self._is_near(p):
            return np.empty((0, 5))
        if pose.R is None:
            return _spread(self._fanned(p, _PITCHES))
        R = T_base_cell.R @ pose.R
        if pose.roll_tolerance is None:
            found = self._approaching(p, R[:, 2], pose.approach_tolerance)
        else:
            found = self._turned(p, R)
        turned = self._tool.rotations(found)
        good = np.linalg.norm(self._point.positions(found) - p, axis=1) <= _EXACT
        good &= angles_between(turned[:, :, 2], R[:, 2]) <= pose.approach_tolerance
        if pose.roll_tolerance is not None:
            off = R.T @ turned
            roll = np.arctan2(off[:, 1, 0] - off[:, 0, 1], off[:, 0, 0] + off[:, 1, 1])
            good &= np.abs(roll) <= pose.roll_tolerance + 1e-9
        return _spread(found[good])

    def _is_near(self, p: Array) -> bool:
        """Whether the arm is long enough for a point, whatever its joints."""
        m = self._structure.measures
        x, y, z = p.tolist()
        out = math.hypot(x - m.pan[0], y - m.pan[1]) - abs(m.shoulder[0])
        return math.hypot(max(out, 0.0), z - m.shoulder[1]) < self._structure.longest(self._frame)

    def _fanned(self, p: Array, pitches: Array) -> Array:
        """Configurations at a point, with given pitches [rad] and no roll."""
        pitch, roll = pitches[None, None], np.zeros((1, 1, len(pitches)))
        hand = hands(self._structure, self._frame, roll)
        target = facing(self._structure, p[None], hand.lateral)
        found = configurations(self._structure, target, hand, pitch, roll)
        return found.q[found.excess <= 0.0]

    def _approaching(self, p: Array, axis: Array, tolerance: float) -> Array:
        """Configurations at a point, with the approach near an axis and a few rolls."""
        roll = np.tile(_ROLLS, len(_SHARES))[None, None]
        tilt = np.repeat(tolerance * np.array(_SHARES), len(_ROLLS))[None, None]
        hand = hands(self._structure, self._frame, roll)
        target = facing(self._structure, p[None], hand.lateral)
        pitch = pitch_towards(self._structure, target.pan, axis[None]) + tilt
        found = configurations(self._structure, target, hand, pitch, roll)
        return found.q[found.excess <= 0.0]

    def _turned(self, p: Array, R: Array) -> Array:
        """Configurations at a point, with the orientation as near as five joints can."""
        target, pitch = facing_turned(self._structure, self._frame, p[None], R[None], 0.0)
        roll = roll_for(self._structure, target.pan, pitch, R[None])
        hand = hands(self._structure, self._frame, roll)
        found = configurations(self._structure, target, hand, pitch, roll)
        return found.q[found.excess <= 0.0]


def _spread(q: Array) -> Array:
    """At most ``MOST`` of them."""
    if len(q) <= MOST:
        return q
    return np.asarray(q[np.linspace(0, len(q) - 1, MOST).round().astype(int)])
