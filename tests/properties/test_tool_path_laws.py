"""Laws of every planned tool path, whatever is asked."""

import numpy as np
import pytest
from harness.random_plans import (
    COLLISION,
    MODEL,
    PLANNER,
    free_configuration,
    plan_or_refusal,
    seeds,
)
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from so101_motion.common.errors import InCollision, PlanningError, Unreachable
from so101_motion.common.geometry import SE3, rotation_angle
from so101_motion.planning.cartesian.tool_path import path_through, straight_path
from so101_motion.planning.goals import ArcTo, GoalMetric, LineGoal, LineTo, ToolPathGoal
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.planner import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.verify import limit_report

CHAINS = {frame: ArmChain(MODEL, frame) for frame in ("tool", "jaw_tip")}
DT = 0.005

frames = st.sampled_from(sorted(CHAINS))
metrics = st.sampled_from(list(GoalMetric))


def limits_with(tool_speed):
    return MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=tool_speed)


def planned(start, goal, tool_speed=None):
    request = PlanRequest(q_start=start, goal=goal, limits=limits_with(tool_speed), dt=DT)
    return plan_or_refusal(request)


def step(rng, length):
    direction = rng.standard_normal(3)
    return length * direction / np.linalg.norm(direction)


def turned(rng, R, most):
    axis = rng.standard_normal(3)
    angle = most * rng.random()
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return (np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K) @ R


def random_path(rng, start, frame, metric, blend):
    """Two to four lines and arcs of a few centimetres."""
    T, segments = MODEL.frame(start, frame), []
    for _ in range(rng.integers(2, 5)):
        p_end = T.p + step(rng, rng.uniform(0.01, 0.05))
        R = T.R if metric is GoalMetric.POSITION_ONLY else turned(rng, T.R, 0.1)
        end = SE3(R, p_end)
        if rng.random() < 0.4:
            via = 0.5 * (T.p + p_end) + step(rng, 0.01)
            segments.append(ArcTo(T_base_tool=end, p_via=via))
        else:
            segments.append(LineTo(T_base_tool=end))
        T = end
    tolerance = np.radians(20.0) if metric is not GoalMetric.POSITION_ONLY else np.radians(5.0)
    return ToolPathGoal(
        segments=tuple(segments),
        blend=blend,
        metric=metric,
        frame=frame,
        orientation_tolerance=tolerance,
    )


def path_deviation(tool_path, p):
    """How far each point is from a path, looking along it in order."""
    s = np.linspace(0.0, tool_path.length, 4001)
    places = tool_path.places(s)
    nearest, off = 0, []
    for point in p:
        window = slice(max(nearest - 100, 0), nearest + 400)
        apart = np.linalg.norm(places[window] - point, axis=1)
        nearest = window.start + int(np.argmin(apart))
        off.append(apart.min())
    return np.array(off), s[1]


@given(seed=seeds, frame=frames, metric=metrics, blend=st.sampled_from([0.0, 0.004, 0.05]))
@settings(max_examples=40)
def test_a_path_is_followed_within_its_tolerances_or_refused_with_a_reason(
    seed, frame, metric, blend
):
    rng = np.random.default_rng(seed)
    start = free_configuration(rng)
    goal = random_path(rng, start, frame, metric, blend)
    plan, refusal = planned(start, goal)
    tool_path = path_through(MODEL.frame(start, frame), goal.segments, blend)
    if refusal:
        assert isinstance(refusal, Unreachable | InCollision)
        assert 0.0 <= refusal.fraction <= 1.0
        assert f"of the {tool_path.length * 1e3:.0f} mm of the path" in str(refusal)
        return
    motion = plan.trajectory
    assert limit_report(motion, limits_with(None), MODEL.lower, MODEL.upper).worst <= 1.002
    assert min(COLLISION.clearance(q).distance for q in motion.q[::5]) > 0.0
    off, spacing = path_deviation(tool_path, CHAINS[frame].positions(motion.q))
    assert off.max() <= np.hypot(goal.tolerance, spacing)
    assert plan.report.path_deviation.position <= goal.tolerance
    assert plan.report.path_deviation.angle <= goal.orientation_tolerance
    end = MODEL.frame(plan.q_goal, frame)
    assert np.linalg.norm(end.p - goal.segments[-1].T_base_tool.p) <= goal.tolerance
    if metric is GoalMetric.FULL_POSE:
        off_end = rotation_angle(end.R.T @ goal.segments[-1].T_base_tool.R)
        assert off_end <= goal.orientation_tolerance + 1e-9


