"""Meshes and clouds are as solid as a box, and what they do not enclose has no depth."""

import numpy as np
import pytest
import trimesh

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Box, Mesh, Obstacle, PointCloud, Scene, Sphere
from so101_motion.planning.goals import LeaveContactGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

SIZE = np.array([0.12, 0.16, 0.1])
MODEL = RobotModel.load()


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
        box = CollisionModel(MODEL, scene(Box(size=SIZE), p, R), compiled=compiled)
        for form in forms:
            other = CollisionModel(MODEL, scene(form, p, R), compiled=compiled)
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
    goal = LeaveContactGoal()
    plan = Planner(MODEL).plan(
        PlanRequest(q_start=np.zeros(5), goal=goal, limits=limits, scene=around)
    )
    assert collision.is_free(plan.q_goal)


def test_the_room_the_arm_stands_in_is_not_solid():
    room = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    assert CollisionModel(MODEL, scene(mesh(room), np.zeros(3))).is_free(np.zeros(5))


@pytest.mark.parametrize("shape", [Box(size=(0.0, 0.2, 0.2)), Sphere(radius=0.0)])
def test_plates_and_points_keep_their_margin(shape):
    tip = MODEL.frame(np.zeros(5)).p
    for compiled in (True, False):
        for beyond, free in ((0.0, False), (0.25, True)):
            around = scene(shape, tip + np.array([beyond, 0, 0]))
            collision = CollisionModel(MODEL, around, compiled=compiled)
            assert collision.is_free(np.zeros(5)) == free
