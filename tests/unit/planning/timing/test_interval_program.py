import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from so101_motion.planning.timing.interval_program import LimitRows, exact_solver

ROOT = Path(__file__).parents[4]
BENCHMARK = """
import sys
import numpy as np
if sys.argv[1] == "without":
    sys.modules["toppra"] = None
from benchmarks.bench_retime import DT, LIMITS, random_waypoints
from so101_motion.planning.timing.path_geometry import spline_path
from so101_motion.planning.timing.speed_profile import PathGrid, optimal_speed
found = []
for waypoints in random_waypoints():
    grid = PathGrid.on(spline_path(waypoints), fine=False)
    cap = 1.0 / np.max(np.abs(grid.nodes[1]) / LIMITS.velocity, axis=1)
    acceleration = np.tile(LIMITS.acceleration, (len(grid.steps), 1))
    found.append(optimal_speed(grid, cap, acceleration)[1])
assert (sys.modules.get("toppra") is None) == (sys.argv[1] == "without")
np.savez(sys.argv[2], *found)
"""


@pytest.mark.skipif(find_spec("toppra") is None, reason="toppra has wheels for x86-64 Linux alone")
def test_it_agrees_with_toppra_on_all_benchmark_paths(tmp_path: Path) -> None:
    found = []
    for which in ("with", "without"):
        file = tmp_path / f"{which}.npz"
        subprocess.run([sys.executable, "-c", BENCHMARK, which, str(file)], cwd=ROOT, check=True)
        with np.load(file) as speeds:
            found.append([speeds[name] for name in speeds.files])
    assert len(found[0]) == len(found[1]) == 100
    for theirs, ours in zip(*found, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-9, abs=0.0)


def one(rows: list[tuple[float, float, float]], *, step: float, cap: float, following: float):
    a, b, c = np.array(rows).T[:, None, :]
    solve = exact_solver(np.array([step]), LimitRows(a, b, c), np.array([cap, following]))
    return solve(0, following)


def test_nothing_but_the_next_interval_brakes_as_hard_as_it_may() -> None:
    assert one([(0.5, 0.0, 0.0)], step=0.1, cap=9.0, following=1.0) == pytest.approx(1.4)


def test_the_speed_limit_holds_where_braking_allows_more() -> None:
    assert one([(0.5, 0.0, 0.0)], step=0.1, cap=1.2, following=1.0) == 1.2


def test_a_row_without_acceleration_bounds_the_speed() -> None:
    assert one([(0.0, 0.25, 0.0)], step=1.0, cap=9.0, following=9.0) == pytest.approx(4.0)


def test_a_constant_load_leaves_less_for_braking() -> None:
    assert one([(1.0, 0.0, -0.5)], step=0.5, cap=9.0, following=1.0) == pytest.approx(1.5)


def test_rows_that_contradict_each_other_leave_nothing() -> None:
    assert one([(1.0, 0.0, 1.5), (1.0, 0.0, -1.5)], step=0.5, cap=9.0, following=1.0) == 0.0


def test_the_result_is_the_largest_that_rows_allow() -> None:
    """Against a fine search over u, where every row is tried."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        a, b = rng.normal(size=(2, 1, 6))
        c = rng.uniform(-0.9, 0.9, (1, 6))
        x = exact_solver(np.array([0.3]), LimitRows(a, b, c), np.array([50.0, 0.7]))(0, 0.7)
        assert is_allowed(x * (1.0 - 1e-9), a, b, c)
        assert x == 50.0 or not is_allowed(x * (1.0 + 1e-3), a, b, c)


def is_allowed(x: float, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> bool:
    ends = np.sort(np.stack(((1.0 - c - b * x) / a, (-1.0 - c - b * x) / a)), axis=0)
    lower, upper = max(ends[0].max(), -x / 0.6), min(ends[1].min(), (0.7 - x) / 0.6)
    return lower <= upper
