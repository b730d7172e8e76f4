import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.drivers.feetech.lag_compensation import BRAKING, braking, stopping_distance


def test_a_joint_at_rest_is_sent_where_it_is():
    assert stopping_distance(0.0, BRAKING[0]) == 0.0


@given(qd=st.floats(-4.0, 4.0), acceleration=st.floats(1.0, 20.0))
def test_braking_over_the_stopping_distance_ends_at_rest(qd, acceleration):
    end = stopping_distance(qd, acceleration)
    assert math.copysign(1.0, end) == math.copysign(1.0, qd) or end == 0.0
    assert qd**2 - 2.0 * acceleration * abs(end) == pytest.approx(0.0, abs=1e-9)


@given(time=st.floats(0.0, 2.0), planned=st.floats(0.1, math.radians(460.0)))
def test_a_motion_that_brakes_more_gently_is_never_sent_beyond_its_end(time, planned):
    q, qd = -planned * time**2 / 2.0, planned * time  # its end is at zero
    assert q + stopping_distance(qd, min(BRAKING)) <= 1e-12


@pytest.mark.parametrize("units", [0, 50, 100])
def test_register_85_as_new_or_below_leaves_the_measured_figure(units):
    assert braking(2, units) == BRAKING[2]


def test_a_raised_register_85_lets_servos_brake_harder_but_no_harder_than_the_cap():
    assert BRAKING[1] < braking(1, 120) < braking(1, 254) == math.radians(980.0)
