import itertools

import numpy as np
import pytest

from so101_motion.planning.motion_builder import between_stops, roomy_corners
from so101_motion.planning.timing.path_geometry import JointPath, blended_path, spline_path

RNG = np.random.default_rng(7)
WAYPOINTS = np.cumsum(RNG.normal(scale=0.3, size=(12, 5)), axis=0)


def sides_of_knots(path: JointPath) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """The path just before and just after each inner knot, taken from the pieces on both sides."""
    pieces = np.arange(len(path.knots) - 2)
    lengths = np.diff(path.knots)[:-1]
    return path.on_pieces(pieces, lengths), path.on_pieces(pieces + 1, np.zeros(len(pieces)))


def distance_to_polyline(q: np.ndarray, points: np.ndarray) -> np.ndarray:
    """For each q, how far its worst joint is from the best of densely sampled polyline points."""
    u = np.linspace(0.0, 1.0, 400)[:, None]
    dense = np.concatenate([a + u * (b - a) for a, b in itertools.pairwise(points)])
    return np.array([np.abs(dense - one).max(axis=1).min() for one in q])


def test_a_spline_is_the_natural_one() -> None:
    interpolate = pytest.importorskip("scipy.interpolate")
    path = spline_path(WAYPOINTS)
    theirs = interpolate.CubicSpline(path.knots, WAYPOINTS, bc_type="natural")
    s = np.linspace(0.0, path.length, 500)
    for order, ours in enumerate(path.evaluate(s)):
        assert np.allclose(ours, theirs(s, order), atol=1e-10)


@pytest.mark.parametrize("path", [spline_path(WAYPOINTS), blended_path(WAYPOINTS, 0.02)])
def test_derivatives_agree_with_differences(path: JointPath) -> None:
    h = 1e-6
    inside = np.linspace(0.0, path.length, 300)[1:-1]
    s = inside[np.abs(inside[:, None] - path.knots).min(axis=1) > 2.0 * h]
    behind, here, ahead = path.evaluate(s - h), path.evaluate(s), path.evaluate(s + h)
    assert np.allclose((ahead.q - behind.q) / (2.0 * h), here.q_s, atol=1e-8)
    assert np.allclose((ahead.q_s - behind.q_s) / (2.0 * h), here.q_ss, atol=1e-6)


@pytest.mark.parametrize("n", [1, 2, 5, 7])
def test_two_points_make_a_straight_line_for_any_number_of_joints(n: int) -> None:
    start, goal = np.zeros(n), np.linspace(0.4, 1.0, n)
    for path in (spline_path([start, goal]), blended_path([start, goal], 0.1)):
        middle = path.evaluate([0.25 * path.length])
        assert np.allclose(middle.q, 0.25 * goal)
        assert np.allclose(middle.q_ss, 0.0)


@pytest.mark.parametrize("tolerance", [1e-4, 0.01, 0.3, 10.0])
def test_rounded_corners_stay_within_the_tolerance_of_the_lines(tolerance: float) -> None:
    path = blended_path(WAYPOINTS, tolerance)
    q = path.evaluate(np.linspace(0.0, path.length, 700)).q
    assert distance_to_polyline(q, WAYPOINTS).max() <= min(tolerance, 1.0) + 2e-3
    assert np.allclose(q[[0, -1]], WAYPOINTS[[0, -1]], atol=1e-14)


def test_a_corner_uses_the_tolerance_it_is_given() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    path = blended_path(points, 0.02)
    nearest = np.abs(path.evaluate(np.linspace(0.0, path.length, 5001)).q - points[1]).max(axis=1)
    assert nearest.min() == pytest.approx(0.02, rel=1e-3)


def test_rounded_corners_have_a_continuous_direction() -> None:
    before, after = sides_of_knots(blended_path(WAYPOINTS, 0.05))
    assert np.allclose(before[0], after[0], atol=1e-12)
    assert np.allclose(before[1], after[1], atol=1e-12)


def test_there_and_back_again_turns_within_the_tolerance() -> None:
    path = blended_path([[0.0, 0.0], [1.0, 0.5], [0.0, 0.0]], 0.01)
    q = path.evaluate(np.linspace(0.0, path.length, 2001)).q
    assert q[:, 0].max() == pytest.approx(1.0 - 0.01, abs=1e-6)
    assert np.allclose(q[-1], 0.0, atol=1e-14)


def test_points_in_line_need_no_corner() -> None:
    points = np.linspace([0.0, 0.0, 0.0], [0.9, -0.3, 0.6], 4)
    path = blended_path(points, 0.05)
    assert len(path.knots) == 4
    assert np.allclose(path.evaluate(np.linspace(0.0, path.length, 50)).q_ss, 0.0, atol=1e-12)


