from functools import partial

import numpy as np
import pytest
from harness.random_scenes import obstacle

from so101_motion.common.errors import ConfigError, InCollision, NoPath, OutsideLimits, Unreachable
from so101_motion.common.geometry import SE3, rot_z
from so101_motion.planning.checkpoint import Abandoned
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import (
    FLOOR_Z,
    Attached,
    Box,
    Obstacle,
    PointCloud,
    Scene,
    Sphere,
)
from so101_motion.planning.goals import (
    ApproachGoal,
    GoalMetric,
    JointGoal,
    LeaveContactGoal,
    LineGoal,
    PathGoal,
    PoseGoal,
)
from so101_motion.planning.planner import Planner, PlanRequest
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.verify import limit_report

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
HOME = np.zeros(5)
GOAL = np.radians([40, -20, 30, 10, 0])
BELOW = np.radians([0, 60, 20, 40, 0])
RESTING = np.radians([0, -105, 91, 77, 0])
WAYPOINTS = np.radians(
    [[10, 5, 0, 0, 0], [20, -5, 10, 5, 0], [30, 10, 20, 0, 10], [40, -20, 30, 10, 0]]
)
OVER_THE_TABLE = np.radians([[-90, -10, 60, -20, -40], [10, -10, 40, 60, 10]])


@pytest.fixture(scope="module")
def plan(planner):
    def plan(goal, q_start=HOME, scene=None, limits=LIMITS, **options):
        scene = scene or Scene()
        return planner.plan(
            PlanRequest(q_start=q_start, goal=goal, limits=limits, scene=scene, **options)
        )

    return plan


def assert_sound(model, collision, made, limits=LIMITS):
    """The motion begins and ends at rest where it should, keeps limits and touches nothing."""
    motion = made.trajectory
    assert np.array_equal(motion.q[0], made.q_start)
    assert np.array_equal(motion.q[-1], made.q_goal)
    assert not np.any(motion.qd[[0, -1]])
    report = limit_report(motion, limits, model.lower, model.upper)
    assert report.worst <= 1.002
    assert report.outside.max() <= 1e-6
    assert min(collision.clearance(q).distance for q in motion.q) > 0.0


def test_a_joint_goal_is_one_straight_line(model, collision, plan):
    made = plan(JointGoal(q=GOAL))
    assert_sound(model, collision, made)
    assert made.tool_path[0] == pytest.approx(model.frame(HOME).p)
    assert made.tool_path[-1] == pytest.approx(model.frame(GOAL).p)
    assert 2 < len(made.tool_path) <= 64
    assert np.array_equal(made.q_goal, GOAL)
    assert np.array_equal(made.path, [HOME, GOAL])
    assert made.report.straight
    share = made.trajectory.q[:, 0] / GOAL[0]
    assert made.trajectory.q == pytest.approx(np.outer(share, GOAL), abs=1e-9)


@pytest.mark.parametrize(
    ("q_start", "frame", "p_base"),
    [
        # Close above the table: with the hand as it is now, it would touch.
        (np.radians([0, 30, -20, -40, 0]), "tool", (0.22, 0.0, 0.06)),
        # A little above the table; all candidates of inverse kinematics are too close to it.
        (HOME, "jaw_tip", None),
    ],
    ids=["another posture", "a narrow range of postures"],
)
def test_a_point_that_only_few_postures_reach_freely_is_reached(
    model, collision, plan, q_start, frame, p_base
):
    if p_base is None:
        q = np.radians([22.04, 54.68, -29.32, 10.51, -81.2])
        p_base = model.frame(q, frame).p + np.array([0.0, 0.0, 2e-4])
    made = plan(PoseGoal.at_point(p_base, frame=frame), q_start)
    assert_sound(model, collision, made)
    assert model.frame(made.q_goal, frame).p == pytest.approx(p_base, abs=1e-4)


