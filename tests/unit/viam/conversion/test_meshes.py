import json
import math
import struct

import numpy as np
import pytest
import so101_description

from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.viam.conversion import convert, kinematics, meshes


@pytest.fixture(scope="module")
def model():
    return RobotModel.load()


def header_of(glb):
    length = struct.unpack_from("<I", glb, 12)[0]
    return json.loads(glb[20 : 20 + length])


def extent_of(glb):
    """Smallest and largest corner of a binary glTF file, its nodes' shifts included."""
    document = header_of(glb)
    corners = []
    for node in document["nodes"]:
        for primitive in document["meshes"][node["mesh"]]["primitives"]:
            accessor = document["accessors"][primitive["attributes"]["POSITION"]]
            shift = np.array(node.get("translation", [0.0, 0.0, 0.0]))
            corners += [np.array(accessor["min"]) + shift, np.array(accessor["max"]) + shift]
    return np.min(corners, axis=0), np.max(corners, axis=0)


def vertices_of(ply):
    lines = ply.decode().splitlines()
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    start = lines.index("end_header") + 1
    return np.array([[float(word) for word in line.split()] for line in lines[start:][:count]])


@pytest.mark.parametrize("part", kinematics.LINKS)
def test_a_model_fills_the_box_it_is_hung_on(part):
    glb = meshes.arm_models(with_tool=False)[part]
    lower, upper = extent_of(glb.mesh)
    half = kinematics.link_box(part).size / 2

    assert glb.content_type == "model/gltf-binary"
    assert struct.unpack_from("<III", glb.mesh)[:2] == (0x46546C67, 2)
    assert struct.unpack_from("<III", glb.mesh)[2] == len(glb.mesh)
    assert np.allclose(lower, -half, atol=0.006)
    assert np.allclose(upper, half, atol=0.006)


def test_a_shifted_file_is_the_same_file_elsewhere():
    data = (so101_description.MESH_DIR / "wrist.glb").read_bytes()
    lower, upper = extent_of(data)
    shift = np.array([0.1, -0.2, 0.3])
    moved = meshes.shifted_glb(data, shift)

    assert np.allclose(extent_of(moved)[0], lower + shift)
    assert np.allclose(extent_of(moved)[1], upper + shift)
    length = struct.unpack_from("<I", data, 12)[0]
    assert moved.endswith(data[20 + length :])


def test_geometries_are_where_the_links_are(model):
    q = np.array([0.3, -0.4, 0.5, -0.2, 0.6])
    links = model.link_placements(q, 0.0)
    for geometry in meshes.arm_geometries("arm", links, None):
        part = geometry.label.removeprefix("arm:")
        T = convert.from_pose(geometry.center)
        expected = links[f"{part}_link"]
        assert np.allclose(T.p, expected @ kinematics.link_box(part).center, atol=1e-9)
        assert np.allclose(T.R, expected.R, atol=0.03)
        assert geometry.box.dims_mm.x == pytest.approx(1000 * kinematics.link_box(part).size[0])


@pytest.mark.parametrize("detail", ["low", "high"])
@pytest.mark.parametrize(
    ("kind", "labels"),
    [
        ("follower", ["gripper_body_0", "gripper_moving"]),
        ("leader", ["gripper_body_0", "gripper_body_1", "gripper_moving"]),
    ],
)
def test_a_gripper_is_sent_as_meshes_under_the_published_labels(model, kind, labels, detail):
    body, moving = meshes.gripper_placements(model, 0.0)
    geometries = meshes.gripper_geometries(kind, detail, body, moving)

    assert [geometry.label for geometry in geometries] == labels
    for geometry in geometries:
        assert geometry.mesh.content_type == "ply"
        assert geometry.mesh.mesh.startswith(b"ply\nformat ascii 1.0\n")
        assert np.max(np.abs(vertices_of(geometry.mesh.mesh))) < 0.2, "metres"
        assert len(geometry.mesh.mesh) < (40_000 if detail == "low" else 400_000)


def test_the_meshes_of_the_follower_look_like_its_parts(model):
    body, moving = meshes.gripper_placements(model, 0.0)
    for detail, error in (("low", 0.008), ("high", 0.0015)):
        geometries = meshes.gripper_geometries("follower", detail, body, moving)
        for geometry, part in zip(geometries, ("gripper", "jaw"), strict=True):
            vertices = vertices_of(geometry.mesh.mesh)
            lower, upper = extent_of((so101_description.MESH_DIR / f"{part}.glb").read_bytes())
            assert np.allclose(vertices.min(axis=0), lower, atol=error)
            assert np.allclose(vertices.max(axis=0), upper, atol=error)


def test_the_jaw_turns_about_its_joint_in_the_published_tool_frame(model):
    body, closed = meshes.gripper_placements(model, -0.174533)
    _, opened = meshes.gripper_placements(model, 1.74533)

    assert body.p * 1000 == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    published = closed @ np.array([0.0, 0.0, 0.0189])  # where it draws the jaw's mesh
    assert published * 1000 == pytest.approx([-20.171, -1.083, 23.400], abs=0.002)
    assert opened.p == pytest.approx(closed.p)
    turned = math.acos((np.trace(closed.R.T @ opened.R) - 1) / 2)
    assert turned == pytest.approx(1.919863)