@pytest.mark.parametrize("make", [spline_path, lambda points: blended_path(points, 0.01)])
def test_repeated_points_count_once(make) -> None:
    once, twice = make(WAYPOINTS), make(np.repeat(WAYPOINTS, 2, axis=0))
    assert np.allclose(once.knots, twice.knots)
    assert np.allclose(once.coefficients, twice.coefficients)


@pytest.mark.parametrize("make", [spline_path, lambda points: blended_path(points, 0.01)])
def test_nearly_repeated_ends_keep_the_exact_start_and_goal(make) -> None:
    path = make([[0.0], [1e-10], [1.0], [1.0 + 1e-10]])
    assert path.evaluate([0.0]).q[0, 0] == 0.0
    assert path.evaluate([path.length]).q[0, 0] == pytest.approx(1.0 + 1e-10, abs=1e-15)


@pytest.mark.parametrize("make", [spline_path, lambda points: blended_path(points, 0.01)])
@pytest.mark.parametrize(
    ("points", "complaint"),
    [
        ([[0.1, 0.2]], "two different points"),
        ([[0.1, 0.2], [0.1, 0.2], [0.1, 0.2 + 1e-12]], "two different points"),
        (np.zeros((0, 5)), "two different points"),
        ([[0.1, 0.2], [np.nan, 0.2]], "finite"),
        ([0.1, 0.2], "shape"),
    ],
)
def test_a_path_that_is_none_is_refused(make, points, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        make(points)


@pytest.mark.parametrize("tolerance", [0.0, -0.1, np.inf, np.nan])
def test_a_tolerance_that_is_none_is_refused(tolerance: float) -> None:
    with pytest.raises(ValueError, match="tolerance"):
        blended_path([[0.0], [1.0], [0.5]], tolerance)


def test_knots_must_rise_from_zero() -> None:
    for knots in ([0.0, 1.0, 1.0], [0.5, 1.0, 2.0]):
        with pytest.raises(ValueError, match="rise from 0"):
            JointPath(knots=np.array(knots), coefficients=np.zeros((2, 4, 1)))


def test_beyond_its_ends_a_path_stays_at_its_end_points() -> None:
    path = spline_path(WAYPOINTS)
    assert np.allclose(path.evaluate([-1.0, path.length + 1.0]).q, WAYPOINTS[[0, -1]])


# Corners of a path around something


POINTS = np.array(
    [[0, 0, 0, 0, 0], [1, 0, 0, 0, 0], [1, 1, 0, 0, 0], [2, 1, 0, 0, 0], [3, 1, 0, 0, 0]], float
)
MOST, LEAST = 0.1, 0.002


def corners(is_free, points=POINTS):
    return roomy_corners(points, MOST, LEAST, lambda q: np.array([not is_free(each) for each in q]))


def test_where_all_is_free_every_corner_is_cut_as_widely_as_may_be():
    assert corners(lambda q: True) == pytest.approx([MOST] * 3)


def test_a_corner_beside_something_is_cut_less_and_the_others_are_not():
    post = np.array([0.9, 0.1, 0.0, 0.0, 0.0])
    found = corners(lambda q: np.linalg.norm(q - post) > 0.05)
    assert LEAST < found[0] < MOST
    assert found[1:] == pytest.approx([MOST] * 2)
    path = blended_path(POINTS, found)
    away = [np.linalg.norm(q - post) for q in path.evaluate(np.linspace(0.0, path.length, 999)).q]
    assert min(away) > 0.049


def test_a_corner_without_any_room_is_a_stop():
    def is_free(q):
        return min(abs(q[1]), abs(q[0] - 1.0)) < 1e-6 or q[1] > 0.5

    found = corners(is_free)
    assert found[0] == 0.0
    assert found[1] == pytest.approx(MOST)


def test_a_corner_that_is_straight_needs_no_room():
    straight = np.array([[0.0] * 5, [1.0] * 5, [2.0] * 5])
    assert corners(lambda q: False, straight) == pytest.approx([MOST])


def test_parts_between_stops_keep_their_corners():
    parts = list(between_stops(POINTS, np.array([0.1, 0.0, 0.05])))
    assert [part[:, 0].tolist() for part, _ in parts] == [[0.0, 1.0, 1.0], [1.0, 2.0, 3.0]]
    assert [cut.tolist() for _, cut in parts] == [[0.1], [0.05]]
