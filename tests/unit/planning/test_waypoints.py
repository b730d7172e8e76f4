import numpy as np

from so101_motion.planning.goal_configurations import simplified


def test_repeated_waypoints_count_once():
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 1.0]])
    assert np.array_equal(simplified(corner), [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])


def test_waypoints_on_a_line_are_left_out():
    steps = np.linspace(0.0, 1.0, 11)[:, None] * np.array([0.3, -0.2])
    assert np.array_equal(simplified(steps), steps[[0, -1]])


def test_a_turn_back_is_a_corner():
    there_and_back = np.array([[0.0], [1.0], [0.5]])
    assert np.array_equal(simplified(there_and_back), there_and_back)


def test_ends_stay_even_if_they_are_the_same():
    assert np.array_equal(simplified(np.zeros((4, 5))), np.zeros((2, 5)))


def test_the_last_waypoint_stays_exactly():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 1.0 + 1e-8]])
    kept = simplified(points)
    assert len(kept) == 3
    assert np.array_equal(kept[-1], points[-1])


def test_nearly_repeated_waypoints_count_as_one():
    path = np.array([np.zeros(5), np.full(5, 0.5), np.full(5, 0.5 + 0.0015), np.arange(5.0)])
    np.testing.assert_array_equal(simplified(path), path[[0, 1, 3]])
