import json

import numpy as np
import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.files.scene_file import (
    arms_from,
    arms_to,
    obstacles_from,
    read_scene,
    scene_from,
    scene_to,
    write_scene,
)
from so101_motion.planning.collision.scene import (
    FLOOR_Z,
    Attached,
    Box,
    Capsule,
    Cylinder,
    Mesh,
    Obstacle,
    PointCloud,
    Scene,
    Sphere,
    StandingArm,
)

TETRAHEDRON = Mesh(
    vertices=[[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]],
    triangles=[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
)


def test_every_kind_of_thing_can_be_written_and_read_back(tmp_path):
    pose = SE3.from_rpy((0.1, -0.2, 0.3), (0.25, 0.06, 0.045))
    scene = Scene(
        obstacles=(
            Obstacle(name="mug", shape=Box(size=(0.08, 0.09, 0.1)), T_base_obstacle=pose),
            Obstacle(name="ball", shape=Sphere(radius=0.03), T_base_obstacle=pose),
            Obstacle(name="post", shape=Capsule(radius=0.01, length=0.2), T_base_obstacle=pose),
            Obstacle(name="part", shape=TETRAHEDRON, T_base_obstacle=pose),
            Obstacle(
                name="can",
                shape=Cylinder(radius=0.015, length=0.04),
                T_base_obstacle=pose,
                mass=0.03,
            ),
            Obstacle(
                name="seen",
                shape=PointCloud(points=[[0.3, 0, 0]], resolution=0.02),
                T_base_obstacle=pose,
                keep_out=True,
            ),
        ),
        attached=(
            Attached(
                name="cube",
                shape=Box(size=(0.02, 0.02, 0.02)),
                T_tool_object=SE3.from_translation((0, 0, 0.1)),
                mass=0.02,
                may_touch=frozenset(["floor"]),
            ),
        ),
        floor_z=None,
        margin=0.005,
        may_touch=frozenset([frozenset(["cube", "mug"])]),
    )
    path = tmp_path / "scene.json"
    write_scene(scene, path)
    again = read_scene(path)
    assert scene_to(again) == scene_to(scene)
    assert again.floor_z is None
    assert again.obstacles[5].keep_out
    assert [(each.name, each.mass) for each in again.items] == [("can", 0.03)]
    assert again.attached[0].may_touch == {"floor"}
    for one, other in zip(again.obstacles, scene.obstacles, strict=True):
        assert type(one.shape) is type(other.shape)
        np.testing.assert_allclose(
            one.T_base_obstacle.matrix, other.T_base_obstacle.matrix, atol=1e-9
        )


def test_an_empty_scene_has_the_table():
    assert scene_from({}).floor_z == FLOOR_Z
    assert scene_from({"floor_z_mm": None}).floor_z is None


def test_a_mesh_file_is_read_in_millimetres_beside_its_scene_and_named_if_it_holds_nothing(
    tmp_path,
):
    import trimesh

    trimesh.creation.box((20.0, 20.0, 20.0)).export(tmp_path / "cube.stl")
    (tmp_path / "scene.json").write_text(
        json.dumps({"obstacles": [{"name": "cube", "mesh_file": "cube.stl"}]})
    )
    mesh = read_scene(tmp_path / "scene.json").obstacles[0].shape
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), 0.02)
    thing = {"name": "part", "mesh_file": "/etc/hostname"}
    with pytest.raises(ConfigError, match=r"mesh_file.*of \"part\".*cannot be read here"):
        scene_from({"obstacles": [thing]}, folder=None)
    (tmp_path / "empty.stl").write_text("not a mesh")
    thing = {"name": "part", "mesh_file": "empty.stl"}
    with pytest.raises(ConfigError, match=r"empty\.stl.*too short"):
        scene_from({"obstacles": [thing]}, folder=tmp_path)


def test_other_arms_can_be_written_and_read_back():
    arm = StandingArm(
        name="left",
        T_base_arm=SE3.from_rpy((0.0, 0.0, 0.5), (0.3, -0.1, 0.0)),
        q=np.radians([[10.0, -20.0, 30.0, 0.0, 5.0, 20.0], [0.0] * 6]),
        attached=(
            Attached(
                name="cube",
                shape=Box(size=np.full(3, 0.02)),
                T_tool_object=SE3.from_translation((0, 0, 0.1)),
            ),
        ),
        room=0.02,
    )
    [read] = arms_from(json.loads(json.dumps(arms_to([arm]))))
    assert Scene(arms=(read,)) == Scene(arms=(arm,))


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"q_deg": [[0.0] * 5]}, "rows of 6 finite numbers"),
        ({"q_deg": [[0.0] * 5 + [float("nan")]]}, "rows of 6 finite numbers"),
        ({"name": ""}, "name"),
        ({"room_mm": -1.0}, "room_mm"),
        ({"pose": 1.0}, "key of an arm"),
    ],
)
def test_invalid_arms_are_refused_in_a_sentence(changed, says):
    entry = {"name": "left", "position_mm": [300, 0, 0], "q_deg": [[0.0] * 6]}
    assert len(arms_from([entry])) == 1
    with pytest.raises(ConfigError, match=says):
        arms_from([entry | changed])


@pytest.mark.parametrize(
    "shape",
    [
        {"box_mm": [0.02, 0.12, 0.26]},
        {"sphere_radius_mm": 0.05},
        {"vertices_mm": [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], "triangles": [[0, 1, 2]]},
        {"points_mm": [[0.01 * i, 0, 0] for i in range(10)]},
    ],
)
def test_a_speck_is_refused_until_its_scale_is_given(shape):
    entry = {"name": "wall", **shape}
    with pytest.raises(ConfigError, match='is it in metres\\? add "scale": 1000'):
        scene_from({"obstacles": [entry]})
    assert scene_from({"obstacles": [entry | {"scale": 1000}]}).obstacles[0].name == "wall"


def test_a_thing_over_10_m_in_all_directions_is_refused_until_its_scale_is_given():
    corners = [[20_000.0 * (i == k) for i in range(3)] for k in (-1, 0, 1, 2)]
    triangles = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    entry = {"name": "wall", "vertices_mm": corners, "triangles": triangles}
    with pytest.raises(ConfigError, match=r'is it in millimetres\? add "scale": 0\.001'):
        scene_from({"obstacles": [entry]})
    assert scene_from({"obstacles": [entry | {"scale": 0.001}]})
    corners[3] = [0.0, 0.0, 9_000.0]  # a large table
    assert scene_from({"obstacles": [entry]})


@pytest.mark.parametrize(
    "form", [{"box_mm": [0, 20, 20]}, {"box_mm": [0, 0, 0]}, {"sphere_radius_mm": 0}]
)
def test_plates_lines_and_points_are_obstacles(form):
    (obstacle,) = obstacles_from([{"name": "a", **form}])
    assert obstacle.shape.fingerprint()
