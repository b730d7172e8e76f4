import math
from itertools import pairwise

import numpy as np
import pytest
from so101_description import URDF_PATH

from benchmarks.plan_problems import at_pitch
from so101_motion.common.errors import ConfigError, Unreachable
from so101_motion.common.geometry import SE3, rot_x
from so101_motion.planning.goals import GoalMetric, PoseGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.ik_task import check_goal, half_square, minimise
from so101_motion.planning.kinematics.model import RobotModel

HOME = np.zeros(5)
Q = np.array([0.3, -0.4, 0.5, -0.2, 0.6])
POSITION, APPROACH, FULL = GoalMetric


def configurations(model, n, seed=0):
    return np.random.default_rng(seed).uniform(model.lower, model.upper, (n, 5))


def goal_at(model, q, metric=POSITION, frame="tool"):
    return PoseGoal(T_base_tool=model.frame(q, frame), metric=metric, frame=frame)


def assert_arrived(model, solution, goal):
    reached = model.frame(solution.q, goal.frame)
    assert np.linalg.norm(reached.p - goal.T_base_tool.p) <= goal.position_tolerance
    assert np.all(solution.q >= model.lower)
    assert np.all(solution.q <= model.upper)
    assert solution.error_angle <= goal.approach_tolerance


@pytest.mark.parametrize("metric", GoalMetric)
@pytest.mark.parametrize("frame", ["tool", "jaw_tip"])
def test_a_seed_that_is_there_already_stays(model, solver, metric, frame):
    for q in configurations(model, 50, seed=1):
        solution = solver.solve(goal_at(model, q, metric, frame), q)
        np.testing.assert_allclose(solution.q, q, atol=1e-5)


def test_position_only_keeps_the_roll_of_the_seed(model, solver):
    for q in configurations(model, 50, seed=2):
        assert solver.solve(goal_at(model, q), Q).q[4] == Q[4]


def test_a_full_pose_is_met_exactly_where_the_joints_can(model, solver):
    for frame in ("tool", "jaw_tip"):
        for q in configurations(model, 100, seed=4):
            solution = solver.solve(goal_at(model, q, FULL, frame), HOME)
            assert solution.error_angle < 1e-6
            assert solution.error_position < 1e-9


def test_full_poses_close_to_the_pan_axis_are_met_too(model, solver):
    x, y = solver.structure.measures.pan
    seen = 0
    for q in configurations(model, 6000, seed=5):
        T = model.frame(q, "jaw_tip")
        if math.hypot(T.p[0] - x, T.p[1] - y) < 0.008:
            solution = solver.solve(goal_at(model, q, FULL, "jaw_tip"), HOME)
            assert solution.error_angle < 1e-6
            seen += 1
    assert seen >= 5


def test_a_vertical_approach_is_no_special_case(model, solver):
    q_down = np.array([0.4, -0.35, 0.35, math.pi / 2, 1.0])
    for frame in ("tool", "jaw_tip"):
        T = model.frame(q_down, frame)
        assert T.R[2, 2] == pytest.approx(-1.0)
        for metric in (APPROACH, FULL):
            goal = goal_at(model, q_down, metric, frame)
            solution = solver.solve(goal, HOME)
            assert_arrived(model, solution, goal)


def test_approach_leaves_the_roll_free(model, solver):
    T = model.frame(Q)
    turned = SE3(T.R @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), T.p)
    goal = PoseGoal(T_base_tool=turned, metric=APPROACH)
    assert solver.solve(goal, Q).q == pytest.approx(Q, abs=1e-9)


def test_an_approach_out_of_the_arms_plane_is_refused_with_its_angle(model, solver):
    T = model.frame(Q)
    ahead = T.R[:, 2]
    left = np.cross([0.0, 0.0, 1.0], ahead)
    left /= np.linalg.norm(left)
    R = np.column_stack([np.cross(ahead, left), ahead, left])
    goal = PoseGoal(T_base_tool=SE3(R, T.p), metric=APPROACH)
    with pytest.raises(Unreachable, match=r"90\.0 deg off, and 1\.0 deg are allowed") as caught:
        solver.solve(goal, Q)
    assert caught.value.error_angle == pytest.approx(math.pi / 2)
    assert caught.value.error_position < 1e-9


def test_the_angle_refused_is_the_least_the_arm_can_do_at_the_point(model, solver):
    rng = np.random.default_rng(6)
    for q in configurations(model, 20, seed=7):
        T = model.frame(q)
        wanted = SE3.from_rpy(rng.uniform(-3.0, 3.0, 3), T.p)
        goal = PoseGoal(T_base_tool=wanted, metric=APPROACH)
        try:
            reached = solver.solve(goal, HOME).error_angle
        except Unreachable as error:
            reached = error.error_angle
        for other in solver.candidates(PoseGoal(T_base_tool=wanted), HOME):
            axis = model.frame(other.q).R[:, 2]
            angle = math.acos(np.clip(axis @ wanted.R[:, 2], -1.0, 1.0))
            assert reached <= max(angle, goal.approach_tolerance) + 1e-6


