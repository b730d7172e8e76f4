from itertools import pairwise, product

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError, InCollision, Unreachable
from so101_motion.common.geometry import SE3, rot_y, rot_z, rotation_angle
from so101_motion.planning.cartesian.cartesian import CartesianPlanner
from so101_motion.planning.cartesian.ladder_graph import (
    JUMP,
    OF_MOTION,
    PAN_JUMP,
    SIDE_JUMP,
    LadderGraph,
    are_near,
)
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


def test_the_pitch_gives_way_where_it_must(model, find):
    # With the hand level the arm cannot come so close; with another pitch it can.
    line = find(np.zeros(5), (-0.2, 0.0, 0.0))
    assert np.ptp(line.waypoints[:, 1:4].sum(axis=1)) > 0.05


def test_the_tool_moves_at_one_speed_and_keeps_its_cap(model, lines, find):
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=0.05)
    motion = timed(lines, find(READY, (0.0, 0.1, 0.0)), limits, 0.01)
    speed = lines.tool.speeds(motion.q, motion.qd)
    assert speed.max() < 0.05 * 1.001
    assert np.ptp(speed[20:-20]) < 1e-4


def test_a_line_without_length_is_no_motion(lines, find):
    motion = timed(lines, find(READY, (0.0, 0.0, 0.0)), LIMITS, 0.01)
    assert len(motion) == 1
    assert motion.duration == 0.0
    assert np.array_equal(motion.q[0], READY)


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


def test_the_length_that_random_lines_can_be_followed_is_exact_to_two_millimetres(
    model, lines, collision
):
    random = np.random.default_rng(3)

    def follow(q_start, tool_path):
        T = model.frame(q_start)
        lines.find(LineGoal(T_base_tool=SE3(T.R, T.p + tool_path)), q_start, collision, 0.0)

    def can_follow(q_start, tool_path):
        try:
            follow(q_start, tool_path)
        except (Unreachable, InCollision):
            return False
        return True

    right, told = 0, 0
    while told < 15:
        q_start = random.uniform(model.lower, model.upper)
        tool_path = random.standard_normal(3)
        tool_path *= 0.25 / np.linalg.norm(tool_path)
        if not collision.is_free(q_start) or can_follow(q_start, tool_path):
            continue
        with pytest.raises((Unreachable, InCollision)) as caught:
            follow(q_start, tool_path)
        told += 1
        share = 0.002 / 0.25
        within = can_follow(q_start, max(caught.value.fraction - share, 0.0) * tool_path)
        beyond = can_follow(q_start, min(caught.value.fraction + share, 1.0) * tool_path)
        right += within and not beyond
    # The joints might turn over in the middle of the path; only a curve to its end would tell.
    assert right >= 13


def test_an_arm_with_narrower_limits_keeps_to_them_along_the_line(model):
    start = np.radians([0, 0, 20, 60, 0])
    T = model.frame(start)
    goal = LineGoal(T_base_tool=SE3(T.R, T.p + np.array([0.0, 0.0, -0.07])))
    nothing_there = CollisionModel(model, Scene(floor_z=None))
    widely = CartesianPlanner(IkSolver(model)).find(goal, start, nothing_there, 0.0).waypoints
    lower, upper = model.lower.copy(), model.upper.copy()
    lower[3] = widely[:, 3].min() + 0.05
    assert start[3] > lower[3]
    narrow = model.narrowed(lower, upper)
    found = CartesianPlanner(IkSolver(narrow)).find(goal, start, nothing_there, 0.0)
    (curve,) = found.curves
    q = curve.evaluate(np.linspace(0.0, curve.length, 500)).q
    assert np.all(q >= narrow.lower - 1e-6)
    assert np.all(q <= narrow.upper + 1e-6)


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


def test_the_tool_tilts_steadily_to_another_approach(model, lines, collision):
    T = model.frame(READY)
    end = SE3(rot_y(np.radians(25.0)) @ T.R, T.p + np.array([0.03, 0.0, 0.0]))
    goal = LineGoal(T_base_tool=end, metric=GoalMetric.POSITION_AND_APPROACH)
    found = lines.find(goal, READY, collision, 0.0)
    (curve,) = found.curves
    pitch = curve.evaluate(np.linspace(0.0, curve.length, 9)).q[:, 1:4].sum(axis=1)
    assert np.diff(pitch) == pytest.approx(np.full(8, np.radians(25.0) / 8), abs=1e-3)


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


def test_the_tool_goes_round_an_arc(model, lines, collision):
    T = model.frame(TOOL_DOWN)
    end, via = np.array([0.04, 0.0, 0.0]), np.array([0.02, 0.02, 0.0])
    arc = ArcTo(T_base_tool=SE3(T.R, T.p + end), p_via=T.p + via)
    goal = ToolPathGoal(segments=(arc,), metric=GoalMetric.POSITION_AND_APPROACH)
    motion = timed(lines, lines.find(goal, TOOL_DOWN, collision, 0.0), LIMITS, 0.005)
    centre = T.p + 0.5 * end
    points = np.array([model.frame(q).p for q in motion.q])
    assert np.linalg.norm(points - centre, axis=1) == pytest.approx(0.02, abs=1e-4)
    assert points[:, 2] == pytest.approx(T.p[2], abs=1e-4)
    assert points[:, 1].max() == pytest.approx(T.p[1] + 0.02, abs=1e-4)


