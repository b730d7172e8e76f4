from itertools import pairwise

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError, InCollision, Unreachable
from so101_motion.common.geometry import SE3, rot_z, rotation_angle
from so101_motion.planning.cartesian.cartesian import CartesianPlanner
from so101_motion.planning.cartesian.tool_path import curve_of, path_through
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import ArcTo, GoalMetric, LineGoal, LineTo, ToolPathGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.verify import check

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
TOOL_DOWN = np.radians([0, -20, 20, 90, 0])
READY = np.radians([0, -45, 45, 60, 0])


@pytest.fixture(scope="module")
def lines(model):
    return CartesianPlanner(IkSolver(model))


@pytest.fixture(scope="module")
def find(model, lines, collision):
    def find(q_start, offset, **options):
        frame = options.get("frame", "tool")
        T = model.frame(q_start, frame)
        goal = LineGoal(T_base_tool=SE3(T.R, T.p + np.array(offset)), **options)
        return lines.find(goal, q_start, collision, 0.0)

    return find


def timed(lines, found, limits, dt):
    (motion,) = found.timed(limits, dt, lines.tool)
    return motion


def distance_from_line(points, begin, tool_path):
    along = tool_path / np.linalg.norm(tool_path)
    offset = points - begin
    return np.linalg.norm(offset - np.outer(offset @ along, along), axis=1)


def test_a_line_out_of_reach_says_how_far_it_can_be_followed_and_why(model, find):
    with pytest.raises(Unreachable) as caught:
        find(np.zeros(5), (0.1, 0.0, 0.0))
    message = str(caught.value)
    assert message.startswith("the tool can follow 6")
    assert "of the 100 mm of the line: there it is stopped by full stretch" in message
    assert caught.value.limit == "full stretch"
    assert 0.03 < caught.value.error_position < 0.04
    assert caught.value.fraction == pytest.approx(1.0 - caught.value.error_position / 0.1)
    reached = model.frame(caught.value.q_nearest).p
    assert reached == pytest.approx(caught.value.p_base_nearest, abs=1e-4)


def test_a_line_into_the_floor_says_where_it_would_touch(find):
    with pytest.raises(InCollision, match=r"can follow \d+ of the 200 mm .* the floor") as caught:
        find(TOOL_DOWN, (0.0, 0.0, -0.2))
    assert caught.value.second == "floor"
    assert caught.value.where == "path"
    assert 0.0 < caught.value.fraction < 1.0


def test_an_approach_that_does_not_exist_at_the_end_is_refused(model, lines, collision):
    p_base = model.frame(READY).p + np.array([0.02, 0.0, 0.0])
    sideways = SE3.from_rpy((np.pi / 2, 0.0, 0.0), p_base)
    goal = LineGoal(T_base_tool=sideways, metric=GoalMetric.POSITION_AND_APPROACH)
    with pytest.raises(Unreachable, match=r"turned off by .* deg, and 5.0 deg are allowed"):
        lines.find(goal, READY, collision, 0.0)


def test_the_elbow_turns_over_on_a_line_that_needs_it(model, find):
    start = np.radians([-18.6, 66.0, -95.0, -25.6, -132.0])
    offset = np.array([-0.032, 0.0093, -0.0943])
    found = find(start, offset)
    straight = IkSolver(model).structure.bars.straight
    elbow = found.waypoints[:, 2]
    assert elbow[0] < straight - 0.1
    assert elbow[-1] > straight + 0.1
    (curve,) = found.curves
    q = curve.evaluate(np.linspace(0.0, curve.length, 400)).q
    points = np.array([model.frame(each).p for each in q])
    begin = model.frame(start).p
    assert distance_from_line(points, begin, offset).max() < 1e-4


def test_a_line_that_contact_bars_is_followed_with_another_pitch(model, lines, collision):
    start = np.radians([0, 0, 20, 60, 0])
    T = model.frame(start)
    goal = LineGoal(T_base_tool=SE3(T.R, T.p + np.array([0.0, 0.0, -0.07])))
    nothing_there = CollisionModel(model, Scene(floor_z=None))
    kept = lines.find(goal, start, nothing_there, 0.0)
    assert np.ptp(kept.waypoints[:, 1:4].sum(axis=1)) < 1e-6
    raised = lines.find(goal, start, collision, 0.0)
    assert np.ptp(raised.waypoints[:, 1:4].sum(axis=1)) > 0.5
    assert collision.first_blocked(raised.waypoints) is None


