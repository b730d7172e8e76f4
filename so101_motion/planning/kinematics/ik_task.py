"""The checked goal and the judged solution of inverse kinematics, and Newton steps between them.

The kinematic model judges every solution, whatever formula it comes from. :func:`minimise` removes
the micrometres by which a model may differ from its closed form, and finds the nearest reachable
pose.
"""

from __future__ import annotations

from math import atan2, hypot, isfinite, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array, rotation_angle
from so101_motion.common.state import ARM_JOINTS
from so101_motion.planning.goals import GoalMetric, PoseGoal
from so101_motion.planning.kinematics.arm_geometry import Joints, to_joints
from so101_motion.planning.kinematics.model import RobotModel

FULL_STRETCH = "full stretch"  # what limits an arm that would have to be longer
AT_LIMIT = 1e-6  # a joint this close to a limit is at it [rad]. Chosen
_BINDING = 0.05  # a limit with less than this share of the strongest limit's effect is not named
_NO_PULL = 1e-7  # a limit with a smaller effect [m^2] has none; above ``_FLAT``
_ALONG = 0.7  # cosine of error and arm above which it is stretched; seen are 1 and 0


class IkSolution(NamedTuple):
    """Joint angles that reach a goal, as judged by the kinematic model."""

    q: Array  # joint angles, shape (5,), inside the limits, read-only [rad]
    error_position: float  # distance from the goal's point [m]
    # orientation error [rad]: for a goal with an approach the angle between wanted and reached
    # approach axis, for a full pose the angle of rotation between wanted and reached pose; 0 where
    # the orientation does not count
    error_angle: float


class Task(NamedTuple):
    """A checked goal in the form that solvers need.

    Attributes:
        metric: How much of the pose counts.
        frame: The frame of the gripper that shall be at the point.
        point: The goal's position in the base frame [m].
        R_base_tool: Rotation of the *tool* when ``frame`` has the goal's rotation; shape (3, 3).
        The
            approach is its third column, whatever the goal's frame. Without meaning where only the
            position counts.
        position_tolerance: Largest position error that counts as arrived [m].
        angle_tolerance: Largest orientation error that counts as arrived [rad].
    """

    metric: GoalMetric
    frame: str
    point: tuple[float, float, float]
    R_base_tool: Array
    position_tolerance: float
    angle_tolerance: float

    @property
    def p_base(self) -> Array:
        """The point as an array, shape (3,), [m]."""
        return np.array(self.point)


def check_goal(model: RobotModel, goal: PoseGoal) -> Task:
    """Check a goal's frame and convert the goal to the form that solvers need."""
    model.check_gripper_frame(goal.frame)
    x, y, z = goal.T_base_tool.p.tolist()
    within, angle = goal.position_tolerance, goal.approach_tolerance
    metric = goal.metric if goal.cloud is None else GoalMetric.FULL_POSE
    R_base_tool = goal.T_base_tool.R
    if goal.frame != "tool" and metric is not GoalMetric.POSITION_ONLY:
        R_base_tool = R_base_tool @ model.rotation_to_tool(goal.frame)
    return Task(metric, goal.frame, (x, y, z), R_base_tool, within, angle)


def check_seed(q_seed: ArrayLike) -> Joints:
    """Check a seed, shape (5,), and return it as plain numbers [rad]. Limits do not matter."""
    q = np.asarray(q_seed, dtype=np.float64)
    if q.shape == (5,):
        joints = to_joints(q)
        if isfinite(sum(joints)):
            return joints
    raise ConfigError("q_seed", q_seed, "must be five finite joint angles [rad]")


def judge(model: RobotModel, task: Task, joints: Joints) -> IkSolution:
    """Clamp joint angles to the limits, and measure the errors with the model."""
    pairs = zip(joints, model.limits, strict=True)
    q = np.array([min(max(angle, lower), upper) for angle, (lower, upper) in pairs])
    q.setflags(write=False)
    x, y, z = model.rotation_and_position(q, task.frame)[1].tolist()
    goal_x, goal_y, goal_z = task.point
    off, turned = hypot(x - goal_x, y - goal_y, z - goal_z), orientation_error(model, task, q)
    return IkSolution(q, off, turned)


def orientation_error(model: RobotModel, task: Task, q: Array) -> float:
    """The orientation error at given joint angles [rad]."""
    if task.metric is GoalMetric.POSITION_ONLY:
        return 0.0
    R = model.rotation_and_position(q, "tool")[0]
    if task.metric is GoalMetric.FULL_POSE:
        return rotation_angle(R.T @ task.R_base_tool)
    return angle_between(R[:, 2].tolist(), task.R_base_tool[:, 2].tolist())


def angle_between(a: list[float], b: list[float]) -> float:
    """The angle between two unit vectors, 0 to pi [rad]; accurate near both ends."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return atan2(sqrt(x * x + y * y + z * z), a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def limit_name(i: int, direction: float) -> str:
    """The name of joint ``i``'s limit in a direction, for messages."""
    return f"{ARM_JOINTS[i]} at its {'lower' if direction < 0.0 else 'upper'} limit"


def binding_limit(model: RobotModel, task: Task, q: Array) -> str | None:
    """The names of the limits that keep the arm from the task's point; None if the arm is there.

    At the nearest point every joint that could bring it nearer is at a limit. These limits are
    named, the strongest first. If there are none, the arm is stretched out, or the point is closer
    to the pan axis than a frame that passes beside it can come.
    """
    error = task.p_base - model.rotation_and_position(q, task.frame)[1]
    if error @ error <= task.position_tolerance**2:
        return None
    pull = model.frame_jacobian(q, task.frame)[:3].T @ error
    held = [
        (abs(pull[i]), limit_name(i, pull[i]))
        for i in range(5)
        if (pull[i] > 0.0 and model.upper[i] - q[i] < AT_LIMIT)
        or (pull[i] < 0.0 and q[i] - model.lower[i] < AT_LIMIT)
    ]
    strongest = max((force for force, _ in held), default=0.0)
    names = [name for force, name in sorted(held, reverse=True) if force > _BINDING * strongest]
    if strongest > _NO_PULL:
        return " and ".join(names)
    outwards = model.frame(q, task.frame).p - model.frame(q, "upper_arm_link").p
    along = error @ outwards / (np.linalg.norm(error) * np.linalg.norm(outwards))
    return FULL_STRETCH if along > _ALONG else "the pan axis"


ANGLE_WEIGHT = 0.1  # of a radian against metres [m/rad]; chosen, from wrist to jaw
_STEPS = 100
_LONGEST_STEP = 0.5
_LEAST_DAMPING = 1e-9
_MOST_DAMPING = 1e3
_FLAT = 1e-9  # smaller gradients are zero [m^2]: 10 nm at 0.1 m; chosen

_UPPER, _ABOVE = np.triu(np.ones((5, 5))), np.triu(np.ones((5, 5)), 1)


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
