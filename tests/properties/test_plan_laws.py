"""Laws of every plan, whatever is asked."""

import numpy as np
import pytest
from harness.random_plans import (
    COLLISION,
    MODEL,
    PLANNER,
    free_configuration,
    jaws,
    plan_or_refusal,
    seeds,
)
from hypothesis import example, given, settings
from hypothesis import strategies as st

from so101_motion.common.errors import InCollision
from so101_motion.common.geometry import SE3
from so101_motion.planning.goals import JointGoal, LineGoal, PathGoal, PoseGoal
from so101_motion.planning.planner import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.verify import limit_report


@st.composite
def motion_limits(draw):
    velocity = draw(st.floats(0.3, 4.0))
    acceleration = draw(st.floats(1.0, 15.0))
    return MotionLimits.uniform(
        velocity=velocity, acceleration=acceleration, jerk=draw(st.floats(50.0, 1000.0))
    )


def assert_verified(plan, limits, q_jaw):
    motion = plan.trajectory
    report = limit_report(motion, limits, MODEL.lower, MODEL.upper)
    assert report.worst <= 1.002
    assert report.outside.max() <= 1e-6
    assert min(COLLISION.clearance(q, q_jaw).distance for q in motion.q) > 0.0
    assert not np.any(motion.qd[[0, -1]])


LAZY = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=50.0)


@given(seed=seeds, q_jaw=jaws, limits=motion_limits())
@example(seed=7139, q_jaw=0.0, limits=LAZY)  # around something: the ends differed in a last bit
@settings(max_examples=40)
def test_between_free_postures_there_is_a_verified_motion(seed, q_jaw, limits):
    rng = np.random.default_rng(seed)
    start, goal = free_configuration(rng, q_jaw), free_configuration(rng, q_jaw)
    plan = PLANNER.plan(
        PlanRequest(q_start=start, goal=JointGoal(q=goal), limits=limits, q_jaw=q_jaw)
    )
    assert_verified(plan, limits, q_jaw)
    assert np.array_equal(plan.trajectory.q[0], start)
    assert np.array_equal(plan.trajectory.q[-1], goal)


@given(seed=seeds, q_jaw=jaws, frame=st.sampled_from(["tool", "jaw_tip"]))
@settings(max_examples=40)
def test_every_point_that_a_free_posture_reaches_is_reached(seed, q_jaw, frame):
    rng = np.random.default_rng(seed)
    start, there = free_configuration(rng, q_jaw), free_configuration(rng, q_jaw)
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
    T = MODEL.frame(there, frame)
    goal = PoseGoal(T_base_tool=T, frame=frame)
    plan = PLANNER.plan(PlanRequest(q_start=start, goal=goal, limits=limits, q_jaw=q_jaw))
    assert_verified(plan, limits, q_jaw)
    assert np.linalg.norm(MODEL.frame(plan.q_goal, frame).p - T.p) <= 1e-4


@given(seed=seeds, count=st.integers(2, 6), tolerance=st.floats(0.0, 0.2))
@settings(max_examples=25)
def test_waypoints_are_passed_as_near_as_asked_or_refused(seed, count, tolerance):
    rng = np.random.default_rng(seed)
    start = free_configuration(rng, 0.0)
    waypoints = np.array([free_configuration(rng, 0.0) for _ in range(count)])
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
    goal = PathGoal(waypoints=waypoints, tolerance=tolerance)
    plan, refusal = plan_or_refusal(PlanRequest(q_start=start, goal=goal, limits=limits))
    if refusal:
        assert isinstance(refusal, InCollision)
        assert refusal.where == "path"
        corners = np.array([start, *waypoints])
        assert COLLISION.first_blocked(corners) is not None
        return
    assert_verified(plan, limits, 0.0)
    # A corner is cut by the tolerance; in between two samples the arm moves on by up to 0.03 rad.
    for waypoint in waypoints:
        nearest = np.abs(plan.trajectory.q - waypoint).max(axis=1).min()
        assert nearest <= tolerance + 0.04


@given(seed=seeds, length=st.floats(0.005, 0.15))
@example(seed=155735, length=0.03125)  # between two configurations the curve left a limit
@example(seed=1157, length=0.1094290691661624)  # likewise
@example(seed=7, length=0.0956388426576767)  # slowed down once, its jerk was still 1 % over
@settings(max_examples=40)
def test_a_line_is_followed_within_its_tolerance_or_refused_with_a_reason(seed, length):
    rng = np.random.default_rng(seed)
    start = free_configuration(rng, 0.0)
    direction = rng.standard_normal(3)
    path = length * direction / np.linalg.norm(direction)
    T = MODEL.frame(start)
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
    goal = LineGoal(T_base_tool=SE3(T.R, T.p + path))
    plan, refusal = plan_or_refusal(PlanRequest(q_start=start, goal=goal, limits=limits))
    if refusal:
        assert f"of the {length * 1e3:.0f} mm of the line" in str(refusal)
        return
    assert_verified(plan, limits, 0.0)
    offset = np.array([MODEL.frame(q).p for q in plan.trajectory.q]) - T.p
    along = offset @ path / (path @ path)
    assert np.linalg.norm(offset - np.outer(along, path), axis=1).max() <= 1e-4
    assert along[-1] == pytest.approx(1.0, abs=1e-4)
