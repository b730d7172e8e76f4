"""The URDF against the official one and against the published module's kinematics."""

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from so101_description import PARTS, URDF_PATH

JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]

# Official file; the elbow's upper limit is the arm's true stop, 90.8 deg.
LIMITS = {
    "shoulder_pan": (-1.91986, 1.91986),
    "shoulder_lift": (-1.74533, 1.74533),
    "elbow_flex": (-1.69, 1.5848),
    "wrist_flex": (-1.65806, 1.65806),
    "wrist_roll": (-2.74385, 2.84121),
    "gripper": (-0.174533, 1.74533),
}


def frame_pose(model, q, frame):
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.asarray(q, dtype=float))
    return data.oMf[model.getFrameId(frame)]


def rotation_error(R, wxyz):
    w, x, y, z = np.array(wxyz) / np.linalg.norm(wxyz)
    return np.linalg.norm(pin.log3(R.T @ pin.Quaternion(w, x, y, z).matrix()))


def test_joints_and_links_keep_the_official_names(model):
    assert list(model.names)[1:] == JOINTS
    frames = {frame.name for frame in model.frames}
    assert frames >= {*PARTS, "tool", "jaw_tip"}


def test_limits_are_the_official_ones_but_for_the_elbow(model):
    for i, joint in enumerate(JOINTS):
        limits = (model.lowerPositionLimit[i], model.upperPositionLimit[i])
        assert limits == pytest.approx(LIMITS[joint])
    assert np.degrees(LIMITS["elbow_flex"][1]) == pytest.approx(90.8, abs=0.01)


def test_effort_and_speed_hold_for_either_servo(model):
    assert model.upperEffortLimit == pytest.approx([1.91] * 6)
    assert model.upperVelocityLimit == pytest.approx([4.71] * 6)


@pytest.mark.parametrize("case", range(4))
def test_tool_agrees_with_the_published_module(model, geometry, case):
    pose = geometry["published_tool"][case]
    T_base_tool = frame_pose(model, [*pose["q"], 0.0], "tool")
    assert T_base_tool.translation * 1e3 == pytest.approx(pose["p_mm"], abs=0.1)
    assert np.degrees(rotation_error(T_base_tool.rotation, pose["wxyz"])) < 0.02


@pytest.mark.parametrize(
    "name",
    [
        "zero",
        "pan_plus90",
        "lift_plus45",
        "elbow_plus45",
        "wristflex_plus45",
        "roll_plus45",
        "jaw_open",
        "jaw_closed",
    ],
)
def test_every_frame_agrees_with_the_official_urdf(model, geometry, name):
    pose = geometry["special"][name]
    assert len(pose["frames"]) == 8
    for frame, expected in pose["frames"].items():
        T_base_frame = frame_pose(model, pose["q"], frame)
        assert T_base_frame.translation == pytest.approx(expected["p"], abs=1e-5), frame
        assert rotation_error(T_base_frame.rotation, expected["wxyz"]) < 5e-5, frame


def test_named_poses_put_the_jaw_tip_where_the_official_urdf_does(model, geometry):
    for name, pose in geometry["named"].items():
        T_base_tip = frame_pose(model, np.radians(pose["q_deg"]), "jaw_tip")
        assert T_base_tip.translation == pytest.approx(pose["p_jaw_tip"], abs=1.5e-5), name


@pytest.mark.parametrize(
    ("joint", "frame", "axis", "sign"),
    [
        ("shoulder_pan", "tool", 1, -1),  # positive pan turns right
        ("shoulder_lift", "tool", 2, -1),  # positive lift, elbow and wrist move the tool down
        ("elbow_flex", "tool", 2, -1),
        ("wrist_flex", "jaw_tip", 2, -1),
        ("gripper", "moving_jaw_so101_v1_link", 2, 0),
    ],
)
def test_positive_angles_turn_as_documented(model, joint, frame, axis, sign):
    q = np.zeros(6)
    before = frame_pose(model, q, frame).translation[axis]
    q[JOINTS.index(joint)] = 0.2
    moved = frame_pose(model, q, frame).translation[axis] - before
    assert np.sign(np.round(moved, 6)) == sign


def test_masses_add_up_to_the_official_arm(model):
    # The base's mass is fixed to the universe.
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(0.632, abs=1e-3)


def test_rotations_are_exact_but_for_the_jaw_planes_lean():
    quarter = np.pi / 2
    lean = 0.0486795
    for origin in ET.parse(URDF_PATH).iter("origin"):
        for angle in map(float, origin.get("rpy", "0 0 0").split()):
            turns = angle / quarter
            assert turns == round(turns) or angle == lean