def test_a_line_close_past_the_pan_axis_is_followed_by_turning_the_pan(model, find):
    start = np.radians([-76.5, -60.1, -15.7, 2.3, -94.9])
    found = find(start, (-0.027, 0.095, 0.015))
    assert np.ptp(found.waypoints[:, 0]) > 2.0


def test_sideways_the_approach_can_be_held_only_so_far(model, find):
    with pytest.raises(Unreachable, match=r"can follow 2\d of the 100 mm") as caught:
        find(READY, (0.0, 0.1, 0.0), metric=GoalMetric.POSITION_AND_APPROACH)
    assert caught.value.error_angle == pytest.approx(np.radians(5.0), abs=np.radians(0.3))
    found = find(
        READY,
        (0.0, 0.1, 0.0),
        metric=GoalMetric.POSITION_AND_APPROACH,
        orientation_tolerance=np.radians(20.0),
    )
    assert np.radians(15.0) < found.turned < np.radians(20.0)


@pytest.mark.parametrize("angle", [0.5, 2.5])
def test_the_tool_turns_on_the_spot(model, lines, collision, angle):
    T = model.frame(TOOL_DOWN)
    goal = LineGoal(T_base_tool=SE3(T.R @ rot_z(angle), T.p), metric=GoalMetric.FULL_POSE)
    motion = timed(lines, lines.find(goal, TOOL_DOWN, collision, 0.0), LIMITS, 0.01)
    check(motion, LIMITS, model.lower, model.upper)
    assert rotation_angle(model.frame(motion.q[-1]).R.T @ goal.T_base_tool.R) < 1e-6
    assert max(np.linalg.norm(model.frame(q).p - T.p) for q in motion.q) < 1e-4


def test_a_turn_beyond_the_limits_of_the_roll_says_how_far_it_can_go(model, lines, collision):
    start = TOOL_DOWN + np.array([0.0, 0.0, 0.0, 0.0, 2.3])
    T = model.frame(start)
    beyond = SE3(T.R @ rot_z(-1.2), T.p)
    goal = LineGoal(T_base_tool=beyond, metric=GoalMetric.FULL_POSE)
    with pytest.raises(
        Unreachable, match="of the 69 deg of the turn: there it is stopped by wrist_roll at"
    ):
        lines.find(goal, start, collision, 0.0)


SQUARE = [(0.0, 0.04, 0.0), (0.03, 0.04, 0.0), (0.03, -0.03, 0.0), (0.0, 0.0, 0.0)]


def path_goal(model, corners, start=TOOL_DOWN, **options):
    T = model.frame(start)
    segments = tuple(LineTo(T_base_tool=SE3(T.R, T.p + np.array(corner))) for corner in corners)
    return ToolPathGoal(segments=segments, **options)


def test_a_path_with_sharp_corners_rests_at_each(model, lines, collision):
    goal = path_goal(model, SQUARE)
    found = lines.find(goal, TOOL_DOWN, collision, 0.0)
    motions = found.timed(LIMITS, 0.005, lines.tool)
    assert len(motions) == len(SQUARE)
    begin = model.frame(TOOL_DOWN).p
    for motion, corner in zip(motions, SQUARE, strict=True):
        check(motion, LIMITS, model.lower, model.upper)
        assert model.frame(motion.q[-1]).p == pytest.approx(begin + corner, abs=1e-5)
        assert not np.any(motion.qd[[0, -1]])
    for before, after in pairwise(motions):
        assert np.array_equal(before.q[-1], after.q[0])


def test_a_path_that_cannot_be_followed_names_the_segment(model, lines, collision):
    goal = path_goal(model, [(0.0, 0.03, 0.0), (0.5, 0.03, 0.0)], blend=0.01)
    with pytest.raises(Unreachable, match=r"of the 5\d\d mm of the path, into segment 2 of 2"):
        lines.find(goal, TOOL_DOWN, collision, 0.0)


