"""A guided path, and how it is thinned within a tolerance."""

import numpy as np
import pytest

from so101_motion.tasks.guided.path import GuidedPath

RNG = np.random.default_rng(5)


def path_of(pan_deg, aperture=None):
    q = np.zeros((len(pan_deg), 5))
    q[:, 0] = np.radians(pan_deg)
    return GuidedPath(t=0.02 * np.arange(len(q)), q=q, aperture=aperture)


def pan_deg(path):
    return np.degrees(path.q[:, 0]).round(9).tolist()


@pytest.mark.parametrize(
    ("points", "tolerance", "kept"),
    [
        ([0, 1, 2, 3, 10, 20], 0.5, [0, 20]),  # on a line
        ([0, 5, 10, 5, 0, 5, 10, 5, 0], 1.0, [0, 10, 0, 10, 0]),  # wiping to and fro
        ([0, 8, 7.6, 9, 20], 0.5, [0, 20]),  # a little back on the way is no turn
        ([0, 8, 7.4, 9, 20], 0.5, [0, 8, 7.4, 20]),  # more than the tolerance is one
    ],
)
def test_turns_are_kept_and_points_between_them_are_not(points, tolerance, kept):
    assert pan_deg(path_of(points).thinned(np.radians(tolerance))) == kept


def test_an_arm_that_stands_is_one_place_and_the_ends_stay():
    still = path_of(0.1 * RNG.uniform(-1.0, 1.0, 50)).thinned(np.radians(0.5))
    assert len(still) == 2
    assert still.duration == pytest.approx(0.98)


def test_the_jaw_moves_with_the_arm():
    jaw = np.array([0.0, 0.0, 0.5, 0.5, 0.5])
    thinned = path_of([0, 10, 20, 30, 40], jaw).thinned(np.radians(1.0))
    assert pan_deg(thinned) == [0, 10, 20, 40]
    assert thinned.aperture.tolist() == [0.0, 0.0, 0.5, 0.5]


@pytest.mark.parametrize(
    "values",
    [
        {"t": [], "q": np.zeros((0, 5))},
        {"t": [1.0], "q": np.zeros((1, 5))},
        {"t": [0.0], "q": np.zeros((1, 5)), "aperture": [0.5, 0.5]},
    ],
)
def test_an_invalid_path_is_refused(values):
    with pytest.raises(ValueError, match=r"path|postures|shape|aperture"):
        GuidedPath(**values)