def test_the_report_says_how_the_plan_came_about(plan):
    report = plan(JointGoal(q=GOAL)).report
    assert set(report.stages_ms) == {"path", "retime", "verify", "total"}
    assert sum(report.stages_ms.values()) <= 2.0 * report.stages_ms["total"]
    assert 0.003 < report.clearance < 0.2
    assert len(report.closest) == 2
    assert not report.departure


def test_without_tolerance_the_arm_stops_at_the_waypoints(model, collision, plan):
    made = plan(PathGoal(waypoints=WAYPOINTS, tolerance=0.0))
    assert_sound(model, collision, made)
    for waypoint in WAYPOINTS:
        nearest = np.abs(made.trajectory.q - waypoint).max(axis=1).argmin()
        assert made.trajectory.q[nearest] == pytest.approx(waypoint, abs=1e-9)
        assert made.trajectory.qd[nearest] == pytest.approx(np.zeros(5), abs=1e-9)


def test_waypoints_on_one_line_are_one_straight_move(plan):
    steps = np.linspace(0.0, 1.0, 30)[:, None] * GOAL
    made = plan(PathGoal(waypoints=np.repeat(steps, 2, axis=0)))
    assert made.report.straight
    assert made.duration == pytest.approx(plan(JointGoal(q=GOAL)).duration)


@pytest.mark.parametrize(
    "goal",
    [
        JointGoal(q=GOAL),
        PathGoal(waypoints=WAYPOINTS),
        LineGoal(T_base_tool=SE3.from_translation((0.30, 0.05, 0.20))),
    ],
    ids=["joints", "waypoints", "line"],
)
def test_the_cap_on_tool_speed_is_kept(model, plan, goal):
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=0.08)
    made = plan(goal, limits=limits)
    points = np.array([model.frame(q).p for q in made.trajectory.q])
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / made.trajectory.dt
    assert 0.07 < speed.max() < 0.08 * 1.002


def test_a_moving_arm_that_brakes_harder_than_its_caps_goes_on_from_where_it_comes_to_rest(plan):
    hard = MotionLimits.uniform(velocity=3.0, acceleration=30.0, jerk=3000.0)
    lead = online.stop(HOME, np.ones(5), np.zeros(5), hard, 0.01).since(2)
    made = plan(JointGoal(q=GOAL), lead.q[-1], lead=lead)
    np.testing.assert_array_equal(made.trajectory.q[: len(lead)], lead.q)
    goes_on = made.trajectory.since(len(lead) - 1)
    assert limit_report(lead, LIMITS).acceleration.max() > 2.0
    assert limit_report(goes_on, LIMITS).worst <= 1.002
    np.testing.assert_allclose(goes_on.q[-1], GOAL)


@pytest.mark.parametrize("what", ["joints", "pose", "waypoints", "line"])
def test_a_goal_that_is_where_the_arm_stands_takes_no_time(model, plan, what):
    goal = {
        "joints": JointGoal(q=GOAL),
        "pose": PoseGoal(T_base_tool=model.frame(GOAL)),
        "waypoints": PathGoal(waypoints=np.array([GOAL, GOAL])),
        "line": LineGoal(T_base_tool=model.frame(GOAL)),
    }[what]
    made = plan(goal, GOAL)
    assert made.duration == 0.0
    assert np.array_equal(made.trajectory.q, [GOAL])


def test_a_resting_arm_leaves_slowly_and_then_moves(model, collision, plan):
    made = plan(JointGoal(q=HOME), RESTING)
    assert made.report.departure
    assert not made.report.straight
    assert np.array_equal(made.path[0], RESTING)
    q_exit = made.path[1]
    assert model.outside(q_exit) is None
    outside = np.any((made.trajectory.q < model.lower) | (made.trajectory.q > model.upper), axis=1)
    last_outside = int(np.flatnonzero(outside)[-1])
    assert np.abs(made.trajectory.qd[: last_outside + 1]).max() <= 0.2501
    assert np.all(np.diff(outside.astype(int)) <= 0)
    assert limit_report(made.trajectory, LIMITS).worst <= 1.002
    assert np.array_equal(made.q_goal, HOME)