def test_a_wide_tolerance_turns_the_refusal_into_a_solution(model, solver):
    T = model.frame(Q)
    tilted = SE3(T.R @ rot_x(0.1), T.p)
    strict = PoseGoal(T_base_tool=tilted, metric=FULL)
    with pytest.raises(Unreachable) as caught:
        solver.solve(strict, Q)
    assert 0.0175 < caught.value.error_angle <= 0.1
    wide = PoseGoal(T_base_tool=tilted, metric=FULL, approach_tolerance=0.11)
    assert solver.solve(wide, Q).error_angle == pytest.approx(caught.value.error_angle, abs=1e-6)


def test_a_full_pose_out_of_reach_names_point_and_turn(solver):
    goal = PoseGoal(T_base_tool=SE3(np.eye(3), np.array([0.6, 0.0, 0.2])), metric=FULL)
    with pytest.raises(Unreachable, match=r"225\.2 mm out of reach") as caught:
        solver.solve(goal, HOME)
    assert caught.value.error_angle > 0.5


def test_candidates_come_nearest_first_and_no_two_are_alike(model, solver):
    for metric in GoalMetric:
        for frame in ("tool", "jaw_tip"):
            for q in configurations(model, 8, seed=8):
                goal = goal_at(model, q, metric, frame)
                found = list(solver.candidates(goal, HOME))
                np.testing.assert_array_equal(found[0].q, solver.solve(goal, HOME).q)
                away = [np.linalg.norm(solution.q) for solution in found[1:]]
                assert away == sorted(away)
                for solution in found:
                    assert_arrived(model, solution, goal)
                qs = np.array([solution.q for solution in found])
                apart = np.linalg.norm(qs[:, None] - qs[None], axis=2)
                assert np.all(apart[~np.eye(len(qs), dtype=bool)] > 1e-6)


def test_candidates_for_a_point_are_spread_over_pitch_roll_and_branches(model, solver):
    found = list(solver.candidates(goal_at(model, Q), HOME))
    assert len(found) > 30
    assert len({round(solution.q[4], 3) for solution in found}) > 5
    pitches = sorted({round(float(solution.q[1:4].sum()), 2) for solution in found})
    assert pitches[-1] - pitches[0] > 1.5
    assert max(b - a for a, b in pairwise(pitches)) < 0.45
    sideways = np.array([1.5, -0.9, 0.2, 0.3, 0.0])
    branches = {each.branch for each in solver.candidates(goal_at(model, sideways), HOME)}
    assert any(branch.startswith("front") for branch in branches)


def test_both_elbows_are_candidates_near_the_straight_arm(model, solver):
    q = np.array([0.2, 0.3, solver.structure.bars.straight + 0.3, 0.2, 0.0])
    branches = {each.branch for each in solver.candidates(goal_at(model, q, APPROACH), q)}
    assert branches == {"front, elbow up", "front, elbow down"}


def test_candidates_refuse_at_once_what_solve_refuses(solver):
    with pytest.raises(Unreachable):
        solver.candidates(PoseGoal.at_point((1.0, 0.0, 0.0)), HOME)


def test_a_solution_at_a_limit_names_it(model, solver):
    q = np.array([0.2, -0.4, 0.6, model.upper[3], 0.1])
    solution = solver.solve(goal_at(model, q, APPROACH), q)
    assert solution.limit == "wrist_flex at its upper limit"
    assert solver.solve(goal_at(model, Q, APPROACH), Q).limit is None


def test_a_held_object_is_solved_for_like_the_tool(model):
    held = model.with_frame("cup", SE3.from_rpy((0.3, -0.2, 1.0), (0.02, -0.04, 0.12)))
    solver = IkSolver(held)
    for metric in GoalMetric:
        for q in configurations(held, 60, seed=9):
            goal = goal_at(held, q, metric, "cup")
            solution = solver.solve(goal, HOME)
            assert_arrived(held, solution, goal)
            if metric is APPROACH:
                # The approach is the tool's, whichever frame the goal is about.
                R_base_tool = held.frame(q).R
                axis = held.frame(solution.q).R[:, 2]
                assert math.acos(min(axis @ R_base_tool[:, 2], 1.0)) < math.radians(1.0) + 1e-6


