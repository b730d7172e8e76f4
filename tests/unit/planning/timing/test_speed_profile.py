import numpy as np
import pytest

from so101_motion.common.errors import PlanningError
from so101_motion.planning.timing import speed_profile
from so101_motion.planning.timing.interval_program import LimitRows
from so101_motion.planning.timing.path_geometry import JointPath, blended_path, spline_path
from so101_motion.planning.timing.speed_profile import PathGrid, optimal_speed

POINTS = np.array([[0.0, 0.0, 0.0], [0.8, -0.3, 0.2], [0.9, 0.5, -0.4], [0.2, 0.3, -0.6]])
VELOCITY, ACCELERATION = np.full(3, 3.0), np.full(3, 10.0)


def best(path: JointPath, *, fine: bool = False, further=None) -> tuple[PathGrid, np.ndarray]:
    grid = PathGrid.on(path, fine=fine)
    cap = 1.0 / np.max(np.abs(grid.nodes[1]) / VELOCITY, axis=1)
    return optimal_speed(grid, cap, np.tile(ACCELERATION, (len(grid.steps), 1)), further)


def duration(grid: PathGrid, rate: np.ndarray) -> float:
    return float(np.sum(2.0 * grid.steps / (rate[1:] + rate[:-1])))


def accelerations(grid: PathGrid, rate: np.ndarray) -> np.ndarray:
    """Joint accelerations at both ends of each interval."""
    u = ((rate[1:] ** 2 - rate[:-1] ** 2) / (2.0 * grid.steps))[:, None]
    squares = rate[:, None] ** 2
    begin, end = grid.begin, grid.end
    return np.concatenate(
        [begin.q_s * u + begin.q_ss * squares[:-1], end.q_s * u + end.q_ss * squares[1:]]
    )


def test_a_straight_path_has_the_three_phases_of_a_trapezoid() -> None:
    grid, rate = best(blended_path([np.zeros(3), [2.0, 1.0, 0.0]], 0.01))
    scale = np.sqrt(5.0) / 2.0  # path length for each radian of the first joint
    top = 3.0 * scale * (1.0 - 1e-4)
    assert rate == pytest.approx([0.0, top, top, 0.0])
    assert grid.steps[[0, 2]] == pytest.approx(2 * [top**2 / (2.0 * 10.0 * scale)])
    assert duration(grid, rate) == pytest.approx(2.0 / 3.0 + 3.0 / 10.0, rel=1e-3)


def test_a_short_straight_path_turns_from_speeding_up_to_braking_in_its_middle() -> None:
    grid, rate = best(blended_path([np.zeros(3), [0.1, 0.0, 0.0]], 0.01))
    assert grid.steps == pytest.approx([0.05, 0.05])
    assert rate == pytest.approx([0.0, 1.0, 0.0])


@pytest.mark.parametrize("path", [blended_path(POINTS, 0.05), spline_path(POINTS)])
def test_limits_are_kept_at_both_ends_of_every_interval_and_used(path: JointPath) -> None:
    grid, rate = best(path)
    shares = np.abs(accelerations(grid, rate)) / ACCELERATION
    assert shares.max() <= 1.0 + 1e-5
    speeds = np.abs(grid.nodes[1] * rate[:, None]) / VELOCITY
    assert speeds.max() <= 1.0
    assert np.median(np.maximum(shares.max(axis=1), speeds[1:].max())) > 0.9
    assert rate[0] == rate[-1] == 0.0


@pytest.mark.parametrize("tolerance", [0.002, 0.02, 0.1])
def test_a_coarse_grid_with_exact_straights_is_as_quick_as_a_fine_one(
    tolerance: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = blended_path(POINTS, tolerance)
    quick = duration(*best(path))
    monkeypatch.setattr(speed_profile, "GRID_POINTS", 5000)
    monkeypatch.setattr(speed_profile, "GRID_PER_PIECE", (16, 1500))
    bound = duration(*best(path, fine=True))
    assert quick <= 1.002 * bound


def test_an_even_interval_is_cut_where_it_is_asked_for_and_a_round_one_is_not() -> None:
    grid = PathGrid.on(blended_path(POINTS, 0.05), fine=False)
    cut = grid.divided_at(np.array([0.1, float(grid.steps.sum()) - 0.1]))
    assert len(cut.steps) == len(grid.steps) + 2
    assert cut.steps[[0, -1]] == pytest.approx([0.1, 0.1])
    assert cut.steps.sum() == pytest.approx(grid.steps.sum())
    assert np.allclose(cut.begin.q[1:], cut.end.q[:-1])
    corner = float(grid.steps[0]) + 0.5 * float(grid.steps[1])
    assert not grid.is_even[1]
    assert len(grid.divided_at(np.array([corner])).steps) == len(grid.steps)


def test_further_limits_slow_the_motion_down_where_they_bind() -> None:
    path = blended_path(POINTS, 0.05)

    def half_of_the_first_joint(points) -> LimitRows:
        first = points.q_s[:, :1] / 5.0, points.q_ss[:, :1] / 5.0
        return LimitRows(*first, np.zeros((len(points.q), 1)))

    grid, rate = best(path, fine=True, further=half_of_the_first_joint)
    assert np.abs(accelerations(grid, rate)[:, 0]).max() <= 5.0 * (1.0 + 1e-5)
    assert duration(grid, rate) > duration(*best(path))


def test_a_constant_load_leaves_less_on_one_side() -> None:
    def leaning(points) -> LimitRows:
        a = points.q_s[:, :1] / 10.0
        return LimitRows(a, 0.0 * a, np.full_like(a, 0.5))

    path = blended_path([np.zeros(3), [0.1, 0.0, 0.0]], 0.01)
    grid, rate = best(path, fine=True, further=leaning)
    first = accelerations(grid, rate)[: len(grid.steps), 0]
    assert first.max() == pytest.approx(5.0, rel=1e-3)
    assert first.min() == pytest.approx(-10.0, rel=0.1)


def test_rows_that_contradict_each_other_leave_no_motion() -> None:
    def contradictory(points) -> LimitRows:
        a = np.tile(points.q_s[:, :1] / 10.0, 2)
        c = np.zeros_like(a)
        c[30] = 1.5, -1.5
        return LimitRows(a, 0.0 * a, c)

    with pytest.raises(PlanningError, match="no speed along this path"):
        best(blended_path(POINTS, 0.05), fine=True, further=contradictory)


def test_a_cap_of_zero_leaves_no_motion() -> None:
    grid = PathGrid.on(spline_path(POINTS), fine=False)
    cap = np.zeros(len(grid.steps) + 1)
    with pytest.raises(PlanningError, match="no speed along this path"):
        optimal_speed(grid, cap, np.tile(ACCELERATION, (len(grid.steps), 1)))