TOO_FAR = np.radians([0, 0, 95, 0, 0])


@pytest.mark.parametrize(
    ("start", "goal", "error", "says"),
    [
        (BELOW, JointGoal(q=HOME), "start", "at the start the jaw is .* mm into the floor"),
        (HOME, JointGoal(q=BELOW), "goal", "at the goal the jaw would be .* mm into the"),
        (HOME, PoseGoal.at_point((0.25, 0.0, -0.05)), "goal",
         r"in the best of \d+ postures, .* the floor"),
        (HOME, PathGoal(waypoints=np.array([BELOW, HOME])), "path",
         "at waypoint 1 of 2 the jaw would be"),
        (OVER_THE_TABLE[0], PathGoal(waypoints=OVER_THE_TABLE[1:]), "path",
         "between the start and waypoint 1 the "),
        (OVER_THE_TABLE[0], PathGoal(waypoints=OVER_THE_TABLE + 1e-3), "path",
         "between waypoint 1 and waypoint 2 the "),
        (HOME, JointGoal(q=TOO_FAR), OutsideLimits, r"elbow_flex = 95\.00 .* -96\.82 to 90\.80"),
        (HOME, PathGoal(waypoints=np.vstack([WAYPOINTS, TOO_FAR])), OutsideLimits,
         "waypoint 5 of 5: elbow_flex = 95"),
        (HOME, PoseGoal.at_point((0.6, 0.0, 0.2)), Unreachable, "mm out of reach; the nearest"),
        (HOME, PathGoal(waypoints=np.empty((0, 5))), ConfigError, "at least one waypoint"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_with_what_is_in_the_way(plan, start, goal, error, says):
    """``error``, or where it is in contact."""
    contact = isinstance(error, str)
    with pytest.raises(InCollision if contact else error, match=says) as caught:
        plan(goal, start)
    assert not contact or (caught.value.where, caught.value.second) == (error, "floor")


def test_giving_up_at_once_asks_for_more_time(plan):
    start, goal = OVER_THE_TABLE
    with pytest.raises(NoPath, match=r"no path found in 0\.000 s; allow more time"):
        plan(JointGoal(q=goal), start, time_budget=1e-9)


def request_of(**changes):
    return PlanRequest(**{"q_start": HOME, "goal": JointGoal(q=GOAL), "limits": LIMITS} | changes)


@pytest.mark.parametrize(
    ("make", "key", "bad"),
    [
        (request_of, "q_start", [np.full(5, np.nan)]),
        (request_of, "q_jaw", [np.inf]),
        (request_of, "dt", [0.0]),
        (request_of, "time_budget", [-1.0]),
        (request_of, "seed", [-1, 1.5]),
        (partial(PathGoal, waypoints=WAYPOINTS), "tolerance", [-0.1, np.nan, np.inf]),
        (LeaveContactGoal, "farthest", [0.0, -1.0, 2.1, np.nan]),
    ],
)
def test_invalid_input_is_refused_by_its_key(make, key, bad):
    for value in bad:
        with pytest.raises(ConfigError, match=f'"{key}'):
            make(**{key: value})
    with pytest.raises(ConfigError, match="must be a goal"):
        request_of(goal="ready")


@pytest.mark.parametrize("goal", [PoseGoal, LineGoal, ApproachGoal])
@pytest.mark.parametrize("far", [1e305, 1e308, 2_000.0])
def test_a_goal_out_of_this_world_is_refused(goal, far):
    with pytest.raises(ConfigError, match="did you mean millimetres"):
        goal(T_base_tool=SE3.from_translation([0.2, -far, 0.1]))


def test_a_line_that_would_take_long_to_look_along_is_refused():
    with pytest.raises(ConfigError, match="did you mean millimetres"):
        LineGoal(T_base_tool=SE3.from_translation([30.0, 0.0, 0.1]))


# A plan that is given up


Q_START = np.radians([60.0, 0.0, 0.0, 0.0, 0.0])
Q_GOAL = np.radians([-60.0, 0.0, 10.0, 0.0, 0.0])


def scene():
    post = obstacle("post", (0.05, 0.05, 0.3), (0.3, 0.0, 0.15))
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (40_000, 3))
    cloud = obstacle("cloud", PointCloud(points=points, resolution=0.01), (0.2, 0.3, 0.05))
    return Scene(obstacles=(post, cloud))


class Patience:
    """A checkpoint that gives up at a certain call."""

    def __init__(self):
        self.calls, self.last = 0, None

    def __call__(self):
        self.calls += 1
        if self.calls == self.last:
            raise Abandoned


@pytest.mark.parametrize("kind", ["joints", "pose", "line", "path"])
def test_a_plan_that_is_given_up_anywhere_leaves_the_planner_as_it_was(model, kind):
    goal = {
        "joints": JointGoal(q=Q_GOAL),
        "pose": PoseGoal(T_base_tool=model.frame(Q_GOAL)),
        "line": LineGoal(
            T_base_tool=SE3(
                model.frame(Q_START).R, model.frame(Q_START).p + np.array([0.0, 0.02, 0.02])
            )
        ),
        "path": PathGoal(waypoints=np.array([Q_START + 0.1, Q_START - 0.1])),
    }[kind]
    request = PlanRequest(q_start=Q_START, goal=goal, limits=LIMITS, scene=scene())
    patience = Patience()
    wanted = Planner(model, patience).plan(request)
    assert patience.calls > 20
    planner, given_up = Planner(model, patience), 0
    for last in np.unique(np.geomspace(1, patience.calls, 8).astype(int)).tolist():
        patience.calls, patience.last = 0, last
        try:
            planner.plan(request)  # what has been built for the scene by now is kept
        except Abandoned:
            given_up += 1
    assert given_up > 4
    patience.last = None
    made = planner.plan(request)
    assert np.array_equal(made.trajectory.q, wanted.trajectory.q)
    assert np.array_equal(made.path, wanted.path)


# From above, all over the table


DOWN = np.diag([1.0, -1.0, -1.0])
HOVER, DESCENDED = 0.040, 0.005
CUBE = 0.020
JAW_OPEN = 0.5

PLACES = [
    (radius, azimuth) for radius in (0.11, 0.22) for azimuth in np.radians((-80.0, -25.0, 85.0))
]
YAWS = np.radians((0.0, 100.0, 230.0))


def over(model, radius, azimuth, yaw, height):
    """The jaw's tip, pointing down, so far above the middle of a cube on the table."""
    x, y = (0.0388353, 0.0) + radius * np.array([np.cos(azimuth), np.sin(azimuth)])
    return SE3(rot_z(yaw) @ DOWN, (x, y, FLOOR_Z + 0.5 * CUBE + height))


def request(q_start, goal):
    return PlanRequest(q_start=q_start, goal=goal, limits=LIMITS, q_jaw=JAW_OPEN)


@pytest.mark.parametrize(("radius", "azimuth"), PLACES)
def test_from_above_every_place_and_yaw_is_reached_and_left_again(model, planner, radius, azimuth):
    for yaw in YAWS:
        goal = ApproachGoal(
            T_base_tool=over(model, radius, azimuth, yaw, DESCENDED),
            hover=(0.0, 0.0, HOVER - DESCENDED),
            frame="jaw_tip",
        )
        down = planner.plan(request(np.zeros(5), goal))
        tip = model.frame(down.q_goal, "jaw_tip")
        assert tip.p == pytest.approx(goal.T_base_tool.p, abs=1e-4)
        assert tip.R[:, 2] == pytest.approx([0.0, 0.0, -1.0], abs=0.02)
        last = np.array([model.frame(q, "jaw_tip").p for q in down.trajectory.q[-20:]])
        assert np.abs(last[:, :2] - tip.p[:2]).max() < 1e-4  # straight down
        up = LineGoal(
            T_base_tool=over(model, radius, azimuth, yaw, HOVER),
            frame="jaw_tip",
            metric=GoalMetric.POSITION_AND_APPROACH,
        )
        planner.plan(request(down.q_goal, up))


@pytest.mark.parametrize(
    ("radius", "height", "error", "says"),
    [
        (0.16, -0.03, InCollision, r"the jaw_tip can follow \d+ of the 40 mm .* the floor"),
        (0.6, 0.0, Unreachable, "out of reach"),
    ],
)
def test_an_approach_that_cannot_be_made_says_why(model, planner, radius, height, error, says):
    T = over(model, radius, 0.0, 0.0, height)
    with pytest.raises(error, match=says):
        planner.plan(request(np.zeros(5), ApproachGoal(T_base_tool=T, frame="jaw_tip")))


# Leaving contact


LOW = np.array([0.3, 1.2, 0.0, 1.2, 0.5])
"""The gripper is far below the table."""

CALM = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=50.0)


def left(model, q_start, scene=None):
    request = PlanRequest(
        q_start=q_start, goal=LeaveContactGoal(), limits=CALM, scene=scene or Scene()
    )
    return Planner(model).plan(request)


def test_it_rises_and_stops_as_soon_as_it_is_free(model):
    found = left(model, LOW)
    collision = CollisionModel(model)
    heights = [model.frame(q).p[2] for q in found.trajectory.q]
    assert np.all(np.diff(heights) > -1e-6)
    assert collision.is_free(found.q_goal)
    halfway = LOW + 0.5 * (found.q_goal - LOW)
    assert not collision.is_free(halfway), "it goes no farther than it must"
    assert left(model, np.zeros(5)).trajectory.duration == 0.0, "a free arm stays"


def test_an_arm_that_is_buried_is_told_of_the_hand(model):
    buried = Obstacle(name="heap", shape=Sphere(radius=0.9), T_base_obstacle=SE3.identity())
    with pytest.raises(InCollision, match="no straight motion frees it; guide it by hand"):
        left(model, np.zeros(5), Scene(obstacles=(buried,)))


# Among obstacles, with something in the hand, and within an arm's own joint limits


# The finger's tip 30 cm ahead and 7 cm above the table.
LEFT, AHEAD, RIGHT = np.radians([[-45, 0, 10, 50, 0], [0, 0, 10, 50, 0], [45, 0, 10, 50, 0]])


POST = obstacle("post", (0.06, 0.06, 0.3), (0.3, 0.0, 0.15))
LAMP = obstacle("lamp", (0.06, 0.06, 0.3), (0.3, 0.0, 0.15), keep_out=True)


def closest(model, scene, motion, q_jaw=0.0):
    collision = CollisionModel(model, scene)
    return min(collision.clearance(q, q_jaw).distance for q in motion.q)


@pytest.mark.parametrize(
    ("start", "goal", "obstacle", "where", "says"),
    [
        (LEFT, JointGoal(q=AHEAD), POST, "goal", r"at the goal the .* into 'post' \(3 mm must"),
        (LEFT, JointGoal(q=AHEAD), LAMP, "goal", "into the keep-out zone 'lamp'"),
        (AHEAD, JointGoal(q=RIGHT), obstacle("crate", (0.2, 0.3, 0.3), (0.35, 0.0, 0.15)), "start",
         r"at the start the .* mm into 'crate', and no"),
        (LEFT, PathGoal(waypoints=RIGHT[None]), POST, "path",
         "between the start and waypoint 1 the .* 'post'"),
    ],
)  # fmt: skip
def test_an_obstacle_in_the_way_is_named(plan, start, goal, obstacle, where, says):
    with pytest.raises(InCollision, match=says) as caught:
        plan(goal, start, Scene(obstacles=(obstacle,)))
    assert (caught.value.where, caught.value.second) == (where, obstacle.name)


def test_a_walled_off_path_is_refused_with_the_obstacles_name(plan):
    wall = Scene(
        obstacles=(obstacle("wall", (1.2, 0.02, 1.0), (0.3, 0.0, 0.5)),),
        may_touch=frozenset(
            frozenset({"wall", link}) for link in ("shoulder", "upper arm", "lower arm")
        ),
    )
    with pytest.raises(NoPath, match="path between them is blocked, mostly by 'wall'") as caught:
        plan(JointGoal(q=RIGHT), LEFT, wall, time_budget=0.5)
    assert caught.value.where == "path"
    assert caught.value.blockers[0] == "wall"


def stick(**settings):
    return Attached(
        name="stick",
        shape=Box(size=(0.02, 0.24, 0.02)),
        T_tool_object=SE3.from_translation((0.0, 0.0, 0.1)),
        **settings,
    )


def test_a_goal_that_only_what_is_held_cannot_have_names_it(model, plan):
    low = np.radians([0, 0, 20, 40, 90])
    assert plan(JointGoal(q=low), LEFT).q_goal is not None
    with pytest.raises(InCollision, match=r"at the goal 'stick' would be .* into the floor"):
        plan(JointGoal(q=low), LEFT, Scene(attached=(stick(),)))
    touching = Scene(attached=(stick(may_touch=frozenset({"floor"})),))
    assert np.array_equal(plan(JointGoal(q=low), LEFT, touching).q_goal, low)


# An arm's own joint limits


@pytest.fixture
def narrow(model):
    """Limits within which the elbow cannot bend far."""
    lower, upper = np.array(model.lower), np.array(model.upper)
    lower[2], upper[2] = np.radians([-20.0, 30.0])
    return {"lower": lower, "upper": upper}


def test_a_path_around_something_stays_within_them(model, plan):
    limits = {
        "lower": np.radians([-60, -30, -10, 0, -20]),
        "upper": np.radians([60, 40, 40, 90, 20]),
    }
    post = Scene(obstacles=(obstacle("post", (0.06, 0.06, 0.12), (0.3, 0.0, 0.06)),))
    made = plan(JointGoal(q=RIGHT), LEFT, post, **limits)
    assert not made.report.straight
    assert np.all(made.trajectory.q >= limits["lower"] - 1e-6)
    assert np.all(made.trajectory.q <= limits["upper"] + 1e-6)


def test_a_joint_goal_outside_them_is_refused_as_outside_the_calibrated_range(plan, narrow):
    q = np.radians([0, 0, 40, 0, 0])
    with pytest.raises(OutsideLimits, match=r"elbow_flex = 40\.00 deg .* calibrated range -20\.00"):
        plan(JointGoal(q=q), LEFT, **narrow)
    with pytest.raises(OutsideLimits, match="waypoint 2 of 2: elbow_flex = 40"):
        plan(PathGoal(waypoints=np.array([RIGHT, q])), LEFT, **narrow)
    assert np.array_equal(plan(JointGoal(q=q), LEFT).q_goal, q)


def test_a_point_that_only_other_joints_reach_is_out_of_reach(model, plan, narrow):
    p = np.array([0.13, 0.0, 0.15])
    assert np.degrees(plan(PoseGoal.at_point(p), LEFT).q_goal[2]) > 30.0
    with pytest.raises(Unreachable, match="elbow_flex at its upper limit"):
        plan(PoseGoal.at_point(p), LEFT, **narrow)


def test_limits_wider_than_the_models_change_nothing(model, plan):
    wide = {"lower": model.lower - 1.0, "upper": model.upper + 1.0}
    with pytest.raises(OutsideLimits, match=r"elbow_flex = 95\.00 deg is outside its limits"):
        plan(JointGoal(q=np.radians([0, 0, 95, 0, 0])), LEFT, **wide)


def test_limits_that_leave_no_angle_are_refused_by_joint(plan, narrow):
    narrow["lower"][2] = narrow["upper"][2] + 0.1
    with pytest.raises(ConfigError, match=r'"elbow_flex" = .* not below the upper'):
        plan(JointGoal(q=RIGHT), LEFT, **narrow)
