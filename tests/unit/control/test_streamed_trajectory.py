import numpy as np
import pytest

from so101_motion.common.errors import Interrupted, MotionError, OutsideLimits
from so101_motion.control.motion_source import FORESIGHT, PlannedMotion
from so101_motion.control.streamed_trajectory import LEAD, START_GATE, Stream, TimedPoint
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point

DT = 0.01
LIMITS = MotionLimits.uniform(velocity=1.5, acceleration=5.0, jerk=50.0)
HOME = np.array([0.1, -0.2, 0.3, -0.4, 0.5])


def make_stream(q_start=HOME):
    return Stream(q_start=q_start, limits=LIMITS, dt=DT)


def points(t, q):
    return [TimedPoint(t=float(at), q=where) for at, where in zip(t, q, strict=True)]


def smooth(duration=2.0, period=0.02, travel=0.8, q_start=HOME):
    """Dense points of a smooth motion of all joints, from rest to rest."""
    t = np.arange(round(duration / period) + 1) * period
    u = t / duration
    q = q_start + travel * (10 * u**3 - 15 * u**4 + 6 * u**5)[:, None]
    return t, q


def played(stream, until):
    """The setpoints from 0 to ``until``: times, positions, velocities, accelerations."""
    t = np.arange(round(until / DT) + 1) * DT
    samples = [stream.at(at) for at in t]
    return t, *(np.array([getattr(s, name) for s in samples]) for name in ("q", "qd", "qdd"))


def test_playing_waits_for_points_enough_or_for_the_end():
    stream, short = make_stream(), make_stream()
    t, q = smooth()
    for point in points(t, q):
        assert stream.is_primed == (point.t > LEAD)
        stream.push([point])
        if point.t > LEAD:
            break
    short.push(points([0.0, 0.1], [HOME, HOME]))
    assert not short.is_primed
    short.finish()
    assert short.is_primed


def test_it_begins_at_rest_exactly_where_the_arm_is():
    stream = make_stream()
    t, q = smooth(q_start=HOME + np.radians(4.0))
    stream.push(points(t, q))
    first = stream.at(0.0)
    np.testing.assert_allclose(first.q, HOME, atol=1e-12)
    np.testing.assert_allclose(first.qd, 0.0, atol=1e-12)
    np.testing.assert_allclose(first.qdd, 0.0, atol=1e-9)


def test_dense_points_are_followed_closely_a_little_later():
    stream = make_stream()
    t, q = smooth()
    stream.push(points(t, q))
    at, played_q, _, _ = played(stream, 2.0)

    def off(delay):
        return np.max(np.abs(played_q[:, 0] - np.interp(at - delay, t, q[:, 0])))

    assert min(off(delay) for delay in np.arange(0.0, 0.15, 0.005)) < np.radians(0.3)


def test_coarse_points_become_a_motion_within_all_limits():
    stream = make_stream()
    t = np.arange(5) * 0.7
    q = HOME + np.array([0.0, 0.8, -0.2, -0.2, 0.8])[:, None] * np.ones(5)
    stream.push(points(t, q))
    _, played_q, qd, qdd = played(stream, 2.8)
    assert np.max(np.abs(qd)) <= LIMITS.velocity[0]
    assert np.max(np.abs(qdd)) <= LIMITS.acceleration[0] * 1.01
    assert np.max(np.abs(np.diff(played_q, 3, axis=0))) / DT**3 <= LIMITS.jerk[0] * 1.01


def test_a_start_a_little_off_fades_out_and_adds_at_most_a_tenth():
    stream = make_stream()
    off = START_GATE * np.array([0.9, -0.9, 0.5, 0.0, 0.2])
    q_first = HOME + off
    stream.push(points([0.0, 10.0], [q_first, q_first]))
    _, q, qd, qdd = played(stream, 10.0)
    assert np.max(np.abs(qd)) <= 0.1 * LIMITS.velocity[0] * 1.001
    assert np.max(np.abs(qdd)) <= 0.1 * LIMITS.acceleration[0] * 1.001
    np.testing.assert_allclose(q[-1], q_first, atol=1e-9)


