import json
import math
import struct
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
import so101_description

from so101_motion.common.geometry import SE3, rot_z
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.viam.conversion import convert, kinematics, meshes
from so101_motion.viam.conversion.orientation import OrientationVector, to_rotation

CONFIGURATIONS = np.random.default_rng(1).uniform(-1.5, 1.5, (20, 5))


@pytest.fixture(scope="module")
def model():
    return RobotModel.load()


def turn_of(orientation):
    value = orientation["value"]
    if orientation["type"] == "euler_angles":
        return SE3.from_rpy((value["roll"], value["pitch"], value["yaw"])).R
    vector = OrientationVector(
        o=(value["x"], value["y"], value["z"]), theta=math.radians(value["th"])
    )
    return to_rotation(vector)


def frames_of(document, q):
    """What a reader of SVA makes of it: the frame each part starts in, and each part's end."""
    starts, ends = {}, {"world": SE3.identity()}
    parts = {part["id"]: part for part in (*document["links"], *document["joints"])}
    angles = dict(zip([joint["id"] for joint in document["joints"]], q, strict=True))
    while len(ends) <= len(parts):
        for name, part in parts.items():
            if name in ends or part["parent"] not in ends:
                continue
            starts[name] = ends[part["parent"]]
            if name in angles:
                step = SE3(rot_z(angles[name]), np.zeros(3))
            else:
                p = np.array([part["translation"][axis] for axis in "xyz"]) / 1000.0
                step = SE3(turn_of(part["orientation"]), p)
            ends[name] = starts[name] @ step
    return starts, ends


def test_the_served_chain_agrees_with_the_model_we_plan_with(model):
    document = json.loads(kinematics.arm_sva("arm"))
    for q in CONFIGURATIONS:
        starts, ends = frames_of(document, q)
        for part in kinematics.LINKS:
            expected = model.frame(q, f"{part}_link")
            assert np.allclose(starts[part].matrix, expected.matrix, atol=1e-9)
        assert np.allclose(ends["tool"].matrix, model.frame(q, "tool").matrix, atol=1e-9)


def test_the_served_names_are_the_published_ones_with_our_limits_and_a_box_for_each_link(model):
    document = json.loads(kinematics.arm_sva("my-arm"))

    assert document["name"] == "my-arm"
    assert document["kinematic_param_type"] == "SVA"
    names = ["base", "shoulder", "upper_arm", "lower_arm", "wrist", "tool"]
    links, joints = document["links"], document["joints"]
    assert [link["id"] for link in links] == names
    assert [joint["id"] for joint in joints] == ["1", "2", "3", "4", "5"]
    assert [joint["min"] for joint in joints] == pytest.approx(list(np.degrees(model.lower)))
    assert [joint["max"] for joint in joints] == pytest.approx(list(np.degrees(model.upper)))
    assert joints[2]["max"] == pytest.approx(90.8, abs=0.01)
    assert [link["id"] for link in links if "geometry" not in link] == ["tool"]
    for link in links[:-1]:
        assert link["geometry"]["type"] == "box"
        assert all(0.0 < link["geometry"][axis] < 200.0 for axis in "xyz")


def test_the_urdf_has_one_end_and_a_box_for_each_link_as_viam_server_wants_it():
    robot = ET.fromstring(kinematics.arm_urdf("arm"))
    links = [link.attrib["name"] for link in robot.iter("link")]
    parents = [joint.find("parent").attrib["link"] for joint in robot.iter("joint")]

    assert set(links) - set(parents) == {"tool"}, "exactly one end"
    for link in robot.iter("link"):
        assert len(link.findall("collision")) == (link.attrib["name"] in kinematics.LINKS)
        assert not list(link.iter("mesh"))


def test_the_urdf_agrees_with_the_model_we_plan_with(model):
    urdf = pin.buildModelFromXML(kinematics.arm_urdf("arm").decode())
    data = urdf.createData()

    assert list(urdf.names)[1:] == ["1", "2", "3", "4", "5"]
    assert np.allclose(urdf.lowerPositionLimit, model.lower)
    assert np.allclose(urdf.upperPositionLimit, model.upper)
    for q in CONFIGURATIONS:
        pin.framesForwardKinematics(urdf, data, q)
        tool = data.oMf[urdf.getFrameId("tool")]
        assert np.allclose(tool.homogeneous, model.frame(q).matrix, atol=1e-9)


@pytest.mark.parametrize("kind", ["follower", "leader"])
def test_a_gripper_is_links_alone_with_the_tool_centre_point_as_leaf(model, kind):
    body, moving = meshes.gripper_placements(model, 0.0)
    parts = [
        (label, moving if label.startswith("gripper_moving") else body, box)
        for label, box in meshes.gripper_boxes(kind)
    ]
    document = json.loads(kinematics.gripper_sva("g", kind, parts))
    _, ends = frames_of(document, [])
    links = document["links"]

    assert document["joints"] == []
    assert ("gripper_body_1" in {label for label, *_ in parts}) == (kind == "leader"), "its servo"
    assert len({link["id"] for link in links}) == len(links)
    assert {link["id"] for link in links} - {link["parent"] for link in links} == {"tcp"}
    expected = (6.835, 0.0, 99.9) if kind == "follower" else (0.0, 0.0, 0.0)
    assert ends["tcp"].p * 1000.0 == pytest.approx(expected)
    assert pytest.approx(np.eye(3)) == ends["tcp"].R
    assert all("geometry" in link for link in links[:-1])


def extent_of(glb):
    """Smallest and largest corner of a binary glTF file, its nodes' shifts included."""
    document = json.loads(glb[20 : 20 + struct.unpack_from("<I", glb, 12)[0]])
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
