import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import so101_motion as so101
from so101_motion.arm.joint_caps import JERK_TIME, JointCaps, JointRange
from so101_motion.common.attributes import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG
from so101_motion.common.errors import ConfigError, OutsideLimits
from so101_motion.common.units import range_deg, to_deg, to_rad
from so101_motion.control.streamed_trajectory import TimedPoint

WIDE = JointRange(np.full(5, -2.0), np.full(5, 2.0))
NARROW = WIDE.narrowed(
    np.array([-3.0, -1.0, -1.0, -1.0, -1.0]), np.array([1.0, 1.0, 3.0, 1.0, 1.0])
)

postures = arrays(np.float64, 5, elements=st.floats(-3.0, 3.0))
ways = arrays(np.float64, (6, 5), elements=st.floats(-3.0, 3.0))


def refuses(call, q) -> bool:
    try:
        call(q)
    except OutsideLimits:
        return True
    return False


def is_inside(q: np.ndarray, bounds: JointRange = NARROW) -> bool:
    lower, upper = bounds.with_tolerance()
    return bool(np.all((q >= lower) & (q <= upper)))


def test_it_is_narrowed_never_widened_and_a_refusal_names_joint_value_and_range() -> None:
    np.testing.assert_array_equal(NARROW.lower, [-2.0, -1.0, -1.0, -1.0, -1.0])
    np.testing.assert_array_equal(NARROW.upper, [1.0, 1.0, 2.0, 1.0, 1.0])
    says = r"wrist_flex at 68\.75 deg .* -57\.29 to 57\.29 deg"
    assert refuses(NARROW.check, np.array([0.0, np.nan, 0.0, 0.0, 0.0]))
    with pytest.raises(OutsideLimits, match=says) as caught:
        NARROW.check(np.array([0.0, 0.0, 0.0, 1.2, 0.0]))
    error = caught.value
    assert (error.joint, error.value, error.lower, error.upper) == ("wrist_flex", 1.2, -1.0, 1.0)


@given(postures)
def test_exactly_what_is_outside_is_refused(q: np.ndarray) -> None:
    assert refuses(NARROW.check, q) is not is_inside(q)


@given(ways)
def test_a_path_is_refused_where_it_leaves_the_range_further_than_it_began(q: np.ndarray) -> None:
    around = JointRange(np.minimum(NARROW.lower, q[0]), np.maximum(NARROW.upper, q[0]))
    assert refuses(NARROW.check_path, q) is not all(is_inside(each, around) for each in q)


def test_a_path_in_from_outside_is_allowed_and_one_further_out_is_not() -> None:
    out = np.array([0.0, 0.0, 0.0, 0.0, 1.5])
    NARROW.check_path(np.linspace(out, np.zeros(5), 9))
    with pytest.raises(OutsideLimits, match="wrist_roll at 91"):
        NARROW.check_path(np.linspace(out, [0.0, 0.0, 0.0, 0.0, 1.6], 9))


@pytest.fixture
def arm(clock):
    with so101.open_simulated(clock=clock) as rig:
        yield rig.arm


@pytest.mark.parametrize("how", ["follow", "stream"])
def test_both_ends_of_a_shown_range_can_be_sent_by_every_surface(arm, how) -> None:
    arm.set_range(arm.model.lower + 0.1234567, arm.model.upper - 0.1234567)
    ends = []
    for i, bounds in enumerate(zip(*arm.range, strict=True)):
        shown = range_deg(*bounds).split(" to ")
        served = map(to_deg, bounds)
        ends += [to_rad(float(end)) * np.eye(5)[i] for end in (*shown, *served)]
    for q in ends:
        arm.range.check(arm.model.within_limits(q))  # as moves do
    if how == "follow":
        following = arm.follow()
        assert np.allclose([following.aim(q) for q in ends], ends, rtol=0.0, atol=1e-12)
        return
    points = [TimedPoint(t=20.0 * k, q=q) for k, q in enumerate([arm.state.q_ref, *ends])]
    stream = arm.stream()
    stream.push(points)
    for joint, bounds in zip(np.eye(5), zip(*arm.range, strict=True), strict=True):
        with pytest.raises(OutsideLimits, match=range_deg(*bounds)):
            stream.push([TimedPoint(t=points[-1].t + 20.0, q=(bounds[1] + 0.01) * joint)])


def test_a_stream_leads_an_arm_outside_its_range_in_but_not_farther_out(arm) -> None:
    arm.set_range(np.array([0.1, -3.0, -3.0, -3.0, -3.0]), np.full(5, 3.0))
    here, pan, stream = arm.state.q_ref, np.eye(5)[0], arm.stream()
    with pytest.raises(OutsideLimits):
        stream.push([TimedPoint(t=0.0, q=here), TimedPoint(t=1.0, q=here - 0.05 * pan)])
    stream.push([TimedPoint(t=0.0, q=here), TimedPoint(t=1.0, q=here + 0.05 * pan)])


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
