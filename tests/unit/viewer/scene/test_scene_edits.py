from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from so101_viewer.scene import scene_edits
from so101_viewer.scene.scene_edits import NEW_SHAPES
from so101_viewer.scene.scene_view import hit

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import (
    FLOOR_Z,
    Attached,
    Box,
    Capsule,
    Mesh,
    Obstacle,
    PointCloud,
    Scene,
    Sphere,
)

MUG = Obstacle(
    name="mug",
    shape=Box(size=np.array([0.08, 0.08, 0.1])),
    T_base_obstacle=SE3.from_rpy((0.1, 0.2, 0.3), (0.25, 0.05, 0.05)),
)
CUBE = Attached(
    name="cube",
    shape=Sphere(radius=0.01),
    T_tool_object=SE3.from_translation((0.0, 0.0, 0.1)),
    may_touch=frozenset(["mug", "floor"]),
)
SCENE = Scene(
    obstacles=(MUG,),
    attached=(CUBE,),
    may_touch=frozenset([frozenset(["mug", "gripper"]), frozenset(["cube", "mug"])]),
)

poses = st.builds(
    lambda rpy, p: SE3.from_rpy(rpy, p),
    st.tuples(*[st.floats(-1.0, 1.0)] * 3),
    st.tuples(*[st.floats(-0.5, 0.5)] * 3),  # two are less than 2 m apart, which would be asked
)


def test_a_new_name_is_followed_wherever_the_old_one_stood_and_a_removed_one_is_gone_there():
    assert scene_edits.renamed(SCENE, "mug", "mug") == SCENE
    scene = scene_edits.renamed(SCENE, "mug", "  big   mug ")
    assert scene.obstacles[0].name == "big mug"
    assert scene.attached[0].may_touch == {"big mug", "floor"}
    assert scene.may_touch == {frozenset(["big mug", "gripper"]), frozenset(["cube", "big mug"])}
    with pytest.raises(ConfigError, match="is not in the scene any more"):
        scene_edits.without(SCENE, "jug")
    scene = scene_edits.without(SCENE, "mug")
    assert scene.obstacles == ()
    assert scene.attached[0].may_touch == {"floor"}
    assert scene.may_touch == frozenset()


@pytest.mark.parametrize("name", ["", "   ", "cube", "floor", "wrist", "x" * 41, "a\x00b"])
def test_a_name_that_nothing_can_have_is_refused(name):
    with pytest.raises(ConfigError):
        scene_edits.renamed(SCENE, "mug", name)


@pytest.mark.parametrize("kind", NEW_SHAPES)
def test_new_things_stand_on_the_floor_and_apart(kind):
    scene = Scene()
    for _ in range(12):
        scene = scene_edits.added(scene, NEW_SHAPES[kind], name=kind)
    places = np.array([each.T_base_obstacle.p for each in scene.obstacles])
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2) + np.eye(len(places))
    assert gaps.min() > 0.09
    assert len({each.name for each in scene.obstacles}) == 12
    half = {"box": 0.02, "sphere": 0.02, "capsule": 0.06}[kind]
    assert 0.0 <= places[0, 2] - half - FLOOR_Z < 0.002


def test_a_mesh_stands_on_its_lowest_point():
    mesh = Mesh(vertices=[[0, 0, -0.2], [0.1, 0, 0], [0, 0.1, 0]], triangles=[[0, 1, 2]])
    thing = scene_edits.added(Scene(floor_z=None), mesh, name="part").obstacles[0]
    assert thing.T_base_obstacle.p[2] == pytest.approx(0.2 + FLOOR_Z, abs=0.002)


def test_figures_that_do_not_belong_to_a_shape_change_nothing():
    assert scene_edits.resized(Sphere(radius=0.1), size=np.ones(3)) == Sphere(radius=0.1)
    longer = scene_edits.resized(Capsule(radius=0.1, length=0.3), length=0.4)
    assert longer == Capsule(radius=0.1, length=0.4)
    with pytest.raises(ConfigError, match="twice its radius"):
        scene_edits.resized(longer, radius=0.3)


@given(poses, poses)
def test_what_is_attached_and_detached_is_where_it_was(T_base_tool, T_base_mug):
    mug = scene_edits.moved(MUG, T_base_mug)
    scene = Scene(obstacles=(mug,))
    held = scene_edits.held(scene, "mug", T_base_tool)
    with pytest.raises(ConfigError, match="which cannot be held"):  # a zone of air
        scene_edits.held(Scene(obstacles=(replace(mug, keep_out=True),)), "mug", T_base_tool)
    assert held.obstacles == ()
    there = T_base_tool @ held.attached[0].T_tool_object
    np.testing.assert_allclose(there.matrix, T_base_mug.matrix, atol=1e-9)
    back = scene_edits.let_go(held, "mug", T_base_tool).obstacles[0]
    np.testing.assert_allclose(back.T_base_obstacle.matrix, T_base_mug.matrix, atol=1e-9)


DOWN = np.array([0.0, 0.0, -2.0])  # of any length
PYRAMID = Mesh(
    vertices=0.01 * np.array([[4, 4, 0], [-4, 4, 0], [-4, -4, 0], [4, -4, 0], [0, 0, 6]]),
    triangles=np.array([[0, 1, 2], [2, 3, 0], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]),
)


def scene(shape, floor_z=0.0):
    thing = Obstacle(
        name="thing", shape=shape, T_base_obstacle=SE3.from_translation(np.array([0.2, 0.0, 0.1]))
    )
    return Scene(obstacles=(thing,), floor_z=floor_z)


@pytest.mark.parametrize(
    ("shape", "top"),
    [
        (Box(size=np.array([0.1, 0.1, 0.04])), 0.12),
        (Sphere(radius=0.03), 0.13),
        (Capsule(radius=0.02, length=0.1), 0.15),
        (PYRAMID, 0.16),
        (PointCloud(points=[[0.003, 0.003, 0.012], [0.1, 0.1, 0.1]], resolution=0.01), 0.12),
    ],
)
def test_a_click_from_above_meets_the_top_of_a_thing_or_the_floor(shape, top):
    around = scene(shape)
    met = hit(around, np.array([0.2, 0.0, 1.0]), DOWN)
    np.testing.assert_allclose(met, [0.2, 0.0, top], atol=0.003)
    met = hit(around, np.array([0.4, 0.1, 1.0]), DOWN)
    np.testing.assert_allclose(met, [0.4, 0.1, 0.0], atol=1e-9)


def test_a_click_meets_the_side_of_a_box_a_mesh_and_a_cloud_that_is_towards_it():
    level = np.array([-1.0, 0.0, 0.0])
    met = hit(scene(Box(size=np.array([0.1, 0.1, 0.04]))), np.array([1.0, 0.0, 0.1]), level)
    np.testing.assert_allclose(met, [0.25, 0.0, 0.1], atol=1e-9)
    met = hit(scene(PYRAMID), np.array([1.0, 0.0, 0.13]), level)
    np.testing.assert_allclose(met, [0.22, 0.0, 0.13], atol=1e-9)  # half its height, half its width
    cloud = PointCloud(points=[[x, 0.005, 0.005] for x in (-0.05, 0.0, 0.05)], resolution=0.02)
    met = hit(scene(cloud), np.array([1.0, 0.01, 0.11]), level)
    np.testing.assert_allclose(met, [0.26, 0.01, 0.11], atol=1e-9)
    assert hit(scene(cloud, floor_z=None), np.array([1.0, 0.03, 0.11]), level) is None
