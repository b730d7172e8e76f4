import numpy as np
import pytest

from so101_motion.planning.timing.jerk_filter import (
    Curve,
    Window,
    averaged_motion,
    averaged_positions,
    curve_through,
    fitting_window,
    sampled,
)
from so101_motion.planning.timing.limits import MotionLimits

WIDTH = 0.04
ACCELERATION = 10.0


def there(hold: float = 0.3) -> Curve:
    """One joint: full acceleration for ``hold`` seconds, then full braking; rest around it."""
    top = ACCELERATION * hold
    q = np.array([0.0, 0.5 * top * hold, top * hold])[:, None]
    qd = np.array([0.0, top, 0.0])[:, None]
    full = np.array([ACCELERATION, -ACCELERATION])[:, None]
    return curve_through(np.array([hold, hold]), q, qd, full, full, rest=2.0 * WIDTH)


def window(curve: Curve, first: float = WIDTH, last: float = WIDTH) -> Window:
    return Window(first=first, middle=WIDTH, last=last, ramp=0.1, duration=curve.duration)


def differences(values: np.ndarray, h: float) -> np.ndarray:
    return (values[2:] - values[:-2]) / (2.0 * h)


def test_a_curve_meets_the_states_it_was_made_of() -> None:
    curve = there()
    _, q, qd, qdd = curve.at(np.array([-0.05, 0.0, 0.15, 0.3, 0.6, 0.65]), 4)
    assert np.allclose(q[0], [0.0, 0.0, 0.1125, 0.45, 0.9, 0.9])
    assert np.allclose(qd[0], [0.0, 0.0, 1.5, 3.0, 0.0, 0.0])
    assert np.allclose(qdd[0], [0.0, 10.0, 10.0, -10.0, 0.0, 0.0], atol=1e-9)


def test_a_curve_keeps_the_integral_of_its_positions() -> None:
    curve = there()
    t = np.linspace(-0.05, 0.64, 4001)
    integral, q = curve.at(t, 2)
    assert np.allclose(differences(integral.T, t[1] - t[0]), q.T[1:-1], atol=1e-6)


@pytest.mark.parametrize("ends", [(WIDTH, WIDTH), (0.5 * WIDTH, WIDTH), (0.02, 0.02)])
def test_velocity_and_acceleration_are_the_derivatives_of_the_average(ends) -> None:
    curve = there()
    wide = window(curve, *ends)
    h = 1e-5
    t = np.arange(wide.begin - 0.01, wide.end + 0.01, h)
    q, qd, qdd = averaged_motion(curve, wide, t)
    assert np.allclose(averaged_positions(curve, wide, t), q, atol=1e-14)
    assert np.allclose(differences(q, h), qd[1:-1], atol=1e-5)
    assert np.allclose(differences(qd, h), qdd[1:-1], atol=2e-2)


def test_an_average_keeps_speed_and_acceleration_and_bounds_jerk() -> None:
    curve = there()
    even = window(curve)
    t = np.arange(even.begin - 0.01, even.end + 0.01, 1e-4)
    _, qd, qdd = averaged_motion(curve, even, t)
    assert np.abs(qd).max() <= 3.0
    assert np.abs(qdd).max() <= ACCELERATION + 1e-9
    assert np.abs(np.diff(qdd, axis=0)).max() / 1e-4 <= 2.0 * ACCELERATION / WIDTH + 1e-6


def test_an_average_leaves_the_path_by_no_more_than_its_formula() -> None:
    curve = there()
    t = np.linspace(-0.02, 0.62, 3000)
    away = averaged_positions(curve, window(curve), t) - curve.at(t, 2)[1].T
    bound = ACCELERATION * WIDTH**2 / 24.0
    assert 0.99 * bound <= np.abs(away).max() <= bound + 1e-12


def test_the_averaged_motion_starts_and_ends_at_rest_where_the_motion_did() -> None:
    curve = there()
    narrow = window(curve, 0.5 * WIDTH, 0.5 * WIDTH)
    trajectory = sampled(curve, narrow, 1.0, 0.01)
    assert trajectory.duration == pytest.approx(0.6 + 0.5 * WIDTH)
    assert trajectory.q[[0, -1], 0] == pytest.approx([0.0, 0.9], abs=1e-15)
    assert not trajectory.qd[[0, -1]].any()
    assert not trajectory.qdd[[0, -1]].any()


def test_twice_as_slow_is_the_same_path_at_half_the_speed() -> None:
    curve = there()
    once, twice = (sampled(curve, window(curve), stretch, 0.01) for stretch in (1.0, 2.0))
    assert twice.duration == pytest.approx(2.0 * once.duration)
    assert np.allclose(twice.q[::2][: len(once) - 1], once.q[:-1], atol=1e-12)
    assert np.allclose(2.0 * twice.qd[::2][: len(once) - 1], once.qd[:-1], atol=1e-11)
    assert np.allclose(4.0 * twice.qdd[::2][: len(once) - 1], once.qdd[:-1], atol=1e-8)


def test_half_the_width_is_taken_at_the_ends_where_it_keeps_the_limits() -> None:
    calm = MotionLimits.uniform(velocity=4.0, acceleration=1.05 * ACCELERATION, jerk=510.0, n=1)
    tight = MotionLimits.uniform(velocity=4.0, acceleration=ACCELERATION, jerk=500.0, n=1)
    chosen = fitting_window(there(), WIDTH, calm)
    assert (chosen.first, chosen.middle, chosen.last) == (0.5 * WIDTH, WIDTH, 0.5 * WIDTH)
    chosen = fitting_window(there(), WIDTH, tight)
    assert (chosen.first, chosen.last) == (WIDTH, WIDTH)


def test_a_motion_shorter_than_the_change_of_width_gets_an_even_window() -> None:
    calm = MotionLimits.uniform(velocity=4.0, acceleration=20.0, jerk=1000.0, n=1)
    chosen = fitting_window(there(hold=0.1), WIDTH, calm)
    assert (chosen.first, chosen.last) == (WIDTH, WIDTH)
