from dataclasses import replace

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError, NoPath, Overloaded
from so101_motion.common.geometry import SE3
from so101_motion.common.units import to_rad
from so101_motion.files.tool_file import find_tool
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import FLOOR_Z, Box, Cylinder, Obstacle, Scene, Sphere
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.picking.grasps import BESIDE, SQUARE, Wishes
from so101_motion.planning.picking.pick_plan import STAGES, PickRequest, Place, plan_pick
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Strength

MODEL = RobotModel.load()
START = np.array([0.0, -1.7, 1.5, 1.2, 0.0])
LIMITS = MotionLimits.uniform(velocity=1.5, acceleration=1.7, jerk=20.0)


@pytest.fixture(scope="module")
def planner():
    return Planner(MODEL)


def standing(shape, x, y, *, half, yaw=0.0, name="cube", mass=0.02):
    T = SE3.from_rpy((0.0, 0.0, yaw), (x, y, FLOOR_Z + half))
    return Obstacle(name=name, shape=shape, T_base_obstacle=T, mass=mass)


def asked(*things, place=None, wishes=None, **changed):
    request = PlanRequest(
        q_start=START, goal=JointGoal(q=START), limits=LIMITS, scene=Scene(obstacles=things),
        strength=Strength.of_servos(12.0),
    )  # fmt: skip
    wishes = wishes or Wishes()
    return PickRequest(request=request, item="cube", place=place, wishes=wishes, **changed)


CUBE = standing(Box(size=(0.03, 0.03, 0.03)), 0.2, 0.05, half=0.015, yaw=0.5)


@pytest.mark.parametrize(
    "item",
    [
        CUBE,
        standing(Cylinder(radius=0.012, length=0.04), 0.16, -0.1, half=0.02),
        standing(Sphere(radius=0.02), 0.25, 0.0, half=0.02),
    ],
    ids=["cube", "cylinder", "ball"],
)
def test_all_stages_follow_each_other_and_the_item_ends_where_it_was_to_be_put(planner, item):
    plan = plan_pick(planner, asked(item, place=Place(p=(0.15, 0.15, 0.0))))
    assert tuple(plan.plans) == STAGES
    q = START
    for name, each in plan.plans.items():
        np.testing.assert_allclose(each.q_start, q, atol=1e-9, err_msg=name)
        q = each.q_goal
    # The pad of the fixed finger is beside the item by what the plan says, at its own places.
    grasp = plan.grasp
    assert grasp.square <= SQUARE
    tip = MODEL.frame(plan.plans["reach"].q_goal, "jaw_tip")
    held = plan.scenes["carry"].attached[0]
    T_held = MODEL.frame(plan.plans["reach"].q_goal) @ held.T_tool_object
    moved = tip.R.T @ (T_held.p - item.T_base_obstacle.p)
    np.testing.assert_allclose(moved, (BESIDE, 0.0, 0.0), atol=2e-4)
    assert plan.q_jaw_closed < plan.q_jaw_open
    put = plan.scenes["end"].items[0].T_base_obstacle
    np.testing.assert_allclose(put.p[:2], (0.15, 0.15), atol=1e-3)
    assert put.p[2] == pytest.approx(item.T_base_obstacle.p[2], abs=5e-4)
    assert put.R[2, 2] == pytest.approx(1.0, abs=1e-3)
    # What it is carried with is a body of its own: nothing but what it stood on may be near.
    for name, q_jaw in (("carry", plan.q_jaw_closed), ("leave", plan.q_jaw_free)):
        collision = CollisionModel(MODEL, plan.scenes[name])
        q = plan.plans[name].trajectory.q
        assert collision.first_blocked(q, q_jaw, tolerance=0.2) is None


