import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.drivers.bus.ticks import (
    RAD_PER_TICK,
    JointMap,
    Ticks,
    to_acceleration_units,
    to_speed_ticks,
)


@st.composite
def maps(draw):
    lower = draw(st.integers(0, 4094))
    upper = draw(st.integers(lower + 1, 4095))
    zero = draw(st.one_of(st.integers(-4096, 8192), st.floats(-4096.0, 8192.0)))
    return JointMap(
        servo_id=1,
        zero_ticks=zero,
        direction=draw(st.sampled_from([1, -1])),
        lower_ticks=Ticks(lower),
        upper_ticks=Ticks(upper),
    )


@given(maps())
def test_every_tick_survives_the_way_to_radians_and_back(joint):
    for tick in range(4096):
        assert joint.to_ticks(joint.to_rad(tick)) == joint.unrolled(tick)
        assert (joint.unrolled(tick) - tick) % 4096 == 0


@given(maps())
def test_positions_inside_the_range_are_never_counted_on(joint):
    for tick in (joint.lower_ticks, joint.upper_ticks):
        assert joint.unrolled(tick) == tick
        assert joint.to_goal(joint.to_rad(tick)) == tick


@given(maps(), st.integers(0, 4095))
def test_angles_grow_with_ticks_or_against_them_one_tick_at_a_time(joint, tick):
    step = joint.to_rad((tick + 1) % 4096) - joint.to_rad(tick)
    at_seam = joint.unrolled(tick) > joint.unrolled((tick + 1) % 4096)
    turn = 2.0 * math.pi if at_seam else 0.0
    assert step == pytest.approx(joint.direction * (RAD_PER_TICK - turn), abs=1e-9)


@given(maps(), st.floats(-7.0, 7.0))
def test_goals_stay_inside_the_limits_and_are_the_nearest_tick(joint, q):
    goal = joint.to_goal(q)
    assert joint.lower_ticks <= goal <= joint.upper_ticks
    if joint.lower < q < joint.upper:
        assert abs(joint.to_rad(goal) - q) <= 0.5 * RAD_PER_TICK + 1e-12


def test_a_turn_has_4096_ticks_and_a_position_beyond_the_seam_is_a_little_outside():
    joint = JointMap(servo_id=1)
    assert joint.to_rad(Ticks(3048)) == pytest.approx(math.radians(87.890625), abs=1e-12)
    joint = JointMap(servo_id=5, zero_ticks=300.0, lower_ticks=Ticks(10), upper_ticks=Ticks(600))
    assert joint.to_rad(Ticks(4090)) == pytest.approx(-306 * RAD_PER_TICK)


@pytest.mark.parametrize(
    "wrong",
    [
        {"direction": 0},
        {"lower_ticks": 2000, "upper_ticks": 2000},
        {"upper_ticks": 4096},
        {"lower_ticks": -1},
        {"zero_ticks": math.nan},
    ],
)
def test_impossible_maps_are_refused(wrong):
    with pytest.raises(ValueError, match=r"direction|range|finite"):
        JointMap(servo_id=1, **wrong)


@given(st.floats(1e-6, 100.0))
def test_caps_are_never_exceeded_and_never_round_to_the_servos_word_for_maximum(cap):
    speed, units = to_speed_ticks(cap), to_acceleration_units(cap)
    assert speed >= 1
    assert units >= 1
    assert speed == 1 or speed * RAD_PER_TICK <= cap * (1 + 1e-12)
    assert units == 1 or (386 + 108 * units) * RAD_PER_TICK <= cap * (1 + 1e-12)


@pytest.mark.parametrize("nothing", [0.0, -1.0, math.nan])
def test_a_cap_of_nothing_is_refused(nothing):
    with pytest.raises(ValueError, match="positive"):
        to_speed_ticks(nothing)
    with pytest.raises(ValueError, match="positive"):
        to_acceleration_units(nothing)
