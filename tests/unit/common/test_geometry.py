import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.common.geometry import (
    SE3,
    frozen_array,
    quaternion_wxyz,
    rot_x,
    rot_y,
    rot_z,
    rotation_angle,
    rotation_by,
    rotation_vector,
)

angles = st.floats(-math.pi, math.pi)
rotations = st.builds(lambda a, b, c: rot_z(a) @ rot_y(b) @ rot_x(c), angles, angles, angles)
points = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)
transforms = st.builds(SE3, rotations, points)


@given(transforms, transforms, points, points)
def test_transforms_compose_undo_each_other_and_map_many_points_like_each_alone(T, U, p, q):
    np.testing.assert_allclose((T @ U) @ p, T @ (U @ p), atol=1e-12)
    np.testing.assert_allclose((T @ T.inverse).matrix, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(T @ np.stack([p, q]), np.stack([T @ p, T @ q]), atol=1e-12)


@given(rotations, points, st.floats(0.1, 10.0))
def test_a_quaternion_gives_the_rotation_back_whatever_its_length(R, p, length):
    w, x, y, z = quaternion_wxyz(R)
    assert w >= 0.0
    assert math.isclose(w * w + x * x + y * y + z * z, 1.0, abs_tol=1e-12)
    v = np.array([x, y, z])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rebuilt = (w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * cross
    np.testing.assert_allclose(rebuilt, R, atol=1e-9)
    T = SE3.from_quaternion(length * quaternion_wxyz(R), p)
    np.testing.assert_allclose(T.R, R, atol=1e-9)
    np.testing.assert_array_equal(T.p, p)


@given(st.floats(0.0, math.pi), rotations)
def test_rotation_angle_does_not_depend_on_the_axis(angle, R):
    assert math.isclose(rotation_angle(R @ rot_z(angle) @ R.T), angle, abs_tol=1e-7)


@given(st.floats(1e-9, 1e-6))
def test_small_angles_keep_their_digits(angle):
    assert math.isclose(rotation_angle(rot_x(angle)), angle, rel_tol=1e-6)


def test_rpy_is_the_convention_of_urdf():
    R = SE3.from_rpy((0.1, 0.2, 0.3)).R
    np.testing.assert_allclose(R, rot_z(0.3) @ rot_y(0.2) @ rot_x(0.1))


def test_arrays_are_copied_in_and_cannot_be_changed_and_a_wrong_shape_is_refused():
    source = np.zeros(3)
    p = frozen_array(source, (3,))
    source[0] = 1.0
    assert p[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        p[0] = 1.0
    with pytest.raises(ValueError, match=r"shape \(3,\), got \(2,\)"):
        frozen_array([1.0, 2.0], (3,))


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 1e-3, 1.0, 3.0, np.pi - 1e-5])
@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.6, 0.0, -0.8]])
def test_a_rotation_vector_and_the_rotation_by_it_undo_each_other(axis, angle):
    vector = angle * np.array(axis)
    R = rotation_by(vector)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(R @ axis, axis, atol=1e-12)
    np.testing.assert_allclose(rotation_vector(R), vector, rtol=1e-6, atol=1e-9)


def test_half_a_turn_has_an_axis_of_either_sign():
    axis = np.array([0.48, 0.6, -0.64])
    vector = rotation_vector(rotation_by(np.pi * axis))
    np.testing.assert_allclose(np.abs(vector), np.pi * np.abs(axis), atol=1e-6)
    np.testing.assert_allclose(rotation_by(vector), rotation_by(np.pi * axis), atol=1e-6)
