import numpy as np
import pytest

from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.drivers.feetech.joint_estimate import WINDOW, VelocityEstimate


def test_a_steady_movement_has_its_velocity():
    slope = VelocityEstimate(2)
    for k in range(50):
        slope.add(0.01 * k, np.array([0.5, -2.0]) * 0.01 * k)
    np.testing.assert_allclose(slope.value(), [0.5, -2.0])


def test_nothing_known_is_no_movement():
    slope = VelocityEstimate(3)
    assert slope.value() == [0.0] * 3
    slope.add(0.0, np.ones(3))
    slope.add(0.0, np.ones(3))
    assert slope.value() == [0.0] * 3


def test_a_stop_is_seen_within_the_window():
    slope = VelocityEstimate(1)
    for k in range(100):
        slope.add(0.01 * k, np.array([min(k, 50) * 0.01]))
    assert slope.value() == pytest.approx([0.0])


def test_scatter_of_a_resting_encoder_stays_below_what_counts_as_rest():
    from so101_motion.drivers.feetech.gravity_compensation import SETTLE_VELOCITY

    rng = np.random.default_rng(1)
    slope, worst = VelocityEstimate(1), []
    for k in range(2000):
        slope.add(0.01 * k, rng.integers(-1, 2, 1) * RAD_PER_TICK)
        worst.append(abs(slope.value()[0]))
    assert np.percentile(worst[20:], 99) < SETTLE_VELOCITY


def test_slow_polling_keeps_enough_points():
    slope = VelocityEstimate(1)
    for k in range(10):
        slope.add(0.2 * k, np.array([0.2 * k]))
    assert WINDOW < 0.2
    np.testing.assert_allclose(slope.value(), [1.0])


def test_fast_polling_tells_the_same():
    slope = VelocityEstimate(1)
    for k in range(1000):
        slope.add(0.0005 * k, np.array([0.5 * 0.0005 * k]))
    np.testing.assert_allclose(slope.value(), [0.5])


def test_after_a_gap_the_past_is_forgotten():
    slope = VelocityEstimate(1)
    for k in range(10):
        slope.add(0.01 * k, np.array([0.01 * k]))
    slope.clear()
    np.testing.assert_array_equal(slope.value(), [0.0])
