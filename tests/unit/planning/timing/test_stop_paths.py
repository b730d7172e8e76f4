"""The compiled path to rest is ruckig's."""

import math

import numpy as np
import pytest

from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.stop_paths import StopPaths
from so101_motion.planning.timing.trajectory import Setpoint

DT = 0.01
LIMITS = MotionLimits(
    velocity=np.full(5, 3.0),
    acceleration=np.array([6.0, 7.0, 8.0, 5.0, 10.0]),
    jerk=np.array([60.0, 150.0, 90.0, 400.0, 200.0]),
)


def drawn(random):
    """A state, some joints of it at rest, at a constant speed, or beyond their caps."""
    qd, qdd = random.normal(0.0, 1.5, 5), random.normal(0.0, 6.0, 5)
    qd[random.random(5) < 0.2] = 0.0
    qdd[random.random(5) < 0.3] = 0.0
    return Setpoint(q=random.normal(0.0, 1.0, 5), qd=qd, qdd=qdd)


def by_ruckig(now, period):
    return online.stop(now.q, now.qd, now.qdd, LIMITS, period)


@pytest.mark.parametrize("every", [0.02, 0.003, math.inf])
def test_it_is_ruckigs(every):
    random, paths, counts = np.random.default_rng(7), StopPaths(LIMITS, DT, every), set()
    for _ in range(1000):
        now = drawn(random)
        found = paths.to_rest(now)
        assert found.step <= every
        expected = by_ruckig(now, found.step)
        along = expected.q[[*range(len(found.path) - 1), -1]]
        assert np.abs(found.path - along).max() <= 1e-9
        assert found.step * (len(found.path) - 1) == pytest.approx(expected.duration, abs=1e-9)
        assert found.least == pytest.approx(found.path.min(axis=0).tolist(), abs=1e-9)
        assert found.largest == pytest.approx(found.path.max(axis=0).tolist(), abs=1e-9)
        expected = by_ruckig(now, DT).sample(DT)
        for name in ("q", "qd", "qdd"):
            mine, others = getattr(found.after, name), getattr(expected, name)
            assert mine == pytest.approx(others, abs=1e-6), name
        counts.add(len(found.path))
    assert len(counts) > 20 or every == math.inf


def test_step_by_step_it_ends_at_rest_where_it_was_announced():
    random, paths = np.random.default_rng(8), StopPaths(LIMITS, DT, 0.02)
    for _ in range(200):
        now = drawn(random)
        end, steps = paths.to_rest(now).path[-1], 0
        while now.qd.any() or now.qdd.any():
            now, steps = paths.to_rest(now).after, steps + 1
            assert steps < 300
        assert now.q == pytest.approx(end, abs=1e-9)


def test_joints_at_rest_stay():
    paths, now = StopPaths(LIMITS, DT, 0.02), Setpoint.at_rest(np.arange(5.0))
    for found in (paths.to_rest(now), paths._by_ruckig(now)):  # where the library finds none
        assert np.array_equal(found.path, [now.q, now.q])
        assert np.array_equal(found.after.q, now.q)
        assert not found.after.qd.any()


def test_the_answer_stays_as_it_was_when_the_next_is_asked_for():
    paths, random = StopPaths(LIMITS, DT, 0.02), np.random.default_rng(9)
    first = paths.to_rest(drawn(random))
    path, q = first.path.copy(), first.after.q.copy()
    paths.to_rest(drawn(random))
    assert np.array_equal(first.path, path)
    assert np.array_equal(first.after.q, q)


@pytest.mark.parametrize("qd", [np.full(5, math.nan), np.zeros(4), np.zeros(1)])
def test_what_is_no_state_of_these_joints_is_refused(qd):
    with pytest.raises(ValueError, match="qd must be 5 finite numbers"):
        StopPaths(LIMITS, DT, 0.02).to_rest(Setpoint(q=np.zeros(5), qd=qd, qdd=np.zeros(5)))


def test_one_joint_is_enough():
    limits = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=20.0, n=1)
    found = StopPaths(limits, DT, 0.05).to_rest(
        Setpoint(q=np.zeros(1), qd=np.ones(1), qdd=np.zeros(1))
    )
    expected = online.stop(np.zeros(1), np.ones(1), np.zeros(1), limits, DT)
    assert found.path[-1, 0] == pytest.approx(expected.q[-1, 0])
