import math
from dataclasses import replace

import numpy as np
import pytest

from so101_motion.arm.joint_caps import JERK_TIME, JointCaps
from so101_motion.common.attributes import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG
from so101_motion.common.errors import ConfigError
from so101_motion.common.units import to_rad

CAPS = JointCaps(speed=1.0, acceleration=2.0)


def test_all_joints_get_the_same_limits_and_the_jerk_that_goes_with_them() -> None:
    limits = CAPS.limits
    np.testing.assert_array_equal(limits.velocity, np.full(5, 1.0))
    np.testing.assert_array_equal(limits.acceleration, np.full(5, 2.0))
    np.testing.assert_allclose(limits.jerk, 2.0 / JERK_TIME)


@pytest.mark.parametrize(
    ("name", "bounds_deg"), [("speed", SPEED_RANGE_DEG), ("acceleration", ACCELERATION_RANGE_DEG)]
)
def test_the_ends_of_a_range_are_in_it_and_no_more(name, bounds_deg) -> None:
    lower, upper = bounds_deg
    for value_deg in (lower, upper):
        assert getattr(replace(CAPS, **{name: to_rad(value_deg)}), name) == to_rad(value_deg)
    for value in (to_rad(lower - 0.1), to_rad(upper + 0.1), math.nan):
        with pytest.raises(ConfigError, match=f"{lower:g} to {upper:g} deg/s"):
            replace(CAPS, **{name: value})
