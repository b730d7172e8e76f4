import numpy as np
import pytest

from so101_motion.planning.goal_configurations import simplified

LINE = np.linspace(0.0, 1.0, 11)[:, None] * np.array([0.3, -0.2])


@pytest.mark.parametrize(
    ("points", "kept"),
    [
        ([[0, 0], [1, 0], [1, 0], [1, 1], [1, 1]], [0, 1, 3]),  # repeated
        (LINE, [0, 10]),
        ([[0.0], [1.0], [0.5]], [0, 1, 2]),  # a turn back is a corner
        (np.zeros((4, 5)), [0, 3]),  # the ends stay
        ([[0, 0], [1, 0], [1, 1], [1, 1 + 1e-8]], [0, 1, 3]),  # the last exactly
        ([np.zeros(5), np.full(5, 0.5), np.full(5, 0.5015), np.arange(5)], [0, 1, 3]),
    ],
)
def test_repeated_waypoints_and_those_on_a_line_are_left_out(points, kept):
    points = np.array(points, dtype=float)
    np.testing.assert_array_equal(simplified(points), points[kept])
