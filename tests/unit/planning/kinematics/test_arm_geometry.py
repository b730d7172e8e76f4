"""The arm's measures, read off the model, and the closed forms built on them."""

import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from so101_description import URDF_PATH

from benchmarks.plan_problems import at_pitch
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, rotation_angle
from so101_motion.planning.kinematics.arm_geometry import BRANCHES, to_joints
from so101_motion.planning.kinematics.batch_ik import (
    angles_between,
    facing,
    facing_turned,
    hands,
    roll_for,
    rotation_angles,
    straight_pitches,
    wrap,
)
from so101_motion.planning.kinematics.batch_ik import configurations as all_configurations
from so101_motion.planning.kinematics.geometry_from_model import (
    measure_structure,
    position,
    rotation,
)
from so101_motion.planning.kinematics.model import RobotModel


@pytest.fixture
def changed(tmp_path):
    """Makes models of the URDF with some attributes of some joints changed."""

    def make(joints):
        robot = ET.parse(URDF_PATH)
        for joint in robot.getroot().findall("joint"):
            for tag, key, value in joints.get(joint.get("name"), []):
                joint.find(tag).set(key, value)
        robot.write(tmp_path / "changed.urdf")
        return RobotModel.load(tmp_path / "changed.urdf")

    return make


def configurations(model, n, seed=0):
    return np.random.default_rng(seed).uniform(model.lower, model.upper, (n, 5))


def test_measures_are_those_of_the_so101(structure):
    m, bars = structure.measures, structure.bars
    assert m.pan == pytest.approx((0.0388353, 0.0))
    assert m.pan_sign == -1.0
    assert m.shoulder == pytest.approx((0.0303992, 0.1166))
    assert bars.upper_arm == pytest.approx(0.116000, abs=1e-6)
    assert bars.forearm == pytest.approx(0.135000, abs=1e-6)
    assert math.degrees(structure.bars.straight) == pytest.approx(-73.8, abs=0.05)
    assert m.approach_elevation == pytest.approx(0.0, abs=1e-12)


def test_the_tool_is_on_the_roll_axis_and_the_jaw_tip_7_9_mm_beside_it(structure):
    tool, tip = structure.measures.offsets["tool"], structure.measures.offsets["jaw_tip"]
    assert structure.on_axis("tool")
    assert tool.rolls_with_lateral(0.0) == ()
    assert not structure.on_axis("jaw_tip")
    assert math.hypot(*tip.left[1:]) == pytest.approx(0.0079, abs=1e-5)
    assert tip.forward[0] == pytest.approx(0.1592273, abs=1e-6)


def test_formulas_and_model_agree_everywhere(model, structure):
    for q in configurations(model, 50, seed=1):
        R = rotation(structure.measures, q)
        assert rotation_angle(R.T @ model.frame(q).R) < 1e-12
        for name in model.gripper_frames:
            p_base = position(structure, q, name)
            np.testing.assert_allclose(p_base, model.frame(q, name).p, atol=1e-14)


@pytest.mark.parametrize("frame", ["tool", "jaw_tip", "cup"])
def test_postures_hold_the_configuration_that_made_the_target(model, frame):
    model = model.with_frame("cup", SE3.from_rpy((0.4, 0.3, 0.2), (0.03, -0.02, 0.12)))
    structure, seen = measure_structure(model), set()
    for q in configurations(model, 500, seed=2):
        p_base = model.frame(q, frame).p
        found = at_pitch(structure, p_base, q[1:4].sum(), q[4], frame)
        assert 1 <= len(found) <= 4
        assert np.abs(found - q).max(axis=1).min() < 1e-5
        branches = [structure.branch(to_joints(each), frame) for each in found]
        assert len(set(branches)) == len(found)
        seen |= {*branches}
        for each in found:
            assert np.linalg.norm(model.frame(each, frame).p - p_base) < 1e-12
            turned = each[1:4].sum() - q[1:4].sum()
            assert math.remainder(turned, math.tau) == pytest.approx(0.0, abs=1e-9)
            assert model.outside(each, tolerance=1e-6) is None
    assert seen == set(BRANCHES.values())


def test_closer_to_the_pan_axis_than_the_tool_passes_there_is_no_posture(structure):
    assert len(at_pitch(structure, (*structure.measures.pan, 0.3), 0.0, 0.0, "tool")) == 0


def test_a_roll_brings_the_jaw_tip_to_a_lateral_distance(structure):
    offset = structure.measures.offsets["jaw_tip"]
    for lateral in (-0.005, 0.0, 0.003):
        for roll in offset.rolls_with_lateral(lateral):
            assert offset.at(roll)[1] == pytest.approx(lateral, abs=1e-12)
    reached = [offset.at(roll)[1] for roll in offset.rolls_with_lateral(0.1)]
    assert reached == pytest.approx([offset.left[0] + math.hypot(*offset.left[1:])] * 2)


def test_a_roll_outside_its_limits_is_turned_round_or_pulled_in(structure):
    lower, upper = structure.measures.lower[4], structure.measures.upper[4]
    assert structure.clip_roll(0.3) == 0.3
    assert structure.clip_roll(0.3 + math.tau) == pytest.approx(0.3)
    assert structure.clip_roll(-math.pi) in (lower, upper)
    assert structure.clip_roll(upper + 0.1) == upper