@given(seed=seeds, blend=st.sampled_from([0.005, 0.02]), cap=st.floats(0.01, 0.3))
@settings(max_examples=25)
def test_a_rounded_path_moves_on_under_the_cap_of_the_tool(seed, blend, cap):
    rng = np.random.default_rng(seed)
    start = free_configuration(rng)
    goal = random_path(rng, start, "tool", GoalMetric.POSITION_ONLY, blend)
    plan, refusal = planned(start, goal, cap)
    assume(refusal is None)
    motion = plan.trajectory
    speed = CHAINS["tool"].speeds(motion.q, motion.qd)
    assert speed.max() <= cap * 1.002
    # The joints never rest before the end; the tool may, where the path turns back on itself.
    rate = np.abs(motion.qd).max(axis=1)
    assert rate[2:-3].min() > 0.0
    jumps = np.abs(np.diff(motion.qdd, axis=0)).max(axis=0)
    assert np.all(jumps <= 1.002 * limits_with(cap).jerk * DT)


@given(seed=seeds, metric=metrics)
@settings(max_examples=25)
def test_a_line_turns_the_tool_no_further_off_than_it_says(seed, metric):
    rng = np.random.default_rng(seed)
    start = free_configuration(rng)
    T = MODEL.frame(start)
    end = SE3(turned(rng, T.R, 0.3), T.p + step(rng, 0.04))
    tolerance = np.radians(rng.uniform(3.0, 25.0))
    goal = LineGoal(T_base_tool=end, metric=metric, orientation_tolerance=tolerance)
    plan, _ = planned(start, goal)
    assume(plan is not None)
    tool_path = straight_path(T, end)
    q = plan.trajectory.q
    s = np.clip(
        (CHAINS["tool"].positions(q) - T.p) @ (end.p - T.p) / tool_path.length,
        0.0,
        tool_path.length,
    )
    wanted, reached = tool_path.rotations(s), CHAINS["tool"].rotations(q)
    if metric is GoalMetric.FULL_POSE:
        angles = [rotation_angle(a.T @ b) for a, b in zip(wanted, reached, strict=True)]
    elif metric is GoalMetric.POSITION_AND_APPROACH:
        angles = np.linalg.norm(wanted[:, :, 2] - reached[:, :, 2], axis=1)
    else:
        angles = [0.0]
    stated = plan.report.path_deviation.angle
    assert max(angles) <= stated + 1e-3
    assert stated <= tolerance
    assert plan.report.path_deviation.position == pytest.approx(0.0, abs=1e-4)


@given(seed=seeds, metric=metrics)
@example(seed=114, metric=GoalMetric.POSITION_ONLY)
@example(seed=176, metric=GoalMetric.FULL_POSE)
@settings(max_examples=40)
def test_at_every_instant_a_line_is_left_by_no_more_than_is_said(seed, metric):
    rng = np.random.default_rng(seed)
    start = free_configuration(rng)
    T = MODEL.frame(start)
    end = SE3(T.R, T.p + step(rng, rng.uniform(0.02, 0.15)))
    goal = LineGoal(T_base_tool=end, metric=metric, orientation_tolerance=np.radians(20.0))
    request = PlanRequest(q_start=start, goal=goal, limits=limits_with(None))
    try:
        plan = PLANNER.plan(request)
    except PlanningError:
        assume(False)
    motion = plan.trajectory
    q, _, _ = motion.at(np.arange(10 * (len(motion) - 1) + 1) * 0.1 * motion.dt)
    p = CHAINS["tool"].positions(q) - T.p
    along = (end.p - T.p) / np.linalg.norm(end.p - T.p)
    off = np.linalg.norm(p - np.outer(p @ along, along), axis=1).max()
    assert off <= 0.05e-3  # half the tolerance of a line
    assert off <= 1.03 * plan.report.path_deviation.position + 1e-6
