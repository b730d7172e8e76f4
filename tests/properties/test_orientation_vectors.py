import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.common.geometry import SE3, rot_x, rot_y, rot_z, rotation_angle
from so101_motion.viam.conversion import convert
from so101_motion.viam.conversion.orientation import (
    POLE,
    OrientationVector,
    from_rotation,
    to_rotation,
)

angles = st.floats(-math.pi, math.pi)
components = st.floats(-1.0, 1.0, allow_subnormal=False)
cone = math.acos(1.0 - POLE)


latitudes = st.one_of(
    st.floats(0.0, math.pi), st.floats(0.0, cone), st.sampled_from([0.0, math.pi])
)


@given(angles, latitudes, angles)
def test_a_rotation_survives_the_round_trip_but_for_the_direction_of_a_tilt_near_a_pole(
    longitude, latitude, turn
):
    R = rot_z(longitude) @ rot_y(latitude) @ rot_z(turn)
    tilt = min(latitude, math.pi - latitude)
    lost = 2.0 * tilt if tilt < 1.001 * cone else 0.0

    assert rotation_angle(to_rotation(from_rotation(R)).T @ R) <= lost + 1e-7


@given(components, components, components, angles)
def test_the_third_axis_is_the_vector_outside_the_cone(x, y, z, theta):
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-3 or 1.0 - abs(z) / length <= POLE:
        return
    R = to_rotation(OrientationVector(o=(x, y, z), theta=theta))

    assert np.allclose(R[:, 2], np.array([x, y, z]) / length, atol=1e-9)
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("o", "R"),
    [
        ((0.0, 0.0, 0.0), np.eye(3)),  # no vector stands for up
        ((0.0, 0.0, -1.0), rot_y(math.pi)),  # as viam-server reads them
        ((1.0, 0.0, 0.0), rot_y(math.pi / 2)),
        ((0.0, 0.001, 1.0), rot_y(math.atan(0.001))),  # a small tilt is taken as along x
    ],
)
def test_known_vectors_are_read_as_viam_server_does(o, R):
    assert np.allclose(to_rotation(OrientationVector(o=o, theta=0.0)), R, atol=1e-6)


@pytest.mark.parametrize(
    "o", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.01, 0, -0.9), (0.6, -0.48, 0.64)]
)
@settings(max_examples=30)
@given(theta=angles)
def test_theta_turns_about_the_vector_like_a_right_handed_screw(o, theta):
    unturned = to_rotation(OrientationVector(o=o, theta=0.0))
    R = to_rotation(OrientationVector(o=o, theta=theta))
    back = from_rotation(R)

    assert np.allclose(R, unturned @ rot_z(theta))
    assert np.allclose(R @ unturned.T @ unturned[:, 2], unturned[:, 2])  # the vector stays
    assert math.isclose(math.sin(back.theta - theta), 0.0, abs_tol=1e-6)
    assert math.cos(back.theta - theta) > 0.0


@given(angles, angles, angles, st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3).map(np.array))
def test_a_pose_survives_the_wire(roll, pitch, yaw, p):
    T = SE3(rot_z(yaw) @ rot_y(pitch) @ rot_x(roll), p)
    back = convert.from_pose(convert.to_pose(T))

    assert np.allclose(back.p, T.p, atol=1e-12)
    assert rotation_angle(back.R.T @ T.R) < 0.03  # inside the pole cone the tilt may be lost
