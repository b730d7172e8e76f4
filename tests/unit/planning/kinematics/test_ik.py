import itertools
import math
import xml.etree.ElementTree as ET
from dataclasses import fields

import numpy as np
import pytest
from so101_description import URDF_PATH

from so101_motion.common.errors import ConfigError, OutsideLimits, Unreachable
from so101_motion.common.geometry import SE3, rot_x, rot_y, rot_z, rotation_angle
from so101_motion.planning.goals import GoalMetric, PoseCloud, PoseGoal
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.geometry_from_model import measure_structure
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.ik_cloud import is_in_cloud
from so101_motion.planning.kinematics.ik_task import check_goal, half_square, minimise
from so101_motion.planning.kinematics.model import LINKS, RobotModel

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


def test_both_elbows_are_candidates_near_the_straight_arm(model, solver):
    q = np.array([0.2, 0.3, solver.structure.bars.straight + 0.3, 0.2, 0.0])
    elbows = [each.q[2] for each in solver.candidates(goal_at(model, q, APPROACH), q)]
    assert min(elbows) < solver.structure.bars.straight < max(elbows)


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
        assert solver.solve(goal_at(model, q), q).error_position < 1e-6


AHEAD = np.array([0.2, 0.0, 0.2])
SHEARED = np.array([[1.0, 0.01, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def pose(R, **options):
    return PoseGoal(T_base_tool=SE3(R, AHEAD), **options)


@pytest.mark.parametrize(
    ("make", "key", "reason"),
    [
        (lambda: PoseGoal.at_point((math.nan, 0.0, 0.2)), "goal", "three finite numbers"),
        (lambda: PoseGoal.at_point((0.2, math.inf, 0.2)), "goal", "three finite numbers"),
        (lambda: pose(np.eye(3) * 1.01), "T_base_tool", "right-handed orthonormal"),
        (lambda: pose(np.diag([1.0, 1.0, -1.0])), "T_base_tool", "right-handed orthonormal"),
        (lambda: pose(np.full((3, 3), math.nan)), "T_base_tool", "right-handed orthonormal"),
        (lambda: pose(SHEARED), "T_base_tool", "right-handed orthonormal"),
        (lambda: PoseGoal.at_point(AHEAD, frame="wrist_link"), "frame", "fixed to the gripper"),
        (lambda: PoseGoal.at_point(AHEAD, frame="cup"), "frame", "fixed to the gripper"),
        (lambda: pose(np.eye(3), position_tolerance=0.0), "position_tolerance", "more than 0"),
        (lambda: pose(np.eye(3), approach_tolerance=math.nan), "approach_tolerance", "more than 0"),
    ],
)
def test_invalid_goals_are_refused_in_a_sentence(solver, make, key, reason):
    for ask in (solver.solve, solver.candidates):
        with pytest.raises(ConfigError, match=reason) as caught:
            ask(make(), HOME)
        assert caught.value.key == key


@pytest.mark.parametrize("q_seed", [[0.0] * 4, [0.0] * 6, [math.nan] * 5, [math.inf, 0, 0, 0, 0]])
def test_seeds_that_cannot_be_meant_are_refused(solver, q_seed):
    with pytest.raises(ConfigError, match="five finite joint angles"):
        solver.solve(PoseGoal.at_point((0.2, 0.0, 0.2)), q_seed)


# Descents


def task_at(model, q, metric, frame="jaw_tip"):
    return check_goal(
        model, PoseGoal(T_base_tool=model.frame(q, frame), metric=metric, frame=frame)
    )


@pytest.mark.parametrize("metric", GoalMetric)
def test_gradient_and_curvature_are_those_of_the_value(model, metric):
    for q, q_goal in configurations(model, 40).reshape(20, 2, 5):
        task = task_at(model, q_goal, metric)
        sides = [[half_square(model, task, q + s * e) for e in np.eye(5)] for s in (1e-6, -1e-6)]
        rises = [[(a[n] - b[n]) / 2e-6 for a, b in zip(*sides, strict=True)] for n in (0, 1)]
        _, gradient, curvature = half_square(model, task, q)
        np.testing.assert_allclose(gradient, rises[0], atol=1e-8)
        if metric is POSITION:
            np.testing.assert_allclose(curvature, rises[1], atol=1e-8)


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
def test_the_point_named_is_reachable_as_far_off_as_said_and_none_is_nearer(model, solver, frame):
    starts = np.random.default_rng(1).uniform(model.lower, model.upper, (12, 5))
    for p_base, error in points_out_of_reach(solver, frame, 20, seed=5):
        reached = model.frame(error.q_nearest, frame).p
        np.testing.assert_allclose(error.p_base_nearest, reached, atol=1e-12)
        assert np.linalg.norm(reached - p_base) == pytest.approx(error.error_position, abs=1e-12)
        task = check_goal(model, PoseGoal.at_point(p_base, frame=frame))
        descents = (minimise(model, task, q) for q in starts)
        ends = [np.linalg.norm(model.frame(q, frame).p - p_base) for q in descents]
        assert error.error_position <= min(ends) + 1e-6
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
    beside = solver.solve(PoseGoal.at_point((x, y - 1e-4, 0.3)), HOME)
    assert beside.error_position == pytest.approx(0.000078, abs=1e-6)
    # Within a tolerance of half a millimetre that is arrival.
    goal = PoseGoal.at_point((x, y, 0.3))
    wide = PoseGoal(T_base_tool=goal.T_base_tool, position_tolerance=5e-4)
    assert solver.solve(wide, HOME).error_position == pytest.approx(0.000178, abs=1e-6)


# Goals with tolerances: a cloud of poses


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


def test_straight_down_every_turn_about_the_approach_has_a_solution(model, solver):
    for yaw, azimuth in itertools.product(np.radians(np.arange(0, 360, 60)), (-1.0, 0.0, 1.2)):
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
    with pytest.raises(ConfigError, match=f'"{key}".*number of at least 0'):
        PoseCloud(**{key: value})


def test_tolerances_are_about_the_goals_own_axes(model, solver):
    T = model.frame(np.radians([30, -30, 40, 20, 0]))
    for turn, free in ((rot_x, "o_y"), (rot_y, "o_x")):
        cloud = PoseCloud(**{free: 0.35}, o_z=0.1, theta=0.1)
        goal = PoseGoal(T_base_tool=SE3(T.R @ turn(0.3), T.p), cloud=cloud)
        assert_inside(model, goal, solver.solve(goal, HOME).q)


# The arm's measures, read off the model, and the closed forms built on them


@pytest.fixture
def changed(tmp_path):
    """Makes models of the URDF with some attributes of some joints changed."""

    def make(joints):
        robot = ET.parse(URDF_PATH)
        for joint in robot.getroot().findall("joint"):
            for tag, key, value in joints.get(joint.get("name"), []):
                joint.find(tag).set(key, value)
        robot.write(tmp_path / "changed.urdf")
        return RobotModel.load(tmp_path / "changed.urdf")

    return make


@pytest.mark.parametrize(
    "joints",
    [
        {"wrist_flex": [("origin", "rpy", "0.05 0 -1.5707963267948966")]},
        {"shoulder_pan": [("origin", "rpy", "3.1 0 -3.141592653589793")]},
        {"wrist_roll": [("origin", "rpy", "1.5 0.0486795 3.141592653589793")]},
        {"elbow_flex": [("axis", "xyz", "0 0 -1")]},
        {"shoulder_lift": [("limit", "upper", "3.3")]},
        {"tool_fixed": [("origin", "rpy", "0 2.9 0.0486795")]},
    ],
)
def test_an_arm_that_is_built_otherwise_is_noticed(changed, joints):
    with pytest.raises(ConfigError, match="not built like the SO-101"):
        measure_structure(changed(joints))


# The model itself


def test_a_frame_keeps_its_pose_when_the_model_moves_on(model):
    T_base_tool = model.frame(np.zeros(5))
    before = T_base_tool.p.copy()
    model.frame(np.full(5, 0.3))
    np.testing.assert_array_equal(T_base_tool.p, before)


@pytest.mark.parametrize(
    ("name", "says"), [("tol", r"tol.*jaw_tip.*tool"), ("moving_jaw_so101_v1_link", "moving_jaw")]
)
def test_what_is_no_frame_that_five_joints_place_is_refused(model, name, says):
    for ask in (model.frame, model.frame_jacobian):
        with pytest.raises(ConfigError, match=says):
            ask(np.zeros(5), name)


def test_links_are_placed_as_frames_are(model):
    placements = model.link_placements(Q, 0.7)
    assert tuple(placements) == LINKS
    for name in LINKS[:-1]:
        np.testing.assert_allclose(placements[name].matrix, model.frame(Q, name).matrix, atol=1e-15)


def test_the_jaw_turns_about_its_own_origin_and_moves_nothing_else(model):
    closed, opened = (model.link_placements(np.zeros(5), q_jaw) for q_jaw in (0.0, 1.0))
    jaw = LINKS[-1]
    np.testing.assert_array_equal(closed[jaw].p, opened[jaw].p)
    assert rotation_angle(closed[jaw].R.T @ opened[jaw].R) == pytest.approx(1.0)
    for name in LINKS[:-1]:
        np.testing.assert_array_equal(closed[name].matrix, opened[name].matrix)


def test_added_frames_add_up_but_not_under_one_name(model):
    lid = SE3.from_translation([0.0, 0.0, 0.05])
    both = model.with_frame("cup", SE3.identity()).with_frame("lid", lid)
    assert {"tool", "jaw_tip", "cup", "lid"} <= set(both.gripper_frames)
    assert "cup" not in model.gripper_frames
    with pytest.raises(ConfigError, match="another frame"):
        both.with_frame("cup", lid)
    np.testing.assert_allclose(
        both.frame(Q, "lid").matrix, (both.frame(Q) @ lid).matrix, atol=1e-12
    )
    for name in both.gripper_frames:
        R_base_tool = both.frame(Q, name).R @ both.rotation_to_tool(name)
        np.testing.assert_allclose(R_base_tool, both.frame(Q).R, atol=1e-12)


def test_the_joint_furthest_outside_is_named_with_its_limits(model):
    q = np.array([0.0, 1.8, 1.7, 0.0, 0.0])
    assert model.outside(q) == 2
    with pytest.raises(
        OutsideLimits, match=r"elbow_flex = 97\.40 deg.*-96\.82 to 90\.80"
    ) as caught:
        model.check_limits(q)
    assert caught.value.joint == "elbow_flex"
    assert caught.value.value == 1.7
    assert caught.value.upper == model.upper[2]


def test_angles_on_the_limits_are_inside_and_nan_is_not(model):
    for q in (model.lower, model.upper, np.zeros(5)):
        assert model.outside(q) is None
        model.check_limits(q)
    assert model.outside(model.upper + 1e-3, tolerance=2e-3) is None
    nan = [0.0, 0.0, 0.0, math.nan, 0.0]
    assert model.outside(nan) == 3
    with pytest.raises(OutsideLimits, match="wrist_flex"):
        model.check_limits(nan)


def test_a_missing_file_and_a_stranger_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        RobotModel.load(tmp_path / "nothing.urdf")
    robot = ET.parse(URDF_PATH)
    for joint in robot.getroot().iter("joint"):
        if joint.get("name") == "wrist_roll":
            joint.set("name", "wrist_yaw")
    robot.write(tmp_path / "stranger.urdf")
    with pytest.raises(ConfigError, match="exactly the joints shoulder_pan"):
        RobotModel.load(tmp_path / "stranger.urdf")


@pytest.mark.parametrize("frame", ["tool", "jaw_tip", "pen"])
def test_many_postures_at_once_are_what_the_model_says_of_each(model, frame):
    held = model.with_frame("pen", SE3.from_rpy((0.3, 0.2, 0.1), (0.02, 0.01, 0.08)))
    chain, q = ArmChain(held, frame), configurations(held, 40)
    p, J = chain.positions_and_jacobians(q)
    R = chain.rotations(q)
    for k, configuration in enumerate(q):
        T = held.frame(configuration, frame)
        assert p[k] == pytest.approx(T.p, abs=1e-14)
        assert R[k] == pytest.approx(T.R, abs=1e-14)
        assert J[k] == pytest.approx(held.frame_jacobian(configuration, frame)[:3], abs=1e-14)
    assert chain.positions(q) == pytest.approx(p, abs=1e-15)
    qd = np.random.default_rng(1).standard_normal(q.shape)
    expected = np.linalg.norm(np.einsum("nij,nj->ni", J, qd), axis=1)
    assert chain.speeds(q, qd) == pytest.approx(expected, abs=1e-14)