def test_an_object_far_off_the_roll_axis_still_gets_its_nearest_point(model):
    held = model.with_frame("rod", SE3.from_translation((0.15, 0.0, 0.05)))
    solver = IkSolver(held)
    sample = np.array(
        [held.rotation_and_position(q, "rod")[1].copy() for q in configurations(held, 8000)]
    )
    for p_base in ((0.7, 0.0, 0.1), (0.0, 0.6, -0.2), (-0.4, -0.3, 0.0), (0.3, 0.0, -0.5)):
        with pytest.raises(Unreachable) as caught:
            solver.solve(PoseGoal.at_point(p_base, frame="rod"), HOME)
        nearest = np.linalg.norm(sample - p_base, axis=1).min()
        assert caught.value.error_position <= nearest


def test_a_rounded_urdf_is_polished_to_a_nanometre(tmp_path):
    text = URDF_PATH.read_text()
    text = text.replace("1.5707963267948966", "1.5708").replace("3.141592653589793", "3.14159")
    (tmp_path / "rounded.urdf").write_text(text)
    model = RobotModel.load(tmp_path / "rounded.urdf")
    solver = IkSolver(model)
    for q in configurations(model, 100, seed=11):
        p_base = model.frame(q).p
        rough = at_pitch(solver.structure, p_base, q[1:4].sum(), q[4], "tool")[0]
        assert np.linalg.norm(model.frame(rough).p - p_base) > 1e-8
        assert solver.solve(goal_at(model, q), q).error_position < 1e-6


