from itertools import pairwise

import numpy as np
import pytest

from so101_motion.planning.paths.rrt_connect import Deadline
from so101_motion.planning.paths.shorten import shortened, skipped


class Plane:
    """The first two joints in a plane with a round pillar; the others are free."""

    def __init__(self, radius):
        self._radius = radius
        self.looks = 0

    def is_free(self, q):
        return float(np.hypot(q[0], q[1])) > self._radius

    def is_clear(self, q_from, q_to):
        self.looks += 1
        shares = np.linspace(0.0, 1.0, 200)[1:-1, None]
        return all(map(self.is_free, q_from + shares * (q_to - q_from)))


def length(points):
    return sum(float(np.linalg.norm(b - a)) for a, b in pairwise(points))


def zigzag(seed=0, count=40):
    """A detour around the pillar, with noise in all joints."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(np.pi, 0.0, count)
    points = np.zeros((count, 5))
    points[:, 0], points[:, 1] = 2.0 * np.cos(angle), 2.0 * np.sin(angle)
    points[1:-1] += rng.normal(0.0, 0.15, (count - 2, 5))
    return list(points)


def run(points, checker, seed=0, deadline=None):
    return shortened(points, checker, np.random.default_rng(seed), deadline or Deadline(60.0))


def test_with_nothing_in_the_way_a_straight_line_is_left():
    points = zigzag()
    found = run(points, Plane(0.0001))
    assert length(found) == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize("seed", range(10))
def test_around_a_pillar_the_rope_is_nearly_tight(seed):
    checker = Plane(1.0)
    points = zigzag(seed)
    found = run(points, checker, seed)
    assert np.array_equal(found[0], points[0])
    assert np.array_equal(found[-1], points[-1])
    assert all(checker.is_clear(a, b) for a, b in pairwise(found))
    tight = 2.0 * np.sqrt(3.0) + np.pi / 3.0
    assert length(found) < 1.1 * tight
    assert length(found) < 0.6 * length(points)


def test_the_same_random_numbers_shorten_alike():
    first, second = (run(zigzag(), Plane(1.0), seed=3) for _ in range(2))
    assert np.array_equal(first, second)


def test_skipping_never_makes_a_path_longer():
    for seed in range(20):
        points = zigzag(seed)
        assert length(skipped(points, Plane(1.0))) <= length(points) + 1e-9


def test_a_path_that_cannot_be_shorter_stays():
    blind = Plane(1.0)
    blind.is_clear = lambda a, b: False
    points = zigzag(count=6)
    found = run(points, blind)
    assert length(found) == pytest.approx(length(points))
    assert all(any(np.allclose(q, p) for q in found) for p in points)


def test_repeated_points_do_no_harm():
    points = [q for q in zigzag(count=12) for _ in range(2)]
    found = run(points, Plane(1.0))
    assert np.all(np.isfinite(found))
    assert length(found) < length(points)


def test_when_time_is_up_what_there_is_will_do():
    checker = Plane(1.0)
    late = Deadline(-1.0)
    quick = run(zigzag(), checker, deadline=late)
    looks = checker.looks
    run(zigzag(), checker)
    assert checker.looks > 2 * looks
    assert length(quick) < length(zigzag())
