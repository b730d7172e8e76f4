import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.drivers.bus.ticks import RAD_PER_TICK, TICKS_PER_RAD
from so101_motion.drivers.emulator.motion import Profile
from so101_motion.drivers.feetech.lag_compensation import (
    BRAKING,
    braking,
    cut_off,
    stopping_distance,
)


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


@pytest.mark.parametrize("speed", [-1.5, -0.5, 0.5, 1.5])
def test_what_the_firmware_drops_of_a_set_point_on_its_way_is_known(speed):
    profile = Profile(2048.0)
    profile.speed = abs(speed) * TICKS_PER_RAD
    profile.acceleration, profile.target = 1e6, 2048.0 + math.copysign(900.0, speed)
    dropped = []
    for _ in range(300):
        profile.step()
        dropped.append(profile.position - int(profile.position))
    assert cut_off(speed) == pytest.approx(RAD_PER_TICK * sum(dropped) / 300.0, rel=0.05)


def test_nothing_is_dropped_of_a_set_point_at_rest():
    assert cut_off(0.0) == 0.0
