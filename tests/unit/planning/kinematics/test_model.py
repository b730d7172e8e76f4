import math
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from so101_description import URDF_PATH

from so101_motion.arm.joint_caps import JointRange
from so101_motion.common.errors import ConfigError, OutsideLimits
from so101_motion.common.geometry import SE3, rotation_angle
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.model import LINKS, RobotModel


def test_limits_come_from_the_urdf_and_stop_the_elbow_where_the_arm_does(model):
    assert math.degrees(model.upper[2]) == pytest.approx(90.8, abs=0.01)
    np.testing.assert_array_equal(model.limits, np.column_stack([model.lower, model.upper]))
    with pytest.raises(ValueError, match="read-only"):
        model.lower[0] = 0.0


def test_a_frame_keeps_its_pose_when_the_model_moves_on(model):
    T_base_tool = model.frame(np.zeros(5))
    before = T_base_tool.p.copy()
    model.frame(np.full(5, 0.3))
    np.testing.assert_array_equal(T_base_tool.p, before)


def test_an_unknown_frame_is_refused_and_the_known_ones_are_named(model):
    for ask in (model.frame, model.frame_jacobian):
        with pytest.raises(ConfigError, match=r"tol.*jaw_tip.*tool"):
            ask(np.zeros(5), "tol")


def test_the_jaw_link_is_no_frame_because_five_joints_do_not_place_it(model):
    with pytest.raises(ConfigError, match="moving_jaw"):
        model.frame(np.zeros(5), "moving_jaw_so101_v1_link")


def test_links_are_placed_as_frames_are(model):
    q = np.array([0.3, -0.4, 0.5, -0.2, 0.6])
    placements = model.link_placements(q, 0.7)
    assert tuple(placements) == LINKS
    for name in LINKS[:-1]:
        np.testing.assert_allclose(placements[name].matrix, model.frame(q, name).matrix, atol=1e-15)


def test_the_jaw_turns_about_its_own_origin_and_moves_nothing_else(model):
    closed, opened = (model.link_placements(np.zeros(5), q_jaw) for q_jaw in (0.0, 1.0))
    jaw = LINKS[-1]
    np.testing.assert_array_equal(closed[jaw].p, opened[jaw].p)
    assert rotation_angle(closed[jaw].R.T @ opened[jaw].R) == pytest.approx(1.0)
    for name in LINKS[:-1]:
        np.testing.assert_array_equal(closed[name].matrix, opened[name].matrix)


def test_an_added_frame_rides_on_the_gripper(model):
    T_tool_cup = SE3.from_rpy((0.1, 0.2, 0.3), (0.01, -0.02, 0.12))
    with_cup = model.with_frame("cup", T_tool_cup)
    q = np.array([0.3, -0.4, 0.5, -0.2, 0.6])
    wanted = model.frame(q) @ T_tool_cup
    np.testing.assert_allclose(with_cup.frame(q, "cup").matrix, wanted.matrix, atol=1e-12)
    assert "cup" in with_cup.gripper_frames
    assert "cup" not in model.gripper_frames


def test_added_frames_add_up_but_not_under_one_name(model):
    lid = SE3.from_translation([0.0, 0.0, 0.05])
    both = model.with_frame("cup", SE3.identity()).with_frame("lid", lid)
    assert {"tool", "jaw_tip", "cup", "lid"} <= set(both.gripper_frames)
    with pytest.raises(ConfigError, match="another frame"):
        both.with_frame("cup", lid)


def test_rotation_to_tool_leads_from_any_gripper_frame_to_the_tool(model):
    q = np.array([0.3, -0.4, 0.5, -0.2, 0.6])
    for name in model.gripper_frames:
        R_base_tool = model.frame(q, name).R @ model.rotation_to_tool(name)
        np.testing.assert_allclose(R_base_tool, model.frame(q).R, atol=1e-12)