def test_a_path_that_cannot_be_followed_names_the_segment(model, lines, collision):
    goal = path_goal(model, [(0.0, 0.03, 0.0), (0.5, 0.03, 0.0)], blend=0.01)
    with pytest.raises(Unreachable, match=r"of the 5\d\d mm of the path, into segment 2 of 2"):
        lines.find(goal, TOOL_DOWN, collision, 0.0)


@pytest.mark.parametrize("key", ["tolerance", "orientation_tolerance"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan")])
def test_tolerances_that_are_none_are_refused_by_name(model, lines, collision, key, value):
    with pytest.raises(ConfigError, match=f'"{key}".*must be positive and finite'):
        lines.find(path_goal(model, SQUARE, **{key: value}), TOOL_DOWN, collision, 0.0)


def test_a_frame_that_is_not_on_the_gripper_is_refused(model, lines, collision):
    goal = LineGoal(T_base_tool=model.frame(READY), frame="wrist_link")
    with pytest.raises(ConfigError, match="not fixed to the gripper"):
        lines.find(goal, READY, collision, 0.0)


# The ladder graph


def ladder(random, columns=5, rows=6, spread=0.12):
    q = [spread * random.standard_normal((rows, 5)) for _ in range(columns)]
    price = [random.random(rows) for _ in range(columns)]
    price[0][1:] = np.inf
    return LadderGraph(q, price, [np.ones(rows, dtype=bool)] * columns), q, price


def cost_of(q, price, rows):
    total = 0.0
    for i, row in enumerate(rows):
        total += price[i][row] / (len(q) - 1)
        if i:
            step = q[i][row] - q[i - 1][rows[i - 1]]
            if np.linalg.norm(step[1:]) > JUMP or abs(step[0]) > PAN_JUMP:
                return np.inf
            total += (len(q) - 1) * (step[1:4].sum() ** 2 + OF_MOTION * (step[1:] @ step[1:]))
    return total


@pytest.mark.parametrize("seed", range(8))
def test_the_best_sequence_is_the_cheapest_of_all(seed):
    made, q, price = ladder(np.random.default_rng(seed))
    every = product(*(range(len(column)) for column in q))
    cheapest = min(cost_of(q, price, rows) for rows in every)
    rows = made.best()
    assert cost_of(q, price, rows) == pytest.approx(cheapest)
    assert np.array_equal(made.sequence(rows), [c[row] for c, row in zip(q, rows, strict=True)])


def test_forbidden_steps_are_avoided():
    made, q, price = ladder(np.random.default_rng(1))
    first = made.best()
    made.forbid(2, first[2])
    second = made.best()
    assert second[2] != first[2]
    price[2][first[2]] = np.inf
    every = product(*(range(len(column)) for column in q))
    assert cost_of(q, price, second) == pytest.approx(
        min(cost_of(q, price, rows) for rows in every)
    )


def test_a_forbidden_step_leaves_its_postures():
    made, _, _ = ladder(np.random.default_rng(2))
    first = made.best()
    made.forbid_step(1, first[1], first[2])
    second = made.best()
    assert (second[1], second[2]) != (first[1], first[2])


def test_without_a_sequence_it_says_how_far_any_gets():
    made, _, _ = ladder(np.random.default_rng(3))
    for row in range(6):
        made.forbid(3, row)
    assert made.best() is None
    assert made.farthest() == 2
    assert len(made.best(2)) == 3
    useful = made.useful()
    assert len(useful) == 3
    assert list(useful[0]) == [0]


def test_a_column_without_postures_ends_it():
    q = [np.zeros((1, 5)), np.zeros((2, 5)), np.empty((0, 5)), np.zeros((1, 5))]
    in_front = [np.ones(len(column), dtype=bool) for column in q]
    made = LadderGraph(q, [np.zeros(len(column)) for column in q], in_front)
    assert made.best() is None
    assert made.farthest() == 1


def test_postures_far_apart_are_not_one_motion():
    here = np.zeros((1, 5))
    there = np.zeros((3, 5))
    there[1, 2] = 0.3
    there[2, 0] = 1.01
    assert are_near(here, there, 0.2, 1.0).tolist() == [[True, False, False]]


def test_front_becomes_back_only_where_both_are_one_posture():
    q = [np.zeros((1, 5)), np.zeros((2, 5))]
    q[1][:, 0] = SIDE_JUMP + 0.1, SIDE_JUMP - 0.1
    price = [np.zeros(1), np.array([0.0, 1.0])]
    in_front = [np.array([True]), np.array([False, False])]
    assert LadderGraph(q, price, in_front).best()[1] == 1
    assert LadderGraph(q, price, [np.array([False]), in_front[1]]).best()[1] == 0
