"""Laws of kinematics and inverse kinematics, for any configuration inside the limits."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from so101_motion.common.errors import Unreachable
from so101_motion.common.geometry import SE3, rotation_angle
from so101_motion.planning.goals import GoalMetric, PoseGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel

MODEL = RobotModel.load().with_frame("cup", SE3.from_rpy((0.3, -0.2, 1.0), (0.02, -0.04, 0.12)))
SOLVER = IkSolver(MODEL)
DOWN = np.array([0.4, -0.35, 0.35, math.pi / 2, 1.0])

frames = st.sampled_from(["tool", "jaw_tip", "cup"])
metrics = st.sampled_from(GoalMetric)
# Hypothesis likes the ends of an interval: joints at their limits come up often.
inside = st.tuples(*(st.floats(low, high) for low, high in MODEL.limits)).map(np.array)
anywhere = st.tuples(*(st.floats(-7.0, 7.0) for _ in range(5))).map(np.array)
points = st.tuples(*(st.floats(-0.7, 0.7) for _ in range(3)))
rotations = st.tuples(*(st.floats(-math.pi, math.pi) for _ in range(3)))


def miss(goal, q):
    """How far a configuration is from a goal: position [m] and what counts of the turn [rad]."""
    reached = MODEL.frame(q, goal.frame)
    off = np.linalg.norm(reached.p - goal.T_base_tool.p)
    if goal.metric is GoalMetric.POSITION_ONLY:
        return off, 0.0
    turn = goal.T_base_tool.R.T @ reached.R
    if goal.metric is GoalMetric.FULL_POSE:
        return off, rotation_angle(turn)
    # The approach is the tool's, whichever frame the goal is about.
    R_frame_tool = MODEL.rotation_to_tool(goal.frame)
    turn = R_frame_tool.T @ turn @ R_frame_tool
    return off, math.atan2(math.hypot(turn[0, 2], turn[1, 2]), turn[2, 2])


def answer(goal, q_seed):
    """The solution or the refusal."""
    try:
        return SOLVER.solve(goal, q_seed)
    except Unreachable as error:
        return error


def assert_inside(q):
    assert np.all(q >= MODEL.lower)
    assert np.all(q <= MODEL.upper)


@settings(max_examples=60)
@given(q=inside, q_seed=anywhere, frame=frames, metric=metrics)
@example(q=DOWN, q_seed=np.zeros(5), frame="jaw_tip", metric=GoalMetric.FULL_POSE)
@example(q=DOWN, q_seed=np.zeros(5), frame="tool", metric=GoalMetric.POSITION_AND_APPROACH)
def test_ik_undoes_fk(q, q_seed, frame, metric):
    goal = PoseGoal(T_base_tool=MODEL.frame(q, frame), metric=metric, frame=frame)
    solution = SOLVER.solve(goal, q_seed)
    assert_inside(solution.q)
    off, turn = miss(goal, solution.q)
    assert off <= goal.position_tolerance
    assert turn <= (1e-6 if metric is GoalMetric.FULL_POSE else goal.approach_tolerance + 1e-9)
    assert solution.error_position == pytest.approx(off, abs=1e-9)
    assert solution.error_angle == pytest.approx(turn, abs=1e-7)


@settings(max_examples=60)
@given(p_base=points, rpy=rotations, q_seed=anywhere, frame=frames, metric=metrics)
def test_whatever_is_asked_the_answer_is_inside_and_true(p_base, rpy, q_seed, frame, metric):
    goal = PoseGoal(T_base_tool=SE3.from_rpy(rpy, p_base), metric=metric, frame=frame)
    found = answer(goal, q_seed)
    q = found.q_nearest if isinstance(found, Unreachable) else found.q
    assert_inside(q)
    off, turn = miss(goal, q)
    assert found.error_position == pytest.approx(off, abs=1e-9)
    assert found.error_angle == pytest.approx(turn, abs=1e-7)
    arrived = off <= goal.position_tolerance and turn <= goal.approach_tolerance + 1e-9
    assert arrived != isinstance(found, Unreachable)


@settings(max_examples=25)
@given(q=anywhere, frame=st.sampled_from(["tool", "jaw_tip", "wrist_link", "upper_arm_link"]))
def test_the_jacobian_is_the_derivative_of_the_pose(q, frame):
    J = MODEL.frame_jacobian(q, frame)
    R = MODEL.frame(q, frame).R
    h = 1e-6
    for i in range(5):
        step = h * np.eye(5)[i]
        ahead, behind = MODEL.frame(q + step, frame), MODEL.frame(q - step, frame)
        np.testing.assert_allclose(J[:3, i], (ahead.p - behind.p) / (2 * h), atol=1e-8)
        spin = (ahead.R - behind.R) / (2 * h) @ R.T
        turning = [spin[2, 1], spin[0, 2], spin[1, 0]]
        np.testing.assert_allclose(J[3:, i], turning, atol=1e-8)
