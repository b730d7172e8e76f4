from dataclasses import fields

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError, Unreachable
from so101_motion.common.geometry import SE3, rot_x, rot_y, rot_z
from so101_motion.planning.goals import GoalMetric, PoseCloud, PoseGoal
from so101_motion.planning.kinematics.ik_cloud import is_in_cloud

HOME = np.zeros(5)
DOWN = np.diag([1.0, -1.0, -1.0])
ANY_TURN = PoseCloud(theta=np.pi)


def cone(tilt, **more):
    sine = float(np.sin(min(tilt, 0.5 * np.pi)))
    return PoseCloud(o_x=sine, o_y=sine, o_z=float(1.0 - np.cos(tilt)), theta=np.pi, **more)


def seen_from_goal(model, goal, q):
    return goal.T_base_tool.inverse @ model.frame(q, goal.frame)


def assert_inside(model, goal, q):
    T, cloud = seen_from_goal(model, goal, q), goal.cloud
    assert np.all(np.abs(T.p) <= np.array([cloud.x, cloud.y, cloud.z]) + 1.1e-4)
    o_x, o_y, o_z = T.R[:, 2]
    assert abs(o_x) <= cloud.o_x + 1.1e-3
    assert abs(o_y) <= cloud.o_y + 1.1e-3
    assert 1.0 - o_z <= cloud.o_z + 1.1e-3
    turn = np.arctan2(T.R[1, 0] - T.R[0, 1], T.R[0, 0] + T.R[1, 1])
    assert abs(turn) <= cloud.theta + 1.1e-3
    assert np.all(q >= model.lower)
    assert np.all(q <= model.upper)


@pytest.mark.parametrize("frame", ["tool", "jaw_tip"])
@pytest.mark.parametrize("seed", range(5))
def test_every_solution_is_in_the_cloud_and_no_two_are_alike(model, solver, frame, seed):
    random = np.random.default_rng(seed)
    T = model.frame(random.uniform(model.lower, model.upper), frame)
    goal = PoseGoal(T_base_tool=T, frame=frame, cloud=cone(0.4, x=0.01, z=0.02))
    found = [solution.q for solution in solver.candidates(goal, HOME)]
    assert found
    for q in found:
        assert_inside(model, goal, q)
        assert is_in_cloud(goal.cloud, seen_from_goal(model, goal, q))
    apart = np.linalg.norm(np.array(found)[:, None] - np.array(found)[None], axis=2)
    assert apart[~np.eye(len(found), dtype=bool)].min(initial=1.0) > 0.1


@pytest.mark.parametrize("frame", ["tool", "jaw_tip"])
@pytest.mark.parametrize("seed", range(5))
def test_without_tolerances_the_cloud_is_the_pose(model, solver, frame, seed):
    T = model.frame(np.random.default_rng(seed).uniform(model.lower, model.upper), frame)
    goal = PoseGoal(T_base_tool=T, frame=frame, cloud=PoseCloud())
    solution = solver.solve(goal, HOME)
    assert_inside(model, goal, solution.q)
    assert solution.error_position < 1e-4


@pytest.mark.parametrize(
    ("T_goal_reached", "is_inside"),
    [
        (SE3.identity(), True),
        (SE3.from_translation([0.01, 0.0, -0.02]), True),
        (SE3.from_translation([0.011, 0.0, 0.0]), False),
        (SE3.from_translation([0.0, 0.001, 0.0]), False),
        (SE3(rot_y(0.39), np.zeros(3)), True),
        (SE3(rot_x(0.42), np.zeros(3)), False),
        (SE3(rot_z(3.0), np.zeros(3)), True),
    ],
)
def test_a_pose_is_in_a_cloud_or_it_is_not(T_goal_reached, is_inside):
    assert is_in_cloud(cone(0.4, x=0.01, z=0.02), T_goal_reached) is is_inside


@pytest.mark.parametrize(
    ("cloud", "metric"),
    [
        (PoseCloud(x=0.1, theta=3.0, o_x=1.0, o_y=1.0, o_z=2.0), GoalMetric.FULL_POSE),
        (cone(0.4), GoalMetric.POSITION_AND_APPROACH),
        (cone(np.pi), GoalMetric.POSITION_ONLY),
    ],
)
def test_what_a_cloud_leaves_open_altogether_does_not_count(cloud, metric):
    assert cloud.metric is metric


@pytest.mark.parametrize("metric", GoalMetric)
def test_a_cloud_replaces_the_metric(model, solver, metric):
    T = model.frame(np.radians([20, -30, 30, 70, 40]))
    solutions = [
        solver.solve(PoseGoal(T_base_tool=T, metric=each, cloud=ANY_TURN), HOME).q
        for each in (metric, GoalMetric.FULL_POSE)
    ]
    assert np.array_equal(*solutions)


