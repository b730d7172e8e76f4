import pickle
from dataclasses import replace

import numpy as np
import pytest

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
    ShapeFile,
    Sphere,
)

HERE = SE3.from_translation((0.3, 0.0, 0.1))
CORNERS = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])


def obstacle(name="mug", shape=None, pose=HERE, **settings):
    shape = shape or Sphere(radius=0.04)
    return Obstacle(name=name, shape=shape, T_base_obstacle=pose, **settings)


def touching(*names):
    return Scene(may_touch=frozenset({frozenset(names)}))


def held(name="pen", **settings):
    return Attached(
        name=name, shape=Capsule(radius=0.005, length=0.14), T_tool_object=HERE, **settings
    )


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Box(size=(0.1, -0.1, 0.1)), '"size" = .* must be 0 or more and at most 100 m'),
        (lambda: Box(size=(0.1, float("nan"), 0.1)), '"size" = .* must be 0 or more'),
        (lambda: Box(size=(0.1, 0.1)), r'"size" = .* must be an array of shape \(3,\)'),
        (lambda: Box(size="big"), r'"size" = \'big\': must be an array'),
        (lambda: Sphere(radius=-0.01), '"radius" = -0.01: must be 0 or more'),
        (lambda: Sphere(radius=float("inf")), '"radius" = inf: .* at most 100 m'),
        (lambda: Sphere(radius=None), '"radius" = nan: must be 0 or more'),
        (lambda: Sphere(radius="wide"), "\"radius\" = 'wide': must be a number"),
        (lambda: Sphere(radius=250.0), '"radius" = 250.0: must be 0 or more and at most 100 m'),
        (lambda: Capsule(radius=0.05, length=0.09), '"length" = .* at least 0.1 m from tip to tip'),
        (lambda: Capsule(radius=0.0, length=0.09), '"radius" = 0.0: must be more than 0'),
        (lambda: Mesh(vertices=[], triangles=[[0, 1, 2]]), '"vertices"'),
        (lambda: Mesh(vertices=CORNERS, triangles=[]), r'"triangles" = .* shape \(m, 3\), m >= 1'),
        (lambda: Mesh(vertices=CORNERS, triangles=[[0, 1, 4]]), '"triangles" = 4: is not a vertex'),
        (lambda: Mesh(vertices=CORNERS, triangles=[[0, 1, -2]]), '"triangles" = -2: is not a vert'),
        (lambda: Mesh(vertices=CORNERS * np.nan, triangles=[[0, 1, 2]]), '"vertices" = .* finite'),
        (lambda: PointCloud(points=np.empty((0, 3))), '"points" = .* at least one finite point'),
        (lambda: PointCloud(points=CORNERS, resolution=0.0), '"resolution" = 0.0: must be more'),
        (lambda: PointCloud(points=CORNERS, resolution=1e-6), "too fine .* make it 3.1e-06 m or"),
        (lambda: obstacle(name=""), "each thing needs a name"),
        (lambda: obstacle(pose=SE3.from_translation((300, 0, 0))), '"mug" must be within 100 m'),
        (lambda: obstacle(pose=SE3.from_translation((np.nan, 0, 0))), '"mug" must be within'),
        (lambda: held(mass=-1.0), '"mass" = -1.0: of "pen" must be 0 to 100 kg'),
        (lambda: Scene(margin=0.0), '"margin" = 0.0: must be more than 0 and at most 0.1 m'),
        (lambda: Scene(margin=float("nan")), '"margin" = nan'),
        (lambda: Scene(floor_z=float("nan")), '"floor_z" = nan: must be a finite height'),
        (lambda: Scene(obstacles=(obstacle(), obstacle())), "'mug': is there twice"),
        (lambda: Scene(obstacles=(obstacle("pen"),), attached=(held(),)), "'pen': is there twice"),
        (lambda: Scene(obstacles=(obstacle("wrist"),)), "'wrist': is there twice, as part of the"),
        (lambda: touching("gripper", "mog"), "'mog': is not in this scene; there are base, floor"),
        (lambda: Scene(attached=(held(may_touch=frozenset({"flor"})),)), "'flor': .*, pen, "),
        (lambda: touching("floor"), "must be the names of two things"),
    ],
)
def test_invalid_input_is_refused_in_a_sentence(make, says):
    with pytest.raises(ConfigError, match=says):
        make()


def test_a_scene_is_the_floor_unless_more_is_said():
    scene = Scene()
    assert scene.floor_z == FLOOR_Z
    assert not scene.obstacles
    assert not scene.attached


CLOUD = PointCloud(points=CORNERS, resolution=0.02)
MESH = Mesh(vertices=CORNERS, triangles=[[0, 1, 2], [0, 1, 3]])


@pytest.mark.parametrize(
    "other",
    [
        Scene(obstacles=(obstacle("cup"),)),
        Scene(obstacles=(obstacle(shape=Sphere(radius=0.041)),)),
        Scene(obstacles=(obstacle(shape=Box(size=(0.04, 0.04, 0.04))),)),
        Scene(obstacles=(obstacle(shape=CLOUD),)),
        Scene(obstacles=(obstacle(shape=MESH),)),
        Scene(obstacles=(obstacle(pose=SE3.from_rpy((0.1, 0, 0), HERE.p)),)),
        Scene(obstacles=(obstacle(keep_out=True),)),
        Scene(obstacles=(obstacle(),), margin=0.004),
        Scene(obstacles=(obstacle(),), floor_z=None),
        Scene(obstacles=(obstacle(),), may_touch=frozenset({frozenset({"mug", "jaw"})})),
        Scene(obstacles=(obstacle(),), attached=(held(),)),
    ],
)
def test_scenes_are_equal_if_and_only_if_all_in_them_is(other):
    scene = Scene(obstacles=(obstacle(),))
    assert scene == Scene(obstacles=(obstacle(),))
    assert hash(scene) == hash(Scene(obstacles=(obstacle(),)))
    assert scene != other
    assert other != Scene(attached=(held(mass=0.1),))


def test_a_scene_survives_a_process_boundary():
    scene = Scene(
        obstacles=(obstacle(), obstacle("rag", CLOUD), obstacle("part", MESH)),
        attached=(held(may_touch=frozenset({"floor", "mug"})),),
    )
    again = pickle.loads(pickle.dumps(scene))
    assert again == scene
    assert again.digest == scene.digest


def test_a_large_shape_is_read_once_however_many_scenes_it_is_in():
    data = np.frombuffer(bytearray(100), np.uint8)
    seen = obstacle("seen", ShapeFile(kind="pcd", data=data, name="seen"))
    scene = Scene(obstacles=(seen,), margin=0.004)
    data[0] = 1  # would be noticed by whoever reads it again
    assert replace(scene, margin=0.005) != scene
    assert Scene(obstacles=(seen,), margin=0.004) == scene


def test_sentences_tell_links_things_and_zones_apart():
    scene = Scene(obstacles=(obstacle(), obstacle("lamp", keep_out=True)), attached=(held(),))
    assert scene.called("upper arm") == "the upper arm"
    assert scene.called("floor") == "the floor"
    assert scene.called("mug") == "'mug'"
    assert scene.called("pen") == "'pen'"
    assert scene.called("lamp") == "the keep-out zone 'lamp'"


def test_obstacles_are_added_to_those_that_are_there():
    scene = Scene(obstacles=(obstacle(),), margin=0.01).with_obstacles([obstacle("cup")])
    assert [each.name for each in scene.obstacles] == ["mug", "cup"]
    assert scene.margin == 0.01
