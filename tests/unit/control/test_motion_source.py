"""A planned motion as a source of commands: how it would stop."""

import numpy as np

from so101_motion.control.motion_source import FORESIGHT, PlannedMotion
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point

CAPS = MotionLimits.uniform(velocity=1.5, acceleration=5.0, jerk=50.0)


def test_the_stop_ahead_begins_at_the_setpoint_and_rests_on_the_path():
    trajectory = point_to_point(np.zeros(5), np.full(5, 0.8), CAPS, 0.01)
    motion = PlannedMotion(trajectory)
    setpoint = motion.sample(40)
    q, dt = motion.stop_ahead()
    np.testing.assert_array_equal(q[0], setpoint.q)
    assert np.all(np.diff(q[:, 0]) >= 0.0)
    assert q[0, 0] < q[-1, 0] < 0.8
    assert 0.1 < dt * (len(q) - 1) < 1.0


def test_a_motion_whose_last_ticks_were_missed_stops_where_it_ends():
    trajectory = point_to_point(np.zeros(5), np.full(5, 0.3), CAPS, 0.01)
    motion = PlannedMotion(trajectory)
    motion.sample(len(trajectory) + 7)
    q, _ = motion.stop_ahead()
    assert np.all(q == trajectory.q[-1])


def test_the_acceleration_ahead_ends_at_the_speed_that_will_be_had():
    trajectory = point_to_point(np.zeros(5), np.full(5, 0.8), CAPS, 0.01)
    motion = PlannedMotion(trajectory)
    for k in (0, 20, len(trajectory) - 3, len(trajectory) + 7):
        now = motion.sample(k)
        later = trajectory.sample(k * 0.01 + FORESIGHT)
        np.testing.assert_allclose(now.qd + FORESIGHT * motion.acceleration, later.qd, atol=1e-12)


def test_a_setpoint_that_was_refused_is_not_skipped_by_the_stop():
    """The stop begins where the joints are, so they do not take two steps in one cycle."""
    trajectory = point_to_point(np.zeros(5), np.full(5, 0.8), CAPS, 0.01)
    motion = PlannedMotion(trajectory)
    now = motion.sample(40)
    motion.sample(41)
    stop = motion.brake(now, CAPS)
    np.testing.assert_array_equal(stop.q[0], now.q)
    assert np.abs(stop.q[1] - now.q).max() <= 1.5 * 0.01
