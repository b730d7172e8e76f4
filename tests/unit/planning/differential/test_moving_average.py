import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.planning.differential.servo import MovingAverage
from so101_motion.planning.timing.limits import MotionLimits

DT = 0.01
START = np.array([0.1, -0.2, 0.3, 0.4, -0.5])
seeds = st.integers(min_value=0, max_value=2**32 - 1)


def limits(acceleration: float = 2.0, jerk: float = 20.0) -> MotionLimits:
    return MotionLimits.uniform(velocity=1.0, acceleration=acceleration, jerk=jerk)


def erratic(rng: np.random.Generator, most: float, steps: int) -> np.ndarray:
    """A reference whose accelerations jump from one extreme to the other."""
    qdd = most * rng.choice([-1.0, 0.0, 1.0], (steps, 5)).repeat(rng.integers(1, 30), axis=0)
    return START + np.cumsum(np.cumsum(qdd[:steps], axis=0), axis=0) * DT**2


@given(seeds, st.floats(0.5, 10.0), st.floats(0.001, 0.3))
def test_jerk_is_bounded_whatever_the_reference_does(seed: int, most: float, rise: float) -> None:
    average = MovingAverage(START, limits(most, most / rise), DT)
    reference = erratic(np.random.default_rng(seed), most, 80)
    q = np.array([START, START, START, *(average.step(each) for each in reference)])
    assert np.abs(np.diff(q, 3, axis=0)).max() / DT**3 <= most / rise * (1.0 + 1e-6) + 1e-6
    assert np.abs(np.diff(q, 2, axis=0)).max() / DT**2 <= most * (1.0 + 1e-6) + 1e-9
    assert np.all(q >= np.minimum(START, reference.min(axis=0)) - 1e-12)
    assert np.all(q <= np.maximum(START, reference.max(axis=0)) + 1e-12)


@given(seeds, st.integers(1, 30))
def test_it_goes_where_it_said_it_would(seed: int, known: int) -> None:
    average = MovingAverage(START, limits(), DT)
    reference = erratic(np.random.default_rng(seed), 2.0, 40)
    for each in reference[:-known]:
        average.step(each)
    ahead = average.ahead(reference[-known:])
    waiting = [reference[-1]] * (average.steps - 1)
    np.testing.assert_allclose(
        ahead, [average.step(each) for each in (*reference[-known:], *waiting)], atol=1e-12
    )


def test_it_stands_exactly_where_the_reference_stands() -> None:
    average = MovingAverage(START, limits(), DT)
    end = START + 1.0 / 3.0
    q = [average.step(end) for _ in range(average.steps)]
    assert not np.array_equal(q[-2], end)
    assert np.array_equal(q[-1], end)
    assert np.array_equal(average.ahead(end[None])[0], end)


def test_it_is_late_by_half_its_window() -> None:
    average = MovingAverage(START, limits(2.0, 20.0), DT)
    assert average.steps == 20
    for k in range(100):
        q = average.step(START + 0.5 * DT * k)
    assert START + 0.5 * DT * 99 - q == pytest.approx(np.full(5, 0.5 * DT * 9.5))


def test_without_a_bound_worth_the_name_it_is_where_the_reference_is() -> None:
    average = MovingAverage(START, limits(2.0, 1e6), DT)
    assert average.steps == 1
    assert np.array_equal(average.step(2.0 * START), 2.0 * START)
    assert np.array_equal(average.ahead(2.0 * START[None]), 2.0 * START[None])
