"""Meshes and clouds are as solid as a box, and what they do not enclose has no depth."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from harness.coal_check import CoalJudge

from so101_motion.common.errors import ConfigError, InCollision
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import (
    Attached,
    Box,
    Mesh,
    Obstacle,
    PointCloud,
    Scene,
    Sphere,
)
from so101_motion.planning.differential.guard import Guard
from so101_motion.planning.differential.servo import Servo
from so101_motion.planning.differential.targets import Twist
from so101_motion.planning.goals import JointGoal, LeaveContactGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

SIZE = np.array([0.12, 0.16, 0.1])
MODEL = RobotModel.load()
LIMITS = MotionLimits.uniform(velocity=1.0, acceleration=4.0, jerk=60.0)


def mesh(surface):
    return Mesh(vertices=np.array(surface.vertices), triangles=np.array(surface.faces))


def scene(shape, p, R=None):
    R = np.eye(3) if R is None else R
    return Scene(
        obstacles=(Obstacle(name="block", shape=shape, T_base_obstacle=SE3(R, p)),), floor_z=None
    )


def forms_of_a_block():
    coarse = trimesh.creation.box(extents=SIZE)
    fine = coarse
    for _ in range(5):
        fine = fine.subdivide()
    axes = [(np.arange(round(size / 0.01)) + 0.5) * 0.01 - size / 2 for size in SIZE]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    shell = (np.abs(np.abs(grid) - (SIZE / 2 - 0.005)) < 1e-6).any(axis=1)
    return [mesh(coarse), mesh(fine), PointCloud(points=grid[shell])]


@pytest.mark.parametrize("compiled", [True, False])
def test_a_block_is_the_same_block_in_every_form(compiled):
    random, forms = np.random.default_rng(1), forms_of_a_block()
    for _ in range(20):
        q = random.uniform(MODEL.lower, MODEL.upper)
        p = MODEL.frame(q).p + random.uniform(-0.12, 0.12, 3)
        R = np.linalg.qr(random.standard_normal((3, 3)))[0]
        R *= np.linalg.det(R)
        box = (CollisionModel if compiled else CoalJudge)(MODEL, scene(Box(size=SIZE), p, R))
        for form in forms:
            other = (CollisionModel if compiled else CoalJudge)(MODEL, scene(form, p, R))
            assert other.is_free(q) == box.is_free(q)
            assert other.clearance(q).distance == pytest.approx(box.clearance(q).distance, abs=1e-3)


@pytest.mark.parametrize("sides", ["all", "front", "pocket"])
def test_what_the_arm_is_deep_in_can_be_left(sides):
    block = trimesh.creation.box(extents=(0.2, 0.3, 0.3))
    if sides == "front":
        block.update_faces(block.face_normals[:, 0] < -0.9)
    elif sides == "pocket":
        hole = trimesh.creation.box(extents=(0.1, 0.1, 0.1))
        block = block.difference(hole.apply_translation((0.1, 0.0, 0.0)))
    around = scene(mesh(block), MODEL.frame(np.zeros(5)).p + np.array([0.12, 0, 0]))
    collision = CollisionModel(MODEL, around)
    closest = collision.clearance(np.zeros(5))
    assert not collision.is_free(np.zeros(5))
    assert ("in contact with" in closest.message()) == (sides == "front")
    limits = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=50.0)
    request = PlanRequest(q_start=np.zeros(5), goal=LeaveContactGoal(), limits=limits, scene=around)
    plan = Planner(MODEL).plan(request)
    assert collision.is_free(plan.q_goal)
    assert plan.report.blind == (sides == "front")
    if sides == "front":
        with pytest.raises(InCollision, match="'block': how deep is not known, so lead it out by"):
            Planner(MODEL).plan(
                replace(request, goal=JointGoal(q=np.array([1.5, -1.0, 0.5, 0.5, 0.0])))
            )


def test_the_room_the_arm_stands_in_is_not_solid():
    room = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    assert CollisionModel(MODEL, scene(mesh(room), np.zeros(3))).is_free(np.zeros(5))


@pytest.mark.parametrize("shape", [Box(size=(0.0, 0.2, 0.2)), Sphere(radius=0.0)])
def test_plates_and_points_keep_their_margin(shape):
    tip = MODEL.frame(np.zeros(5)).p
    for compiled in (True, False):
        for beyond, free in ((0.0, False), (0.25, True)):
            around = scene(shape, tip + np.array([beyond, 0, 0]))
            collision = (CollisionModel if compiled else CoalJudge)(MODEL, around)
            assert collision.is_free(np.zeros(5)) == free


def front_of_a_block(form):
    """What a camera in front sees of a block 30 mm of whose front the gripper is in."""
    block = trimesh.creation.box(extents=(0.2, 0.3, 0.3))
    block.update_faces(block.face_normals[:, 0] < -0.9)
    if form == "cloud":
        shape = PointCloud(points=trimesh.sample.sample_surface(block, 9000, seed=1)[0])
    else:
        shape = mesh(block)
    return scene(shape, MODEL.frame(np.zeros(5)).p + np.array([0.07, 0, 0]))


@pytest.mark.parametrize("form", ["mesh", "cloud"])
def test_an_arm_in_a_surface_is_not_moved_by_jogs_followings_or_streams(form):
    collision, q = CollisionModel(MODEL, front_of_a_block(form)), np.zeros(5)
    servo = Servo(MODEL, collision, LIMITS, 0.01, q)
    for direction in np.vstack((np.eye(3), -np.eye(3))):
        for _ in range(20):
            servo.step(Twist(linear=0.1 * direction, angular=np.zeros(3)))
        np.testing.assert_array_equal(servo.q, q)
    assert "in contact with 'block': how deep is not known" in servo.held_by()[0]
    guard = Guard(collision, lambda: 0.0, acceleration=np.full(5, 10.5))
    assert guard.within_reach(q, q + 0.1) is q
    assert guard.against == servo.held_by()
    out = np.linspace(q, q - 0.002, 5)
    assert not guard.admits(out)
    assert guard.contact(out)[1] == "'block'"
    assert guard.contact(np.zeros((5, 5))) is None, "it may stay"
    assert guard.guided_to(q, q + 0.02) == pytest.approx(q + 0.02), "a hand may lead it"


def test_an_arm_in_the_wall_of_a_channel_is_jogged_out_but_not_in():
    parts = [trimesh.creation.box(extents=(0.2, 0.3, 0.04))]
    parts += [
        trimesh.creation.box(extents=(0.04, 0.3, 0.2)).apply_translation((x, 0, 0.08))
        for x in (-0.08, 0.08)
    ]
    channel = mesh(trimesh.boolean.union(parts))
    tip = MODEL.frame(np.zeros(5)).p
    ahead = tip + np.array([0.25, 0.0, -0.05])
    gap = CollisionModel(MODEL, scene(channel, ahead)).clearance(np.zeros(5)).distance
    for depth in (0.003, 0.010, 0.030):
        around = scene(channel, ahead - np.array([gap + depth, 0.0, 0.0]))
        collision = CollisionModel(MODEL, around)
        before = collision.clearance(np.zeros(5)).distance
        assert -depth - 0.002 < before < 0.0
        for away, out in ((-1.0, True), (1.0, False)):
            servo = Servo(MODEL, collision, LIMITS, 0.01, np.zeros(5))
            for _ in range(100):
                servo.step(Twist(linear=(0.05 * away, 0.0, 0.0), angular=np.zeros(3)))
            assert (MODEL.frame(servo.q).p[0] < tip[0] - 0.02) == out
            assert collision.clearance(servo.q).distance > before - 1e-4


def test_a_sheet_that_belongs_to_a_solid_has_no_depth_while_the_solid_has():
    solid = trimesh.creation.box(extents=(0.1, 0.1, 0.1)).difference(
        trimesh.creation.box(extents=(0.06, 0.06, 0.06)).apply_translation((0.04, 0, 0))
    )
    sheet = trimesh.creation.box(extents=(0.001, 0.3, 0.3)).apply_translation((0.0, 0.3, 0.0))
    sheet.update_faces(sheet.face_normals[:, 0] < -0.9)
    both = mesh(trimesh.util.concatenate([solid, sheet]))
    for y, known in ((0.0, True), (-0.3, False)):
        around = scene(both, MODEL.frame(np.zeros(5)).p + np.array([0.02, y, 0.0]))
        assert (CollisionModel(MODEL, around).clearance(np.zeros(5)).distance < 0.0) == known


@pytest.mark.parametrize("sides", [300, 1500])
def test_a_cylinder_of_many_sides_is_like_one_of_few(sides):
    tip, q = MODEL.frame(np.zeros(5)).p, np.zeros(5)
    few, many = (
        CollisionModel(MODEL, scene(mesh(trimesh.creation.cylinder(0.05, 0.2, sections=n)), tip))
        for n in (100, sides)
    )
    assert many.clearance(q).distance == pytest.approx(few.clearance(q).distance, abs=1e-4)


def test_a_fine_ball_in_the_hand_is_a_ball():
    fine = mesh(trimesh.creation.icosphere(subdivisions=4, radius=0.03))
    at = SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))
    fine, ball = (
        CollisionModel(MODEL, Scene(attached=(Attached(name="b", shape=e, T_tool_object=at),)))
        for e in (fine, Sphere(radius=0.03))
    )
    random = np.random.default_rng(0)
    for q in random.uniform(MODEL.lower, MODEL.upper, (20, 5)):
        off = ball.distances(q) - fine.distances(q)
        assert np.abs(off).max() < 5e-4, "it stands out by 0.3 mm at most"


def test_more_things_than_fit_a_mask_are_refused():
    things = tuple(
        Attached(name=f"{k}", shape=Sphere(radius=0.01), T_tool_object=SE3.identity())
        for k in range(25)
    )
    with pytest.raises(ConfigError, match="planned with at most 24"):
        Scene(attached=things)
