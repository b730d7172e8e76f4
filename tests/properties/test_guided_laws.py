"""Laws of thinned guided paths: they stay within the tolerance and keep their order."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.tasks.guided.path import JAW_TOLERANCE, GuidedPath, along


@st.composite
def paths(draw):
    """Ways of a hand: steps of any size, with pauses, turns and loops, and a jaw or none."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 120))
    rate = draw(st.sampled_from([0.001, 0.02, 0.3]))
    steps = rate * rng.standard_normal((n, 5)) * (rng.random((n, 1)) < 0.8)
    q = np.clip(np.cumsum(steps, axis=0), -1.5, 1.5)
    jaw = np.clip(0.5 + np.cumsum(0.05 * rng.standard_normal(n)), 0.0, 1.0)
    return GuidedPath(t=0.01 * np.arange(n), q=q, aperture=jaw if draw(st.booleans()) else None)


def between(corners, where):
    return np.column_stack([np.interp(where, range(len(corners)), each) for each in corners.T])


@given(paths(), st.floats(0.005, 0.2))
def test_every_point_is_near_what_is_left_of_its_path_in_order(path, tolerance):
    kept = path.corners(tolerance)
    assert kept[0] == 0
    assert kept[-1] == len(path) - 1
    assert np.all(np.diff(kept) > 0) or len(path) == 1
    columns = [path.q]
    if path.aperture is not None:
        columns.append(path.aperture[:, None] * tolerance / JAW_TOLERANCE)
    x = np.hstack(columns)
    for begin, end in pairwise(kept):
        way, reached = x[end] - x[begin], 0.0
        for point in x[begin : end + 1]:
            share = (point - x[begin]) @ way / max(way @ way, 1e-300)
            reached = max(reached, min(max(share, 0.0), 1.0))
            assert np.abs(point - x[begin] - reached * way).max() <= tolerance + 1e-9


@given(paths(), st.integers(0, 2**32 - 1))
def test_points_that_go_along_a_polyline_are_found_on_it_in_order(path, seed):
    if len(path) < 2:
        return
    where = np.linspace(0.0, len(path) - 1.0, 60 + seed % 200)
    on_it = between(path.q, where)
    found = along(path.q, on_it)
    assert np.all(np.diff(found) >= 0.0)
    assert np.abs(between(path.q, found) - on_it).max() < np.radians(0.5)
