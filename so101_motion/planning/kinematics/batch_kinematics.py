"""Forward kinematics and Jacobians of a gripper frame for many configurations at once.

How it works. With all joints at zero each joint is an axis through a point, and the frame has some
pose. Turning the joints from the gripper inwards (roll first, pan last) turns the frame's point
about five fixed axes, one after the other: the product of exponentials. Vectors attached to the
point, such as its velocity, turn with it. Each turn is Rodrigues' formula with constant matrices,
so one pass of five turns serves any number of configurations, and costs about as much as ten of
them one by one.

The axes are taken from the kinematic model without assumptions: the results are the model's own, to
rounding, for any arm of five turning joints.

Source: R. W. Brockett, Robotic manipulators and the product of exponentials formula, 1984.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.kinematics.model import RobotModel

JOINT_LINKS = ("shoulder_link", "upper_arm_link", "lower_arm_link", "wrist_link", "gripper_link")
"""The links that the five joints carry; in a URDF a link's origin is on its joint's axis."""


class _Axis(NamedTuple):
    """One joint's axis, all joints at zero."""

    origin: Array  # a point on it, shape (3,), [m]
    cross: Array  # for a row vector v, ``v @ cross`` is the axis times v, shape (3, 3)
    cross_twice: Array  # ``cross @ cross``


class ArmChain:
    """Kinematics of one frame of the gripper, vectorised over configurations. Holds no state.

    Attributes:
        frame: The frame's name.
    """

    def __init__(self, model: RobotModel, frame: str = "tool") -> None:
        zero = np.zeros(5)
        at_zero = model.frame(zero, frame)
        self.frame = frame
        self._p, self._R = at_zero.p, at_zero.R
        self._axes = []
        for link, axis in zip(JOINT_LINKS, model.frame_jacobian(zero)[3:].T, strict=True):
            cross = np.cross(axis, np.eye(3))  # v @ cross is axis x v
            self._axes.append(_Axis(model.frame(zero, link).p, cross, cross @ cross))

    def positions(self, q: Array) -> Array:
        """Positions of the frame's origin, shape (n, 3), [m], for joint angles (n, 5) [rad]."""
        p = np.broadcast_to(self._p, (len(q), 3))
        for axis, sine, versine in self._turns(q):
            p = p - axis.origin
            p = p + sine * (p @ axis.cross) + versine * (p @ axis.cross_twice) + axis.origin
        return p

    def rotations(self, q: Array) -> Array:
        """Rotations of the frame, ``R_base_frame``, shape (n, 3, 3), for ``q`` (n, 5) [rad]."""
        columns = np.broadcast_to(self._R.T, (len(q), 3, 3))  # each column of R as a row
        for axis, sine, versine in self._turns(q):
            s, c = sine[..., None], versine[..., None]
            columns = columns + s * (columns @ axis.cross) + c * (columns @ axis.cross_twice)
        return columns.transpose(0, 2, 1)

    def positions_and_jacobians(self, q: Array) -> tuple[Array, Array]:
        """Positions (n, 3) [m] and their Jacobians, shape (n, 3, 5), [m/rad]."""
        # Six vectors for each configuration: the Jacobian's columns from the pan outwards, and the
        # point.
        rows = np.zeros((len(q), 6, 3))
        rows[:, 5] = self._p
        for i, (axis, sine, versine) in zip(range(4, -1, -1), self._turns(q), strict=True):
            rows[:, 5] -= axis.origin
            outer = rows[:, i + 1 :]
            crossed, crossed_twice = outer @ axis.cross, outer @ axis.cross_twice
            rows[:, i] = (1.0 - versine) * crossed[:, -1] + sine * crossed_twice[:, -1]
            outer += sine[..., None] * crossed + versine[..., None] * crossed_twice
            rows[:, 5] += axis.origin
        return rows[:, 5].copy(), rows[:, :5].transpose(0, 2, 1)

    def speeds(self, q: Array, qd: Array) -> Array:
        """Speeds of the frame's origin, shape (n,), [m/s], for ``q`` and ``qd`` (n, 5)."""
        p, v = np.broadcast_to(self._p, (len(q), 3)), np.zeros((len(q), 3))
        for i, (axis, sine, versine) in zip(range(4, -1, -1), self._turns(q), strict=True):
            p = p - axis.origin
            crossed, crossed_twice = p @ axis.cross, p @ axis.cross_twice
            v = v + sine * (v @ axis.cross) + versine * (v @ axis.cross_twice)
            v += qd[:, i, None] * ((1.0 - versine) * crossed + sine * crossed_twice)
            p = p + sine * crossed + versine * crossed_twice + axis.origin
        return np.asarray(np.sqrt(np.einsum("ij,ij->i", v, v)))

    def _turns(self, q: Array) -> list[tuple[_Axis, Array, Array]]:
        """The axes from the gripper inwards, with sine and 1 - cosine of their angles (n, 1)."""
        sine, versine = np.sin(q), 1.0 - np.cos(q)
        return [(self._axes[i], sine[:, i, None], versine[:, i, None]) for i in range(4, -1, -1)]
