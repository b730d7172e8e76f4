import numpy as np
import pytest

from so101_motion.common.geometry import rotation_angle
from so101_motion.planning.kinematics.batch_ik import (
    angles_between,
    configurations,
    facing,
    facing_turned,
    hands,
    roll_for,
    rotation_angles,
    straight_pitches,
    wrap,
)


def grid_at(structure, frame, p_base, pitch, roll):
    roll = np.array([[[roll]]])
    hand = hands(structure, frame, roll)
    target = facing(structure, p_base, hand.lateral)
    return configurations(structure, target, hand, np.asarray(pitch)[None, None], roll)


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
    grid = configurations(structure, target, hand, pitch, roll)
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