def down_goal(radius, azimuth, yaw, cloud):
    p = (0.0388 + radius * np.cos(azimuth), radius * np.sin(azimuth), 0.05)
    return PoseGoal(T_base_tool=SE3(rot_z(yaw) @ DOWN, p), frame="jaw_tip", cloud=cloud)


@pytest.mark.parametrize("yaw", np.radians(np.arange(0, 360, 30)))
def test_straight_down_every_turn_about_the_approach_has_a_solution(model, solver, yaw):
    for azimuth in (-1.0, 0.0, 1.2):
        goal = down_goal(0.18, azimuth, yaw, ANY_TURN)
        assert_inside(model, goal, solver.solve(goal, HOME).q)


def test_a_wide_tolerance_is_free_and_a_narrow_one_is_kept_small(model, solver):
    wide = solver.solve(down_goal(0.18, 0.0, 1.0, ANY_TURN), HOME)
    assert wide.q[4] == pytest.approx(HOME[4], abs=0.4)  # the roll hardly moves
    narrow = down_goal(0.18, 0.0, 1.0, PoseCloud(theta=0.1))
    turned = seen_from_goal(model, narrow, solver.solve(narrow, HOME).q)
    assert abs(np.arctan2(turned.R[1, 0], turned.R[0, 0])) < 0.05


@pytest.mark.parametrize("away", ["x", "y", "z"])
def test_a_point_out_of_reach_is_met_where_the_cloud_reaches_in(model, solver, away):
    R = model.frame(HOME).R
    reach = model.frame(np.radians([0, 76, -73.8, -2.2, 0])).p
    beyond = reach + np.array([0.03, 0.0, 0.0])
    free = {"o_x": 1.0, "o_y": 1.0, "o_z": 2.0, "theta": np.pi}
    goal = PoseGoal(T_base_tool=SE3(R, beyond), cloud=PoseCloud(**{away: 0.05}, **free))
    # The tool's z axis points outwards there: only a tolerance along it reaches in.
    if away == "z":
        assert_inside(model, goal, solver.solve(goal, HOME).q)
    else:
        with pytest.raises(Unreachable, match="out of reach"):
            solver.solve(goal, HOME)


def test_an_exact_approach_is_had_by_moving_aside(model, solver):
    # Five joints face a point one path only; beside it there is room for this approach.
    T = model.frame(np.radians([0, -30, 40, 20, 0]))
    turned = SE3(rot_z(0.15) @ T.R, T.p)
    with pytest.raises(Unreachable, match="no pose within the tolerances"):
        solver.solve(PoseGoal(T_base_tool=turned, cloud=PoseCloud(theta=np.pi)), HOME)
    goal = PoseGoal(T_base_tool=turned, cloud=PoseCloud(x=0.05, y=0.05, z=0.0, theta=np.pi))
    assert_inside(model, goal, solver.solve(goal, HOME).q)


def test_a_cloud_out_of_reach_says_what_is_nearest(model, solver):
    T = model.frame(np.radians([0, -30, 40, 20, 0]))
    sideways = SE3(rot_z(1.2) @ T.R, T.p)
    with pytest.raises(Unreachable, match=r"is 0.00 mm and [0-9.]+ deg off; allow more") as caught:
        solver.solve(PoseGoal(T_base_tool=sideways, cloud=PoseCloud(o_x=0.1, o_y=0.1)), HOME)
    assert caught.value.error_angle > 0.5


@pytest.mark.parametrize("key", [field.name for field in fields(PoseCloud)])
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_a_tolerance_that_is_none_is_refused_by_name(key, value):
    with pytest.raises(ConfigError, match=f'"{key}".*a tolerance must be 0 or more and finite'):
        PoseCloud(**{key: value})


def test_tolerances_are_about_the_goals_own_axes(model, solver):
    T = model.frame(np.radians([30, -30, 40, 20, 0]))
    tipped = SE3(T.R @ rot_x(0.3), T.p)
    along_y = PoseGoal(T_base_tool=tipped, cloud=PoseCloud(o_y=0.35, o_z=0.1, theta=0.1))
    assert_inside(model, along_y, solver.solve(along_y, HOME).q)
    tipped = SE3(T.R @ rot_y(0.3), T.p)
    along_x = PoseGoal(T_base_tool=tipped, cloud=PoseCloud(o_x=0.35, o_z=0.1, theta=0.1))
    assert_inside(model, along_x, solver.solve(along_x, HOME).q)
