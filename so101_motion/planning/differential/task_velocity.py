"""Convert a twist, a pose or a point to follow into joint velocities.

Position comes first, orientation as far as five joints can. Near a singular configuration,
directions that would need unbounded speeds are damped.

A twist is integrated to a reference pose to which the frame is pulled back, so that a long straight
jog stays straight. The reference moves on by the granted share of the twist, and starts anew where
an obstacle turns the frame aside. A pose or a point is approached as fast as the joints can still
come to rest there.

Source: Y. Nakamura, H. Hanafusa, Inverse Kinematic Solutions With Singularity Robustness for Robot
Manipulator Control, 1986, for the damping.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import SE3, Array, rotation_by, rotation_vector
from so101_motion.planning.differential.targets import Target, Twist
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits

DAMPING = 0.01
"""Damping [m/rad]: a direction with this gain of the frame per joint motion is followed at half
speed, one with three times that at nine tenths. Chosen: a quarter of all configurations have a gain
below 0.035; a tool that passes full stretch at 0.05 m/s needs at most 2.5 rad/s of the joints."""

CLOSING = 0.1  # damping near a pose, as a share of its distance
EASE = 0.2  # damping of rotation by joint motions that leave the position alone [rad/rad]. Chosen
LOST = 0.1  # share of speed lost to damping that is reported; chosen
PULL = 5.0  # gain with which the frame is pulled back to its reference [1/s]. Chosen
SLACK = (0.005, 0.1)  # largest distance of the reference from the frame [m], [rad]. Chosen
BRAKING = 0.8  # share of the acceleration used to arrive at a pose; chosen
FAR = (0.1, 0.5)  # farther poses count as this far [m], [rad]; chosen: nearly linear
SPARED = 0.15  # joints nearer to a limit move less [rad]; chosen
SAME = 1e-9  # joint angles closer than this count as equal [rad]


class TaskVelocity(NamedTuple):
    """Joint velocities for a target."""

    qd: Array  # joint velocities, shape (5,), [rad/s]; zero to come to rest
    J: Array  # jacobian of the moved frame, shape (6, 5)
    is_damped: bool  # whether damping near a singular configuration took much of the speed


class TaskControl:
    """Turns targets into task velocities of ``frame``; ``grant`` reports how much was possible."""

    def __init__(self, model: RobotModel, limits: MotionLimits, dt: float, frame: str) -> None:
        self._model, self._dt, self._frame = model, dt, frame
        self._bend, self._top = BRAKING * limits.acceleration, limits.velocity
        self._twist: Twist | None = None
        self._R, self._p = np.eye(3), np.zeros(3)  # the reference of a twist

    def velocity(self, target: Target, q: Array, below: Array, above: Array) -> TaskVelocity:
        """The task velocity at ``q``; ``below`` and ``above`` (5,) are the joints' room [rad]."""
        J = self._model.frame_jacobian(q, self._frame)
        R, p = self._model.rotation_and_position(q, self._frame)
        if isinstance(target, Twist):
            return self._follow(target, J, R, p)
        self._twist = None
        turn = None
        if isinstance(target, SE3):
            turn, target = _cut(rotation_vector(target.R @ R.T), FAR[1]), target.p
        off = _cut(target - p, FAR[0])
        damping = CLOSING * _length(off)
        dq, _ = _least_squares(J, off, turn, damping)
        # The other joints take over from a joint near its limit, if they can.
        ease = np.clip(np.where(dq > 0.0, above, below) / SPARED, 1e-3, 1.0)
        if (ease < 1.0).any():
            dq = ease * _least_squares(J * ease, off, turn, damping)[0]
        return TaskVelocity(self._approach(dq), J, False)

    def grant(self, share: float) -> None:
        """Move the reference on by the granted share of the last task velocity."""
        if self._twist is not None:
            rate = self._twist.in_base(self._R) * (share * self._dt)
            self._p = self._p + rate[:3]
            if self._twist.angular.any():
                self._R = rotation_by(rate[3:]) @ self._R

    def refuse(self) -> None:
        """Start the reference anew, because the frame goes elsewhere."""
        self._twist = None

    def _follow(self, twist: Twist, J: Array, R: Array, p: Array) -> TaskVelocity:
        if twist is not self._twist:
            self._twist, self._R, self._p = twist, R.copy(), p.copy()
        rate = twist.in_base(R)
        if not any(rate.tolist()):
            return TaskVelocity(np.zeros(5), J, False)
        ahead, turn = self._p - p, rotation_vector(self._R @ R.T)
        if _length(ahead) > SLACK[0]:
            ahead = _cut(ahead, SLACK[0])
            self._p = p + ahead
        if _length(turn) > SLACK[1]:
            turn = _cut(turn, SLACK[1])
            self._R = rotation_by(turn) @ R
        linear, angular = rate[:3] + PULL * ahead, rate[3:] + PULL * turn
        qd, is_damped = _least_squares(J, linear, angular, DAMPING)
        return TaskVelocity(qd, J, is_damped)

    def _approach(self, dq: Array) -> Array:
        """Joint velocities along ``dq`` [rad] that can come to rest at its end."""
        distance, bend = np.abs(dq), self._bend
        if distance.max() < SAME:
            return np.zeros(5)
        # In steps of dt, from this speed on, the joint stops within its path.
        braking = bend * (np.sqrt(self._dt**2 + 2.0 * distance / bend) - self._dt)
        fastest = np.minimum(braking, self._top)
        moves = distance > SAME
        return np.asarray(dq * (fastest[moves] / distance[moves]).min())


def _least_squares(
    J: Array, linear: Array, angular: Array | None, damping: float
) -> tuple[Array, bool]:
    """Joint velocities for a rate of the frame, and whether damping takes much of its speed.

    The position comes first; the joint motions that leave it alone serve the orientation.
    ``damping`` acts on directions in which the frame hardly moves [m/rad].
    """
    left, gains, right = np.linalg.svd(J[:3])
    softened = gains + (damping * damping) / (gains + 1e-9)
    along = left.T @ linear
    qd = (along / softened) @ right[:3]
    # Far from singular configurations, damping takes nothing worth reporting.
    is_lost = bool(softened[2] * (1.0 - LOST) > gains[2]) and (
        _length(along * (1.0 - gains / softened)) > LOST * _length(linear)
    )
    if angular is not None:
        free = right[3:]  # joint directions that leave the position alone
        turning = J[3:] @ free.T
        (a, b), (_, c) = (turning.T @ turning).tolist()
        y0, y1 = (turning.T @ (angular - J[3:] @ qd)).tolist()
        a, c = a + EASE * EASE, c + EASE * EASE
        scale = 1.0 / (a * c - b * b)
        qd = qd + np.array([(c * y0 - b * y1) * scale, (a * y1 - b * y0) * scale]) @ free
    return qd, is_lost


def _length(vector: Array) -> float:
    return math.sqrt(float(vector @ vector))


def _cut(vector: Array, longest: float) -> Array:
    """A vector, shortened to ``longest`` if it is longer."""
    length = _length(vector)
    return vector if length <= longest else vector * (longest / length)