@pytest.mark.parametrize("key", ["tolerance", "orientation_tolerance"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan")])
def test_tolerances_that_are_none_are_refused_by_name(model, lines, collision, key, value):
    with pytest.raises(ConfigError, match=f'"{key}".*number of more than 0'):
        path_goal(model, SQUARE, **{key: value})
    goal = LineGoal(T_base_tool=model.frame(READY), frame="wrist_link")
    with pytest.raises(ConfigError, match="not fixed to the gripper"):
        lines.find(goal, READY, collision, 0.0)


# Tool paths


T0 = SE3.from_rpy((0.1, 0.2, 0.3), (0.2, 0.0, 0.1))
T1 = SE3.from_rpy((0.5, 0.2, 0.3), (0.3, 0.0, 0.1))
T2 = SE3.from_rpy((0.5, 0.9, 0.3), (0.3, 0.1, 0.1))
T3 = SE3.from_rpy((0.5, 0.9, -0.3), (0.2, 0.1, 0.2))
SEGMENTS = (
    LineTo(T_base_tool=T1),
    ArcTo(T_base_tool=T2, p_via=np.array([0.35, 0.05, 0.1])),
    LineTo(T_base_tool=T3),
)


@pytest.mark.parametrize("blend", [0.005, 0.02, 0.05])
def test_with_blending_place_and_orientation_have_no_corners(blend):
    tool_path = path_through(T0, SEGMENTS, blend)
    assert tool_path.rests == []
    s = np.linspace(0.0, tool_path.length, 40001)
    h = s[1]
    for values, most in ((tool_path.places(s), 1.0), (tool_path.rotations(s).reshape(-1, 9), 40.0)):
        rate = np.diff(values, axis=0) / h
        bend = np.diff(rate, axis=0) / h
        # Where direction or curvature jumped, a difference would be as large as what it is of.
        assert np.abs(rate).max() < 1.05 * most
        assert np.abs(np.diff(rate, axis=0)).max() < 0.01 * most
        assert np.abs(np.diff(bend, axis=0)).max() < 0.02 * np.abs(bend).max() + 1e-3
    assert tool_path.places(s[[0, -1]]) == pytest.approx(np.array([T0.p, T3.p]))
    assert tool_path.rotations(s[[0, -1]]) == pytest.approx(np.array([T0.R, T3.R]), abs=1e-12)


@pytest.mark.parametrize("blend", [-0.01, float("nan"), float("inf")])
def test_a_blend_that_is_no_length_is_refused(blend):
    with pytest.raises(ConfigError, match=r"blend.*number of at least 0"):
        ToolPathGoal(segments=SEGMENTS, blend=blend)
    with pytest.raises(ConfigError, match="LineTo and ArcTo, at least one"):
        ToolPathGoal(segments=())


# Segments

START = np.array([0.2, 0.05, 0.1])


def to(p):
    return SE3.from_translation(np.array(p))


def arc(end, via):
    return curve_of(START, ArcTo(T_base_tool=to(START + end), p_via=START + via), 1)


@pytest.mark.parametrize(
    ("end", "via"),
    [
        ([0.04, 0.0, 0.0], [0.02, 0.02, 0.0]),
        ([0.04, 0.0, 0.0], [0.02, 0.0, -0.005]),
        ([0.01, 0.0, 0.0], [-0.03, 0.02, 0.01]),  # nearly all of a circle
        ([0.0, 0.03, 0.02], [0.01, 0.01, 0.03]),
    ],
)
def test_an_arc_passes_its_three_points_at_one_speed(end, via):
    made = arc(np.array(end), np.array(via))
    s = np.linspace(0.0, made.length, 2001)
    p, direction, curvature = made.at(s)
    assert p[0] == pytest.approx(START, abs=1e-12)
    assert p[-1] == pytest.approx(START + end, abs=1e-12)
    step = made.length / 2000
    assert np.linalg.norm(p - (START + via), axis=1).min() < step
    assert np.linalg.norm(np.diff(p, axis=0), axis=1) == pytest.approx(step, rel=1e-5)
    assert np.gradient(p, step, axis=0)[1:-1] == pytest.approx(direction[1:-1], abs=1e-4)
    assert np.gradient(direction, step, axis=0)[1:-1] == pytest.approx(curvature[1:-1], abs=0.05)


def test_a_straight_arc_and_a_segment_without_length_are_refused():
    for via in ([0.02, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.0, 0.0]):
        with pytest.raises(ConfigError, match="too straight for an arc; move its via point aside"):
            arc(np.array([0.04, 0.0, 0.0]), np.array(via))
    with pytest.raises(ConfigError, match=r"segment 3 ends where it starts; leave it out$"):
        curve_of(START, LineTo(T_base_tool=to(START)), 3)
    with pytest.raises(ConfigError, match="make a full circle of two arcs"):
        curve_of(START, ArcTo(T_base_tool=to(START), p_via=START + np.array([0.01, 0.0, 0.0])), 1)