def test_what_cannot_be_gripped_is_told_with_the_reason(planner):
    wide = standing(Box(size=(0.072, 0.08, 0.072)), 0.2, 0.0, half=0.036)
    with pytest.raises(NoPath, match="is 12 mm too wide: 72 mm"):
        plan_pick(planner, asked(wide))
    far = standing(Box(size=(0.03, 0.03, 0.03)), 0.7, 0.0, half=0.015)
    with pytest.raises(NoPath, match="out of reach: 700 mm"):
        plan_pick(planner, asked(far))
    walls = [
        standing(Box(size=(0.12, 0.12, 0.02)), 0.2, 0.05, half=0.06, name="lid", mass=None),
        *(
            standing(Box(size=size, ), 0.2 + x, 0.05 + y, half=0.03, name=f"wall {k}", mass=None)
            for k, (x, y, size) in enumerate(
                [
                    (0.06, 0.0, (0.02, 0.14, 0.06)), (-0.06, 0.0, (0.02, 0.14, 0.06)),
                    (0.0, 0.06, (0.14, 0.02, 0.06)), (0.0, -0.06, (0.14, 0.02, 0.06)),
                ]
            )
        ),
    ]  # fmt: skip
    with pytest.raises(NoPath, match=r"no approach to 'cube' is free: .* too near"):
        plan_pick(planner, asked(CUBE, *walls))
    lead = standing(Box(size=(0.03, 0.03, 0.03)), 0.3, 0.05, half=0.015, mass=1.5)
    with pytest.raises(Overloaded, match="'cube' is too heavy at that reach"):
        plan_pick(planner, asked(lead))
    with pytest.raises(ConfigError, match='did you mean "cube"'):
        plan_pick(planner, PickRequest(request=asked(CUBE).request, item="cubes"))
    with pytest.raises(ConfigError, match="the scene is empty"):
        plan_pick(planner, asked())


def test_users_add_and_forbid_grasps(planner):
    best = plan_pick(planner, asked(CUBE)).grasp
    never = Wishes(never=(best.T_item_tip,))
    other = plan_pick(planner, asked(CUBE, wishes=never)).grasp
    assert not other.is_like(best.T_item_tip)
    only = plan_pick(planner, asked(CUBE, wishes=Wishes(only=(other.T_item_tip,)))).grasp
    assert only.is_like(other.T_item_tip)
    tall = standing(Box(size=(0.03, 0.03, 0.08)), 0.25, 0.0, half=0.04)
    side = plan_pick(planner, asked(tall, wishes=Wishes(kinds=("side",)))).grasp
    assert side.tilt >= to_rad(45.0)


def test_what_is_held_is_placed_upright_but_not_where_something_stands(planner):
    picked = plan_pick(planner, asked(CUBE))
    request = PlanRequest(
        q_start=picked.plans["lift"].q_goal, goal=JointGoal(q=START), limits=LIMITS,
        scene=picked.scenes["end"], q_jaw=picked.q_jaw_closed,
    )  # fmt: skip
    place = Place(p=(0.2, -0.1, 0.0), yaw=0.3)
    put = plan_pick(planner, PickRequest(request=request, item="cube", place=place))
    assert list(put.plans) == ["carry", "lower", "leave"]
    T = put.scenes["end"].items[0].T_base_obstacle
    np.testing.assert_allclose(T.rpy, (0.0, 0.0, 0.8), atol=0.02)
    block = standing(Box(size=(0.05, 0.05, 0.05)), 0.2, -0.1, half=0.025, name="block")
    with pytest.raises(NoPath, match="'cube' would stand in 'block' by"):
        plan_pick(planner, asked(CUBE, block, place=Place(p=(0.2, -0.1, 0.0))))


def test_a_camera_on_the_gripper_is_kept_off_the_table_and_is_not_what_is_held(planner):
    tool = find_tool("uvc-32x32")
    bare = asked(CUBE, place=Place(p=(0.15, 0.15, 0.0)))
    plan = plan_pick(
        planner, replace(bare, request=replace(bare.request, scene=tool.on(bare.request.scene)))
    )
    *parts, held = plan.scenes["carry"].attached
    assert (tuple(parts), held.name) == (tool.parts, "cube")
    collision = CollisionModel(MODEL, tool.on(Scene()))
    assert collision.first_contact(plan.plans["reach"].q_goal, plan.q_jaw_open) is None
    with pytest.raises(ConfigError, match="is part of the tool"):
        plan.scenes["carry"].putting("camera", SE3.identity())