AHEAD = np.array([0.2, 0.0, 0.2])
SHEARED = np.array([[1.0, 0.01, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def pose(R, **options):
    return PoseGoal(T_base_tool=SE3(R, AHEAD), **options)


@pytest.mark.parametrize(
    ("goal", "key", "reason"),
    [
        (PoseGoal.at_point((math.nan, 0.0, 0.2)), "T_base_tool", "three finite numbers"),
        (PoseGoal.at_point((0.2, math.inf, 0.2)), "T_base_tool", "three finite numbers"),
        (pose(np.eye(3) * 1.01), "T_base_tool", "right-handed orthonormal"),
        (pose(np.diag([1.0, 1.0, -1.0])), "T_base_tool", "right-handed orthonormal"),
        (pose(np.full((3, 3), math.nan)), "T_base_tool", "right-handed orthonormal"),
        (pose(SHEARED), "T_base_tool", "right-handed orthonormal"),
        (PoseGoal.at_point(AHEAD, frame="wrist_link"), "frame", "fixed to the gripper"),
        (PoseGoal.at_point(AHEAD, frame="cup"), "frame", "fixed to the gripper"),
        (pose(np.eye(3), position_tolerance=0.0), "position_tolerance", "positive"),
        (pose(np.eye(3), approach_tolerance=math.nan), "approach_tolerance", "positive"),
    ],
)
def test_invalid_goals_are_refused_in_a_sentence(solver, goal, key, reason):
    for ask in (solver.solve, solver.candidates):
        with pytest.raises(ConfigError, match=reason) as caught:
            ask(goal, HOME)
        assert caught.value.key == key


@pytest.mark.parametrize("q_seed", [[0.0] * 4, [0.0] * 6, [math.nan] * 5, [math.inf, 0, 0, 0, 0]])
def test_seeds_that_cannot_be_meant_are_refused(solver, q_seed):
    with pytest.raises(ConfigError, match="five finite joint angles"):
        solver.solve(PoseGoal.at_point((0.2, 0.0, 0.2)), q_seed)


def test_the_angles_of_a_solution_cannot_be_changed(solver):
    solution = solver.solve(PoseGoal.at_point((0.2, 0.0, 0.2)), HOME)
    with pytest.raises(ValueError, match="read-only"):
        solution.q[0] = 2.0


# Descents


def task_at(model, q, metric, frame="jaw_tip"):
    return check_goal(
        model, PoseGoal(T_base_tool=model.frame(q, frame), metric=metric, frame=frame)
    )


@pytest.mark.parametrize("metric", GoalMetric)
def test_the_gradient_is_that_of_the_value(model, metric):
    h = 1e-6 * np.eye(5)
    for q, q_goal in configurations(model, 40).reshape(20, 2, 5):
        task = task_at(model, q_goal, metric)
        gradient = half_square(model, task, q)[1]
        differences = [
            (half_square(model, task, q + e)[0] - half_square(model, task, q - e)[0]) / 2e-6
            for e in h
        ]
        np.testing.assert_allclose(gradient, differences, atol=1e-8)


def test_the_curvature_of_the_position_is_that_of_its_gradient(model):
    h = 1e-6 * np.eye(5)
    for q, q_goal in configurations(model, 40).reshape(20, 2, 5):
        task = task_at(model, q_goal, GoalMetric.POSITION_ONLY)
        differences = [
            (half_square(model, task, q + e)[1] - half_square(model, task, q - e)[1]) / 2e-6
            for e in h
        ]
        np.testing.assert_allclose(half_square(model, task, q)[2], differences, atol=1e-8)


@pytest.mark.parametrize("metric", GoalMetric)
def test_a_descent_never_goes_uphill_nor_outside(model, metric):
    for q, q_goal in configurations(model, 40, seed=1).reshape(20, 2, 5):
        task = task_at(model, q_goal, metric)
        end = minimise(model, task, 2.0 * q)
        assert model.outside(end, tolerance=0.0) is None
        begin = np.clip(2.0 * q, model.lower, model.upper)
        assert half_square(model, task, end)[0] <= half_square(model, task, begin)[0]


# The nearest reachable point


def points_out_of_reach(solver, frame, n, seed):
    """Points all around: far outside, close to the base, behind the pan's limits."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < n:
        spread = ([0.6, 0.6, 0.7], [0.12, 0.12, 0.3])[len(found) % 2]
        p_base = rng.uniform(-np.array(spread), spread)
        try:
            solver.solve(PoseGoal.at_point(p_base, frame=frame), HOME)
        except Unreachable as error:
            found.append((p_base, error))
    return found


@pytest.mark.parametrize("frame", ["tool", "jaw_tip"])
def test_no_descent_from_anywhere_comes_nearer(model, solver, frame):
    starts = np.random.default_rng(1).uniform(model.lower, model.upper, (12, 5))
    for p_base, error in points_out_of_reach(solver, frame, 12, seed=2):
        task = check_goal(model, PoseGoal.at_point(p_base, frame=frame))
        for q in starts:
            q = minimise(model, task, q)
            away = np.linalg.norm(model.frame(q, frame).p - p_base)
            assert error.error_position <= away + 1e-6


@pytest.mark.parametrize("frame", ["tool", "jaw_tip"])
def test_the_point_named_is_reachable_as_far_off_as_said_and_none_is_nearer(model, solver, frame):
    sample = np.random.default_rng(3).uniform(model.lower, model.upper, (20_000, 5))
    within_reach = np.array([model.rotation_and_position(q, frame)[1].copy() for q in sample])
    for p_base, error in points_out_of_reach(solver, frame, 60, seed=5):
        reached = model.frame(error.q_nearest, frame).p
        np.testing.assert_allclose(error.p_base_nearest, reached, atol=1e-12)
        assert np.linalg.norm(reached - p_base) == pytest.approx(error.error_position, abs=1e-12)
        assert error.error_position <= np.linalg.norm(within_reach - p_base, axis=1).min() + 1e-9
        assert model.outside(error.q_nearest, tolerance=0.0) is None
        assert error.limit
        goal = PoseGoal.at_point(error.p_base_nearest, frame=frame)
        assert solver.solve(goal, HOME).error_position < 1e-4


@pytest.mark.parametrize(
    ("p_base", "limit", "off_mm"),
    [
        ((0.6, 0.0, 0.2), "full stretch", 225.2),
        ((0.3, 0.1, -0.3), "shoulder_lift at its upper limit", 200.2),
        ((0.1, 0.3, 0.9), "full stretch", None),
        ((-0.2, 0.2, 0.1), "shoulder_lift at its lower limit", 31.4),
    ],
)
def test_the_binding_limit_is_named(solver, p_base, limit, off_mm):
    said = limit.replace("full stretch", "fully stretched")
    with pytest.raises(Unreachable, match=said) as caught:
        solver.solve(PoseGoal.at_point(p_base), HOME)
    assert caught.value.limit == limit
    if off_mm is not None:
        assert caught.value.error_position * 1000.0 == pytest.approx(off_mm, abs=0.1)


def test_the_pan_is_named_where_it_cannot_turn_far_enough(model, solver):
    q = np.array([model.upper[0], 0.8, -0.3, 0.1, 0.0])
    T = model.frame(q)
    sideways = np.cross(T.R[:, 2], [0.0, 0.0, 1.0])
    sideways *= 0.02 / np.linalg.norm(sideways)
    with pytest.raises(Unreachable) as caught:
        solver.solve(PoseGoal.at_point(T.p + sideways), HOME)
    assert caught.value.limit == "shoulder_pan at its upper limit"
    assert caught.value.error_position == pytest.approx(0.02, abs=1e-6)


def test_on_the_pan_axis_the_tool_passes_by_a_fifth_of_a_millimetre(solver):
    x, y = solver.structure.measures.pan
    with pytest.raises(Unreachable, match="the pan axis") as caught:
        solver.solve(PoseGoal.at_point((x, y, 0.3)), HOME)
    assert caught.value.error_position == pytest.approx(0.000178, abs=1e-6)
    # Within a tolerance of half a millimetre that is arrival.
    goal = PoseGoal.at_point((x, y, 0.3))
    wide = PoseGoal(T_base_tool=goal.T_base_tool, position_tolerance=5e-4)
    assert solver.solve(wide, HOME).error_position == pytest.approx(0.000178, abs=1e-6)
