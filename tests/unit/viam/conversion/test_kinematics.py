import json
import math
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest

from so101_motion.common.geometry import SE3, rot_z, rotation_angle
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.viam.conversion import kinematics, meshes
from so101_motion.viam.conversion.orientation import OrientationVector, to_rotation

# Tool poses of the published module's own model: q [rad], x y z [mm], quaternion w x y z.
PUBLISHED = [
    ((0, 0, 0, 0, 0), (293.234020490, -0.176767448, 234.370326811),
     (0.707110019, -2.596e-6, 0.707103543, 4.472e-6)),
    ((0.3, -0.4, 0.5, -0.2, 0.6), (237.389472651, -61.605306697, 228.993858734),
     (0.667743411, -0.100258049, 0.663345822, -0.322551364)),
    ((-0.5, 0.6, -0.3, 0.4, -0.6), (297.116472492, 140.898879105, 119.439277992),
     (0.359572593, 0.045313285, 0.905567081, 0.220459789)),
    ((math.pi / 2, 0, 0, 0, 0), (38.658997869, -254.399185803, 234.369652211),
     (0.500004125, 0.499995875, 0.500000873, -0.499999127)),
]  # fmt: skip

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


@pytest.mark.parametrize(("q", "p_mm", "quaternion"), PUBLISHED)
def test_the_served_chain_has_the_published_tool_poses(q, p_mm, quaternion):
    _, ends = frames_of(json.loads(kinematics.arm_sva("arm")), q)
    R = pin.Quaternion(*quaternion).normalized().toRotationMatrix()

    assert np.linalg.norm(ends["tool"].p * 1000.0 - p_mm) < 0.1
    assert rotation_angle(ends["tool"].R.T @ R) < math.radians(0.02)


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


def test_the_urdf_is_one_chain_that_viam_server_can_load():
    robot = ET.fromstring(kinematics.arm_urdf("arm"))
    links = [link.attrib["name"] for link in robot.iter("link")]
    parents = [joint.find("parent").attrib["link"] for joint in robot.iter("joint")]
    children = [joint.find("child").attrib["link"] for joint in robot.iter("joint")]

    assert set(links) - set(parents) == {"tool"}, "exactly one end"
    assert set(links) - set(children) == {"base"}, "exactly one root"
    assert len(children) == len(set(children)) == len(links) - 1
    for joint in robot.iter("joint"):
        assert joint.find("origin") is not None
        if joint.attrib["type"] == "revolute":
            assert float(joint.find("limit").attrib["lower"]) < 0.0
            assert float(joint.find("limit").attrib["upper"]) > 0.0
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
    assert len({link["id"] for link in links}) == len(links)
    assert {link["id"] for link in links} - {link["parent"] for link in links} == {"tcp"}
    expected = (6.835, 0.0, 99.9) if kind == "follower" else (0.0, 0.0, 0.0)
    assert ends["tcp"].p * 1000.0 == pytest.approx(expected)
    assert pytest.approx(np.eye(3)) == ends["tcp"].R
    assert all("geometry" in link for link in links[:-1])


def test_the_tool_centre_point_lies_between_the_pads_of_the_follower(model):
    body, _ = meshes.gripper_placements(model, 0.0)
    tip = model.frame(np.zeros(5), "tool").inverse @ model.frame(np.zeros(5), "jaw_tip")
    boxes = dict(meshes.gripper_boxes("follower"))
    finger = body @ boxes["gripper_body_0"].center

    assert np.linalg.norm(kinematics.TCP["follower"] - tip.p) < 0.016
    assert kinematics.TCP["follower"][2] > finger[2] > 0.07