def test_it_makes_no_difference_in_how_many_pieces_the_points_arrive():
    whole, pieces = make_stream(), make_stream()
    t, q = smooth(duration=6.0)
    whole.push(points(t, q))
    pieces.push(points(t[:25], q[:25]))
    next_point = 25
    for k in range(500):
        while next_point < len(t) and t[next_point] < k * DT + 0.3:
            pieces.push(points(t[next_point : next_point + 1], q[next_point : next_point + 1]))
            next_point += 1
        np.testing.assert_allclose(pieces.at(k * DT).q, whole.at(k * DT).q, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("t", "q"), [(float("nan"), HOME), (0.0, HOME * np.inf)])
def test_points_must_be_finite(t, q):
    with pytest.raises(ValueError, match="must be finite"):
        TimedPoint(t=t, q=q)


def test_a_start_too_far_away_names_joint_and_figures():
    q_first = HOME.copy()
    q_first[3] += np.radians(5.5)
    with pytest.raises(OutsideLimits) as caught:
        make_stream().push(points([0.0], [q_first]))
    assert caught.value.joint == "wrist_flex"
    assert caught.value.value == pytest.approx(q_first[3])
    says = "wrist_flex: the first point of the stream is -17.4 deg, but the arm is at -22.9"
    assert says in str(caught.value)


def test_points_too_fast_name_joint_time_and_figures_and_are_not_taken():
    stream = make_stream()
    q_fast = HOME.copy()
    q_fast[1] += 0.4
    with pytest.raises(OutsideLimits) as caught:
        stream.push(points([0.0, 0.2], [HOME, q_fast]))
    assert caught.value.joint == "shoulder_lift"
    assert caught.value.value == pytest.approx(2.0)
    assert caught.value.upper == 1.5
    says = "shoulder_lift: the points ask for 114.6 deg/s at 0.000 s, the limit is 85.9 deg/s"
    assert says in str(caught.value)
    stream.push(points([0.0, 0.4], [HOME, q_fast]))
    assert stream.t_last == 0.4


def test_speed_is_watched_across_batches():
    stream = make_stream()
    stream.push(points([0.0], [HOME]))
    with pytest.raises(OutsideLimits, match=r"deg/s at 0\.000 s"):
        stream.push(points([0.1], [HOME + 0.5]))


def test_a_later_jolt_that_the_smoothing_cannot_take_is_refused():
    stream = make_stream()
    t, q = smooth(duration=4.0)
    stream.push(points(t[:100], q[:100]))
    back = points(t[99] + np.array([0.1, 0.2]), q[99] - np.array([[0.14], [0.28]]))
    with pytest.raises(OutsideLimits) as caught:
        stream.push(back)
    assert "deg/s^2" in str(caught.value)
    assert caught.value.value > LIMITS.acceleration[0]
    stream.push(points(t[100:], q[100:]))


def test_a_finished_stream_takes_no_more():
    stream = make_stream()
    stream.push(points([0.0], [HOME]))
    stream.finish()
    with pytest.raises(MotionError, match="has been finished"):
        stream.push(points([1.0], [HOME]))
    with pytest.raises(MotionError, match="has been finished"):
        stream.finish()


def test_an_empty_stream_cannot_be_finished():
    with pytest.raises(MotionError, match="holds no points"):
        make_stream().finish()


def test_a_stream_that_is_over_says_why():
    failed, done = make_stream(), make_stream()
    failed.future.set_exception(Interrupted("stop"))
    done.future.set_result(None)
    with pytest.raises(Interrupted, match="stop"):
        failed.push(points([0.0], [HOME]))
    with pytest.raises(MotionError, match="open a new one"):
        done.push(points([0.0], [HOME]))


def test_an_empty_batch_changes_nothing():
    stream = make_stream()
    stream.push([])
    assert not stream.is_primed


def stopped(stream, count, limits=LIMITS, *, refused=False):
    """The last of so many setpoints, and the stop from it; the next one may have been refused."""
    for k in range(count):
        now = stream.sample(k)
    if refused:
        stream.sample(count)
    stop = stream.brake(now, limits)
    np.testing.assert_allclose(stop.q[0], now.q, atol=1e-12)
    return now, stop


@pytest.mark.parametrize("refused", [False, True])
def test_a_stop_stays_on_the_points_that_are_known(refused):
    """Joints that turn at different times would leave them if each stopped by itself."""
    stream = make_stream()
    t = np.arange(151) * 0.02
    u = np.clip((t[:, None] - np.array([0.0, 0.15, 0.3, 0.45, 0.6])) / 2.0, 0.0, 1.0)
    q = HOME + 0.8 * (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5)
    stream.push(points(t, q))
    hard = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=200.0)
    now, stop = stopped(stream, 100, hard, refused=refused)
    assert np.abs(stop.q[1] - now.q).max() < 1.5 * DT
    assert not stop.qd[-1].any()
    path = np.array([stream.at(at).q for at in np.arange(0.9, 2.0, 0.001)])
    off = [np.abs(path - each).max(axis=1).min() for each in stop.q]
    assert max(off) < 1e-3
    assert np.abs(np.diff(stop.q, 2, axis=0)).max() / DT**2 < 1.1 * 10.0