@pytest.mark.parametrize(
    ("joints", "forearm", "pan_sign"),
    [
        ({"wrist_flex": [("origin", "xyz", "-0.2 0.0052 0")]}, math.hypot(0.2, 0.0052), -1.0),
        ({"shoulder_pan": [("axis", "xyz", "0 0 -1")]}, 0.135, 1.0),
    ],
    ids=["longer", "mirrored"],
)
def test_measures_follow_the_model_not_a_table(changed, joints, forearm, pan_sign):
    other = changed(joints)
    structure = measure_structure(other)
    assert structure.bars.forearm == pytest.approx(forearm, abs=1e-6)
    assert structure.measures.pan_sign == pan_sign
    q = np.array([0.3, -0.4, 0.5, -0.2, 0.6])
    found = at_pitch(structure, other.frame(q).p, q[1:4].sum(), 0.6, "tool")
    assert np.abs(found - q).max(axis=1).min() < 1e-9


@pytest.mark.parametrize(
    "joints",
    [
        {"wrist_flex": [("origin", "rpy", "0.05 0 -1.5707963267948966")]},
        {"shoulder_pan": [("origin", "rpy", "3.1 0 -3.141592653589793")]},
        {"wrist_roll": [("origin", "rpy", "1.5 0.0486795 3.141592653589793")]},
        {"elbow_flex": [("axis", "xyz", "0 0 -1")]},
        {"shoulder_lift": [("limit", "upper", "3.3")]},
        {"tool_fixed": [("origin", "rpy", "0 2.9 0.0486795")]},
    ],
)
def test_an_arm_that_is_built_otherwise_is_noticed(changed, joints):
    with pytest.raises(ConfigError, match="not built like the SO-101"):
        measure_structure(changed(joints))


def test_angles_rounded_to_six_digits_are_forgiven(tmp_path):
    text = URDF_PATH.read_text()
    text = text.replace("1.5707963267948966", "1.5708").replace("3.141592653589793", "3.14159")
    (tmp_path / "rounded.urdf").write_text(text)
    assert measure_structure(RobotModel.load(tmp_path / "rounded.urdf"))


# Many targets at once


def grid_at(structure, frame, p_base, pitch, roll):
    roll = np.array([[[roll]]])
    hand = hands(structure, frame, roll)
    target = facing(structure, p_base, hand.lateral)
    return all_configurations(structure, target, hand, np.asarray(pitch)[None, None], roll)


def test_excess_is_how_far_the_worst_joint_is_beyond_its_limits(model, structure):
    p = model.frame(np.zeros(5)).p
    grid = grid_at(structure, "tool", p[None], np.linspace(-3.0, 3.0, 31), 0.0)
    exists = np.isfinite(grid.excess)
    beyond = np.maximum(model.lower - grid.q, grid.q - model.upper).max(axis=-1)
    assert np.array_equal(grid.excess[exists], beyond[exists])
    assert np.any(grid.excess[exists] > 0.0)
    assert np.any(grid.excess < 0.0)


def test_a_point_out_of_reach_has_no_posture(structure):
    grid = grid_at(structure, "tool", np.array([[1.0, 0.0, 0.1]]), np.linspace(-3.0, 3.0, 31), 0.0)
    assert np.all(np.isinf(grid.excess))


def test_at_a_straight_pitch_both_ways_to_bend_are_one(model, structure):
    p = model.frame(np.radians([10, 30, -60, 20, 0])).p
    roll = np.zeros((1, 1, 1))
    hand = hands(structure, "tool", roll)
    target = facing(structure, p[None], hand.lateral)
    pitch = straight_pitches(structure, target, hand)
    grid = all_configurations(structure, target, hand, pitch, roll)
    exists = np.isfinite(grid.excess).all(axis=-1)
    assert np.any(exists)
    up, down = grid.q[exists][:, 0], grid.q[exists][:, 1]
    assert up == pytest.approx(down, abs=1e-3)  # acos of a cosine that is 1 but for rounding


@pytest.mark.parametrize("frame", ["tool", "jaw_tip"])
def test_pan_pitch_and_roll_agree_for_poses_that_exist(model, structure, frame):
    random = np.random.default_rng(3)
    for q in random.uniform(model.lower, model.upper, (30, 5)):
        T = model.frame(q, frame)
        R_base_tool = (T.R @ model.rotation_to_tool(frame))[None]
        target, pitch = facing_turned(structure, frame, T.p[None], R_base_tool, 0.0)
        roll = roll_for(structure, target.pan, pitch, R_base_tool)
        pitches = np.array([q[1:4].sum(), q[1:4].sum()])
        off = np.abs(
            wrap(
                np.stack(
                    [target.pan[0, :, 0] - q[0], pitch[0, :, 0] - pitches, roll[0, :, 0] - q[4]]
                )
            )
        ).max(axis=0)
        x, y = T.p[:2] - np.array(structure.measures.pan)
        if np.hypot(x, y) > 0.05:
            assert off.min() < 1e-6


def test_angles_are_accurate_near_zero():
    random = np.random.default_rng(4)
    a = random.standard_normal((50, 3))
    a /= np.linalg.norm(a, axis=1)[:, None]
    assert np.array_equal(angles_between(a, a), np.zeros(50))
    turned = np.array([1.0, 1e-7, 0.0]), np.array([1.0, 0.0, 0.0])
    assert angles_between(turned[0][None], turned[1][None])[0] == pytest.approx(1e-7, rel=1e-6)
    c, s = np.cos(2.5), np.sin(2.5)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert rotation_angles(R[None])[0] == pytest.approx(rotation_angle(R), abs=1e-12)
