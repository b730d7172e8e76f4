"""Numeric inverse kinematics: Newton steps on the model's Jacobian.

:func:`polish` removes the micrometres by which a model may differ from its closed form, and
:func:`minimise` finds the nearest reachable pose.
"""

from __future__ import annotations

from math import atan2

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.goals import GoalMetric
from so101_motion.planning.kinematics.ik_task import Task
from so101_motion.planning.kinematics.model import RobotModel

ANGLE_WEIGHT = 0.1
"""Weight of a radian of orientation error against metres of position error [m/rad]: about the lever
from wrist to jaw. Chosen."""

_STEPS = 100
_LONGEST_STEP = 0.5
_LEAST_DAMPING = 1e-6
_MOST_DAMPING = 1e3
_FLAT = 1e-8
"""A gradient below this is zero [m^2]: 0.1 um for a joint with a lever of 0.1 m, a microradian of
wrong orientation. Chosen."""

_UPPER, _ABOVE = np.triu(np.ones((5, 5))), np.triu(np.ones((5, 5)), 1)


def polish(model: RobotModel, q: Array, frame: str, p_base: Array) -> Array:
    """Move ``q`` by two least-motion Newton steps to a nearby point; shape (5,), in the limits."""
    for _ in range(2):
        error = p_base - model.rotation_and_position(q, frame)[1]
        J = model.frame_jacobian(q, frame)[:3]
        # The damping acts only at a straight elbow, where J has lost a direction.
        step = J.T @ np.linalg.solve(J @ J.T + 1e-9 * np.eye(3), error)
        q = np.clip(q + step, model.lower, model.upper)
    return q


def minimise(model: RobotModel, task: Task, q: Array) -> Array:
    """Minimise the distance from a task locally; returns ``q`` (5,) [rad] inside the limits.

    Newton's method with the curvature's absolute value, so that every step goes downhill; joints
    at a limit that would go further are left out.

    Source: Y. Dauphin et al., Identifying and attacking the saddle point problem, 2014, for the
        absolute value; J. Nocedal, S. Wright, Numerical Optimization, 2006, 16.7, for the limits.
    """
    lower, upper = model.lower, model.upper
    q = np.clip(q, lower, upper)
    value, gradient, H = half_square(model, task, q)
    damping = _LEAST_DAMPING
    for _ in range(_STEPS):
        free = ((q > lower) | (gradient < 0.0)) & ((q < upper) | (gradient > 0.0))
        gradient = np.where(free, gradient, 0.0)
        if np.abs(gradient).max() < _FLAT or damping > _MOST_DAMPING:
            break
        curvatures, V = np.linalg.eigh(H * np.outer(free, free))
        step = -V @ ((V.T @ gradient) / np.maximum(np.abs(curvatures), damping))
        step *= min(1.0, _LONGEST_STEP / np.abs(step).max())
        q_new = np.minimum(np.maximum(np.where(free, q + step, q), lower), upper)
        new = half_square(model, task, q_new)
        if new[0] < value:
            q, (value, gradient, H) = q_new, new
            damping = max(damping * 0.1, _LEAST_DAMPING)
        else:
            damping *= 10.0
    return q


def half_square(model: RobotModel, task: Task, q: Array) -> tuple[float, Array, Array]:
    """Half the squared residual [m^2], its gradient (5,) and its curvature (5, 5)."""
    error = task.p_base - model.rotation_and_position(q, task.frame)[1]
    J = model.frame_jacobian(q, task.frame)
    linear, axes = J[:3], J[3:]
    x, y, z = error
    # d2p / dq_i dq_j = axis_i x J_j for i <= j: joint i carries what joint j moves.
    second = axes.T @ np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]) @ linear
    H = linear.T @ linear - (_UPPER * second + (_ABOVE * second).T)
    value, gradient = 0.5 * float(error @ error), -linear.T @ error
    if task.metric is not GoalMetric.POSITION_ONLY:
        turn, turning = _missing_turn(model, task, q, axes)
        value += 0.5 * ANGLE_WEIGHT**2 * float(turn @ turn)
        gradient = gradient - ANGLE_WEIGHT**2 * turning.T @ turn
        H = H + ANGLE_WEIGHT**2 * turning.T @ turning
    return value, gradient, H


def _missing_turn(model: RobotModel, task: Task, q: Array, axes: Array) -> tuple[Array, Array]:
    """The rotation still missing, as a vector (3,) [rad], and its Jacobian."""
    R = model.rotation_and_position(q, "tool")[0]
    wanted = task.R_base_tool
    if task.metric is GoalMetric.POSITION_AND_APPROACH:
        axis = R[:, 2].copy()
        turn = np.cross(axis, wanted[:, 2])
        cosine = float(axis @ wanted[:, 2])
        turning = axes - np.outer(axis, axis @ axes)
    else:
        M = wanted @ R.T
        turn = 0.5 * np.array([M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]])
        cosine = 0.5 * (float(np.trace(M)) - 1.0)
        turning = axes
    sine = float(np.linalg.norm(turn))
    # Half a turn away the direction is not defined; no motion is as good as any.
    return (turn * (atan2(sine, cosine) / sine) if sine > 1e-12 else turn), turning
