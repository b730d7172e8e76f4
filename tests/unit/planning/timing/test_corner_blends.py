import numpy as np
import pytest

from so101_motion.planning.motion_builder import between_stops, roomy_corners
from so101_motion.planning.timing.path_geometry import blended_path

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
