"""Plans among obstacles, with something in the hand, and within an arm's own joint limits."""

import numpy as np
import pytest
from harness.random_scenes import obstacle

from so101_motion.common.errors import ConfigError, InCollision, NoPath, OutsideLimits, Unreachable
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Attached, Box, PointCloud, Scene
from so101_motion.planning.goals import JointGoal, PathGoal, PoseGoal
from so101_motion.planning.planner import Planner, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
# The finger's tip 30 cm ahead and 7 cm above the table.
LEFT, AHEAD, RIGHT = np.radians([[-45, 0, 10, 50, 0], [0, 0, 10, 50, 0], [45, 0, 10, 50, 0]])


@pytest.fixture(scope="module")
def plan(planner):
    def plan(goal, q_start, scene=None, **options):
        return planner.plan(
            PlanRequest(
                q_start=q_start, goal=goal, limits=LIMITS, scene=scene or Scene(), **options
            )
        )

    return plan


POST = obstacle("post", (0.06, 0.06, 0.3), (0.3, 0.0, 0.15))
LAMP = obstacle("lamp", (0.06, 0.06, 0.3), (0.3, 0.0, 0.15), keep_out=True)
AROUND_POST = Scene(obstacles=(POST,))


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


def test_what_was_picked_up_from_the_floor_is_lifted_off_it(model, plan):
    q = np.radians([0, 0, 20, 40, 0])
    T_base_tool = model.frame(q)
    under = SE3(np.eye(3), np.array([*model.frame(q, "jaw_tip").p[:2], -0.0024 + 0.011]))
    cube = Attached(
        name="cube", shape=Box(size=(0.02, 0.02, 0.022)), T_tool_object=T_base_tool.inverse @ under
    )
    scene = Scene(attached=(cube,))
    assert not CollisionModel(model, scene).is_free(q, 0.3)
    made = plan(JointGoal(q=AHEAD - [0, 0.5, 0, 0, 0]), q, scene, q_jaw=0.3)
    assert made.report.departure
    collision = CollisionModel(model, scene)
    k = collision.pairs.index(("cube", "floor"))
    heights = np.array([collision.distances(each, 0.3)[k] for each in made.trajectory.q])
    assert heights.min() > -6e-4
    assert heights[-1] > 0.01


def test_surroundings_are_made_ready_once(model):
    calls = 0

    def count():
        nonlocal calls
        calls += 1

    x, y, z = np.meshgrid(*3 * [np.linspace(0.0, 0.1, 50)])
    cloud = PointCloud(points=np.column_stack([x.ravel(), y.ravel(), z.ravel()]), resolution=0.02)
    planner, counts = Planner(model, count), []
    for _ in range(3):
        scene = Scene(obstacles=(obstacle("cloud", cloud, (-0.3, 0.0, 0.1)),))
        before = calls
        planner.plan(PlanRequest(q_start=LEFT, goal=JointGoal(q=RIGHT), limits=LIMITS, scene=scene))
        counts.append(calls - before)
    assert counts[0] > counts[1] == counts[2]


# An arm's own joint limits


@pytest.fixture
def narrow(model):
    """Limits within which the elbow cannot bend far."""
    lower, upper = np.array(model.lower), np.array(model.upper)
    lower[2], upper[2] = np.radians([-20.0, 30.0])
    return {"lower": lower, "upper": upper}


def test_a_point_is_reached_with_the_joints_this_arm_has(model, plan, narrow):
    rng = np.random.default_rng(4)
    otherwise = 0
    for _ in range(30):
        q = rng.uniform(narrow["lower"], narrow["upper"])
        if not CollisionModel(model).is_free(q):
            continue
        goal = PoseGoal.at_point(model.frame(q).p)
        wide = plan(goal, np.radians([0, -60, 25, 60, 0]))
        made = plan(goal, np.radians([0, -60, 25, 60, 0]), **narrow)
        otherwise += not (narrow["lower"][2] <= wide.q_goal[2] <= narrow["upper"][2])
        assert np.all(made.trajectory.q >= narrow["lower"] - 1e-6)
        assert np.all(made.trajectory.q <= narrow["upper"] + 1e-6)
        assert model.frame(made.q_goal).p == pytest.approx(model.frame(q).p, abs=1e-4)
    assert otherwise > 2


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
    with pytest.raises(ConfigError, match=r'"elbow_flex" = .* leave the joint no angle'):
        plan(JointGoal(q=RIGHT), LEFT, **narrow)