def test_a_stop_that_takes_longer_than_the_points_reach_stops_each_joint():
    stream = make_stream()
    t = np.arange(41) * 0.02
    stream.push(points(t, HOME + 0.7 * t[:, None] ** 2 * np.ones(5)))
    now, stop = stopped(stream, 79)
    assert now.qd[0] > 0.5
    assert not stop.qd[-1].any()
    assert np.abs(np.diff(stop.q, 2, axis=0)).max() / DT**2 < 1.02 * LIMITS.acceleration[0]


def test_a_stop_at_rest_stays_there_although_the_last_point_is_known():
    stream = make_stream()
    stream.push(points(*smooth(duration=1.0)))
    stream.finish()
    _, stop = stopped(stream, 1)
    np.testing.assert_allclose(stop.q[-1], HOME, atol=1e-3)


def test_a_stop_near_the_end_goes_on_to_the_last_point():
    stream = make_stream()
    t = np.arange(26) * 0.02
    q = HOME + 0.7 * t[:, None] ** 2 * np.ones(5)  # ends at speed
    stream.push(points(t, q))
    stream.finish()
    now, stop = stopped(stream, 50)
    assert now.qd[0] > 0.4
    np.testing.assert_allclose(stop.q[-1], q[-1], atol=1e-9)


@pytest.mark.parametrize(
    ("before", "times", "says"),
    [
        ((), (0.1,), r"must be for time 0, not 0\.1 s"),
        ((0.0,), (0.0,), "must increase"),
        ((0.0,), (-0.1,), "must increase"),
        ((0.0,), (0.2, 0.2), "must increase"),
        ((), (0.0, 80_000.0), "point for 80000 s is more than 600 s ahead"),
    ],
)
def test_points_of_wrong_times_are_refused_and_not_taken(before, times, says):
    stream = make_stream()
    stream.push(points(before, [HOME] * len(before)))
    with pytest.raises(ValueError, match=says):
        stream.push(points(times, [HOME] * len(times)))
    good = [0.1] if before else [0.0, 0.1]
    stream.push(points(good, [HOME] * len(good)))
    assert stream.t_last == pytest.approx(0.1)


# A planned motion as a source of commands


def planned(to):
    trajectory = point_to_point(np.zeros(5), np.full(5, to), LIMITS, DT)
    return trajectory, PlannedMotion(trajectory)


def test_the_stop_ahead_begins_at_the_setpoint_and_rests_on_the_path():
    _, motion = planned(0.8)
    setpoint = motion.sample(40)
    q, dt = motion.stop_ahead()
    np.testing.assert_array_equal(q[0], setpoint.q)
    assert np.all(np.diff(q[:, 0]) >= 0.0)
    assert q[0, 0] < q[-1, 0] < 0.8
    assert 0.1 < dt * (len(q) - 1) < 1.0


def test_a_motion_whose_last_ticks_were_missed_stops_where_it_ends():
    trajectory, motion = planned(0.3)
    motion.sample(len(trajectory) + 7)
    q, _ = motion.stop_ahead()
    assert np.all(q == trajectory.q[-1])


def test_the_acceleration_ahead_ends_at_the_speed_that_will_be_had():
    trajectory, motion = planned(0.8)
    for k in (0, 20, len(trajectory) - 3, len(trajectory) + 7):
        now = motion.sample(k)
        later = trajectory.sample(k * 0.01 + FORESIGHT)
        np.testing.assert_allclose(now.qd + FORESIGHT * motion.acceleration, later.qd, atol=1e-12)


def test_a_setpoint_that_was_refused_is_not_skipped_by_the_stop():
    """The stop begins where the joints are, so they do not take two steps in one cycle."""
    _, motion = planned(0.8)
    now = motion.sample(40)
    motion.sample(41)
    stop = motion.brake(now, LIMITS)
    np.testing.assert_array_equal(stop.q[0], now.q)
    assert np.abs(stop.q[1] - now.q).max() <= 1.5 * 0.01