def test_the_joint_furthest_outside_is_named_with_its_limits(model):
    q = np.array([0.0, 1.8, 1.7, 0.0, 0.0])
    assert model.outside(q) == 2
    with pytest.raises(
        OutsideLimits, match=r"elbow_flex = 97\.40 deg.*-96\.82 to 90\.80"
    ) as caught:
        model.check_limits(q)
    assert caught.value.joint == "elbow_flex"
    assert caught.value.value == 1.7
    assert caught.value.upper == model.upper[2]


def test_angles_on_the_limits_are_inside(model):
    for q in (model.lower, model.upper, np.zeros(5)):
        assert model.outside(q) is None
        model.check_limits(q)
    assert model.outside(model.upper + 1e-3, tolerance=2e-3) is None


def test_nan_is_outside(model):
    assert model.outside([0.0, 0.0, 0.0, math.nan, 0.0]) == 3
    with pytest.raises(OutsideLimits, match="wrist_flex"):
        model.check_limits([0.0, 0.0, 0.0, math.nan, 0.0])


def test_a_missing_file_and_a_stranger_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        RobotModel.load(tmp_path / "nothing.urdf")
    robot = ET.parse(URDF_PATH)
    for joint in robot.getroot().iter("joint"):
        if joint.get("name") == "wrist_roll":
            joint.set("name", "wrist_yaw")
    robot.write(tmp_path / "stranger.urdf")
    with pytest.raises(ConfigError, match="exactly the joints shoulder_pan"):
        RobotModel.load(tmp_path / "stranger.urdf")


def test_limits_are_shown_so_that_both_ends_can_be_reached(model):
    calibrated = JointRange(model.lower + 0.1234, model.upper - 0.1234)
    for check, lower, upper in (
        (model.check_limits, model.lower, model.upper),
        (calibrated.check, *calibrated),
    ):
        for i in range(5):
            with pytest.raises(OutsideLimits) as caught:
                check(4.0 * np.eye(5)[i])
            shown = re.findall(r"-?\d+\.\d\d", str(caught.value))[1:]
            for end, inside in zip(shown, (lower[i], -upper[i]), strict=True):
                sign = 1.0 if inside == lower[i] else -1.0
                assert sign * math.radians(float(end)) >= inside - math.radians(1e-4)
                assert check(math.radians(float(end)) * np.eye(5)[i]) is None


# Many at once


T_TOOL_PEN = SE3.from_rpy((0.3, -0.2, 0.1), (0.02, -0.03, 0.12))


@pytest.fixture(scope="module")
def penned():
    return RobotModel.load().with_frame("pen", T_TOOL_PEN)


@pytest.fixture(scope="module")
def q(penned):
    return np.random.default_rng(0).uniform(penned.lower, penned.upper, (40, 5))


@pytest.mark.parametrize("frame", ["tool", "jaw_tip", "pen"])
def test_many_postures_at_once_are_what_the_model_says_of_each(penned, q, frame):
    chain = ArmChain(penned, frame)
    p, J = chain.positions_and_jacobians(q)
    R = chain.rotations(q)
    for k, configuration in enumerate(q):
        T = penned.frame(configuration, frame)
        assert p[k] == pytest.approx(T.p, abs=1e-14)
        assert R[k] == pytest.approx(T.R, abs=1e-14)
        assert J[k] == pytest.approx(penned.frame_jacobian(configuration, frame)[:3], abs=1e-14)
    assert chain.positions(q) == pytest.approx(p, abs=1e-15)


def test_speeds_are_those_of_the_jacobian(penned, q):
    chain = ArmChain(penned)
    qd = np.random.default_rng(1).standard_normal(q.shape)
    _, J = chain.positions_and_jacobians(q)
    expected = np.linalg.norm(np.einsum("nij,nj->ni", J, qd), axis=1)
    assert chain.speeds(q, qd) == pytest.approx(expected, abs=1e-14)
