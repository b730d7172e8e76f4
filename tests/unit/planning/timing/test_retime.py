import ctypes
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.bench_retime import LIMITS as BENCH
from benchmarks.bench_retime import random_waypoints
from so101_motion.common.errors import PlanningError
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.native.library import native
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.exact_retiming import time_exactly
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point
from so101_motion.planning.timing.path_geometry import JointPath, blended_path, spline_path
from so101_motion.planning.timing.retime import LimitRows, NativeTiming, retime
from so101_motion.planning.timing.verify import check, limit_report

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
POINTS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [0.4, -0.3, 0.2, 0.5, 0.0],
        [0.9, -0.2, -0.4, 0.2, 0.8],
        [0.2, 0.3, -0.6, -0.5, 0.3],
        [-0.5, 0.1, 0.3, 0.0, -0.4],
    ]
)


def measured(trajectory, limits: MotionLimits = LIMITS) -> np.ndarray:
    """Largest share of the velocity, acceleration and jerk limits, from differences at 1 kHz."""
    rest = np.repeat(trajectory.q[:1], 3, 0), np.repeat(trajectory.q[-1:], 3, 0)
    q = np.concatenate((rest[0], trajectory.q, rest[1]))
    caps = limits.velocity, limits.acceleration, limits.jerk
    return np.array(
        [
            (np.abs(np.diff(q, order, axis=0)) / trajectory.dt**order / cap).max()
            for order, cap in enumerate(caps, start=1)
        ]
    )


@pytest.mark.parametrize("path", [spline_path(POINTS), blended_path(POINTS, 0.03)])
@pytest.mark.parametrize("jerk", [60.0, 500.0])
def test_limits_are_kept_and_used_at_1_khz(path: JointPath, jerk: float) -> None:
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=jerk)
    velocity, acceleration, jerk_share = measured(retime(path, limits, 1e-3), limits)
    assert velocity <= 1.0
    assert acceleration <= 1.001
    assert jerk_share <= 1.001
    assert max(velocity, acceleration, jerk_share) > 0.95


def test_samples_belong_to_one_motion_whatever_their_spacing() -> None:
    path = spline_path(POINTS)
    coarse, fine = retime(path, LIMITS, 0.01), retime(path, LIMITS, 0.001)
    assert coarse.duration == pytest.approx(fine.duration, rel=1e-6)
    inner = slice(0, len(coarse) - 1)
    for name, tolerance in (("q", 1e-6), ("qd", 1e-4), ("qdd", 1e-2)):
        every_tenth = getattr(fine, name)[::10][inner]
        assert np.allclose(getattr(coarse, name)[inner], every_tenth, atol=tolerance)


@pytest.mark.parametrize("cap", [0.05, 0.3, 1.5])
def test_the_tool_never_exceeds_its_speed_cap(cap: float) -> None:
    # A planar arm of two links: joints 0 and 1, 0.2 m each.
    def tool_speed(q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        first, second = q[:, 0], q[:, 0] + q[:, 1]
        turn = qd[:, 0] + qd[:, 1]
        x = -0.2 * np.sin(first) * qd[:, 0] - 0.2 * np.sin(second) * turn
        y = 0.2 * np.cos(first) * qd[:, 0] + 0.2 * np.cos(second) * turn
        return np.hypot(x, y)

    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=cap)
    trajectory = retime(spline_path(POINTS), limits, 1e-3, tool_speed_fn=tool_speed)
    speeds = tool_speed(trajectory.q, trajectory.qd)
    assert speeds.max() <= cap
    if cap < 1.0:
        assert speeds.max() > 0.98 * cap
    assert measured(trajectory, limits).max() <= 1.001


@pytest.mark.parametrize("scale", [1e-7, 1e-5, 1e-3])
def test_a_tiny_path_is_timed_like_any_other(scale: float) -> None:
    trajectory = retime(blended_path(scale * POINTS, 0.01 * scale), LIMITS, 0.01)
    assert np.allclose(trajectory.q[-1], scale * POINTS[-1], atol=1e-15)
    assert trajectory.duration < 0.5
    assert verify.limit_report(trajectory, LIMITS).worst <= 1.001


def test_turning_back_on_the_spot_does_not_stall() -> None:
    path = blended_path([np.zeros(5), POINTS[1], np.zeros(5)], 1e-4)
    assert retime(path, LIMITS, 0.01).duration < 1.2


def test_where_no_speed_is_allowed_there_is_no_motion() -> None:
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=0.1)
    with pytest.raises(PlanningError, match="no speed along this path"):
        retime(
            spline_path(POINTS),
            limits,
            0.01,
            tool_speed_fn=lambda q, qd: np.full(len(q), np.inf),
        )


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"dt": 0.0}, "dt = 0.0"),
        ({"dt": float("nan")}, "positive and finite"),
        ({"deviation": -1.0}, "deviation = -1.0"),
        ({"limits": MotionLimits.uniform(velocity=1, acceleration=1, jerk=1, n=4)}, "4 joints"),
        (
            {"limits": MotionLimits.uniform(velocity=1, acceleration=1, jerk=1, tool_speed=0.1)},
            "needs tool_speed_fn",
        ),
    ],
)
def test_mistakes_are_named(change: dict[str, object], complaint: str) -> None:
    arguments = {"path": spline_path(POINTS), "limits": LIMITS, "dt": 0.01, **change}
    with pytest.raises(ValueError, match=complaint):
        retime(**arguments)


@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_velocity_and_acceleration_are_the_derivatives_of_the_positions(scale: float) -> None:
    h = 1e-5
    motion = retime(spline_path(scale * POINTS), LIMITS, h)
    q, qd, qdd = (each[1:-2] for each in (motion.q, motion.qd, motion.qdd))
    assert np.allclose((q[2:] - q[:-2]) / (2.0 * h), qd[1:-1], atol=1e-5)
    assert np.allclose((qd[2:] - qd[:-2]) / (2.0 * h), qdd[1:-1], atol=2e-2)


def test_half_the_width_is_taken_at_the_ends_where_it_keeps_the_limits() -> None:
    # One joint: full acceleration, top speed if there is room, full braking.
    def lengthened_by(way: float, bang_bang: float, top: float) -> float:
        limits = MotionLimits.uniform(velocity=top, acceleration=10.0, jerk=502.0, n=1)
        motion = retime(blended_path([[0.0], [way]], 0.01), limits, 0.01)
        return (motion.duration - bang_bang) / 0.04

    assert 0.5 <= lengthened_by(2.0, 2.1, top=1.0) < 0.6  # a little slower near the ends
    # Too short for a change of width.
    assert lengthened_by(0.1, 0.2, top=4.0) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("tiny", [2.6e-308, 1e-173, 1e-20])
def test_next_to_nothing_may_be_anywhere_along_a_path(tiny):
    path = spline_path(np.array([[tiny, 0.0], [0.0, 1.0], [0.0, 0.0]]))
    limits = MotionLimits.uniform(velocity=1.0, acceleration=1.0, jerk=20.0, n=2)
    assert verify.limit_report(retime(path, limits, 0.01), limits).worst <= 1.0 + verify.TOLERANCE


# Without smoothing


LAZY = MotionLimits.uniform(velocity=0.7, acceleration=1.0, jerk=15.0)


@pytest.fixture(scope="module")
def tool():
    return ArmChain(RobotModel.load())


def winding(seed, count=6, reach=0.5):
    return spline_path(reach * np.random.default_rng(seed).standard_normal((count, 5)))


def distance_from(path, q):
    s = np.linspace(0.0, path.length, 20001)
    points = path.evaluate(s).q
    return max(np.linalg.norm(points - each, axis=1).min() for each in q)


@pytest.mark.parametrize("limits", [LIMITS, LAZY], ids=["swift", "lazy"])
@pytest.mark.parametrize("seed", range(6))
def test_the_motion_keeps_every_limit_and_the_path(limits, seed):
    path = winding(seed)
    motion = time_exactly(path, limits, 0.01)
    check(motion, limits)
    assert limit_report(motion, limits).worst > 0.9  # and uses them somewhere
    assert motion.q[0] == pytest.approx(path.evaluate([0.0]).q[0], abs=1e-12)
    assert motion.q[-1] == pytest.approx(path.evaluate([path.length]).q[0], abs=1e-12)
    assert not np.any(motion.qd[[0, -1]])
    assert distance_from(path, motion.q[::7]) < 1e-3  # as fine as the points compared with


@pytest.mark.parametrize("dt", [0.001, 0.004, 0.02])
def test_stated_velocities_are_those_of_the_positions(dt):
    motion = time_exactly(winding(1), LIMITS, dt)
    middle = (motion.q[2:] - motion.q[:-2]) / (2.0 * dt)
    assert np.abs(middle - motion.qd[1:-1]).max() < 500.0 * dt**2
    middle = (motion.qd[2:] - motion.qd[:-2]) / (2.0 * dt)
    assert np.abs(middle - motion.qdd[1:-1]).max() < 500.0 * dt + 1e-6


def test_a_straight_path_is_nearly_as_fast_as_can_be():
    ends = np.array([[0.0] * 5, [0.8, -0.3, 0.5, 0.1, 0.0]])
    motion = time_exactly(spline_path(ends), LIMITS, 0.01)
    shortest = point_to_point(*ends, LIMITS, 0.01)
    assert motion.duration < 1.05 * shortest.duration


def test_a_longer_time_is_never_needed_for_looser_limits():
    path = winding(3)
    durations = [
        time_exactly(
            path, MotionLimits.uniform(velocity=v, acceleration=4.0 * v, jerk=100.0 * v), 0.01
        ).duration
        for v in (0.5, 1.0, 2.0)
    ]
    assert durations == sorted(durations, reverse=True)


def test_the_tool_keeps_its_cap_and_moves_at_it(tool):
    path = winding(2, reach=0.3)
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=0.05)
    motion = time_exactly(path, limits, 0.01, tool_speed_fn=tool.speeds)
    speed = tool.speeds(motion.q, motion.qd)
    assert speed.max() <= 0.05 * 1.001
    assert np.median(speed) > 0.05 * 0.97


def test_a_cap_on_the_tool_needs_to_know_its_speed():
    limits = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, tool_speed=0.05)
    with pytest.raises(ValueError, match="needs tool_speed_fn"):
        time_exactly(winding(0), limits, 0.01)


@pytest.mark.parametrize("length", [1e-5, 1e-3, 0.02])
def test_short_motions_keep_their_limits_too(length):
    path = spline_path(np.array([[0.0] * 5, [length, 0.0, 0.0, -length, 0.0]]))
    motion = time_exactly(path, LIMITS, 0.01)
    check(motion, LIMITS)
    assert motion.q[-1] == pytest.approx([length, 0.0, 0.0, -length, 0.0], abs=1e-12)


def test_jumps_of_curvature_are_passed_within_the_jerk_limit_of_the_samples():
    corners = np.array([[0.0] * 5, [0.5, 0.2, 0.0, 0.0, 0.0], [0.6, 0.8, -0.3, 0.0, 0.1]])
    motion = time_exactly(blended_path(corners, 0.1), LIMITS, 0.01)
    check(motion, LIMITS)


# The speed profile of native/retime.c, before jerk is bounded


CORNERS = np.array([[0.0, 0.0, 0.0], [0.8, -0.3, 0.2], [0.9, 0.5, -0.4], [0.2, 0.3, -0.6]])
THREE = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0, n=3)


class Best:
    """The best speeds along a path: at the cuts ``speed``, and the intervals between them."""

    def __init__(self, path: JointPath, limits: MotionLimits = THREE, **more) -> None:
        timing = NativeTiming(path, limits, more.get("tool"), more.get("further"))
        rows, count = np.empty((20_000, 4)), ctypes.c_int(20_000)
        place = ctypes.c_void_p(rows.ctypes.data)
        timing.run(native().library.so101_best_speeds, place, ctypes.byref(count))
        piece, begin, end, speed = rows[: count.value].T
        self.steps, self.speed = end - begin, np.append(speed, 0.0)
        self.begin, self.end = (path.on_pieces(piece.astype(int), at) for at in (begin, end))

    @property
    def duration(self) -> float:
        return float(np.sum(2.0 * self.steps / (self.speed[1:] + self.speed[:-1])))

    def accelerations(self) -> np.ndarray:
        """Joint accelerations at both ends of each interval."""
        square = self.speed[:, None] ** 2
        u = np.diff(square, axis=0) / (2.0 * self.steps[:, None])
        at_begin = self.begin.q_s * u + self.begin.q_ss * square[:-1]
        return np.concatenate([at_begin, self.end.q_s * u + self.end.q_ss * square[1:]])


def test_a_straight_path_has_the_three_phases_of_a_trapezoid() -> None:
    best = Best(blended_path([np.zeros(3), [2.0, 1.0, 0.0]], 0.01))
    scale = np.sqrt(5.0) / 2.0  # path length for each radian of the first joint
    top = 3.0 * scale * (1.0 - 1e-4)
    assert best.speed == pytest.approx([0.0, top, top, 0.0])
    assert best.steps[[0, 2]] == pytest.approx(2 * [top**2 / (2.0 * 10.0 * scale)])
    assert best.duration == pytest.approx(2.0 / 3.0 + 3.0 / 10.0, rel=1e-3)


def test_a_short_straight_path_turns_from_speeding_up_to_braking_in_its_middle() -> None:
    best = Best(blended_path([np.zeros(3), [0.1, 0.0, 0.0]], 0.01))
    assert best.steps == pytest.approx([0.05, 0.05])
    assert best.speed == pytest.approx([0.0, 1.0, 0.0])


@pytest.mark.parametrize("path", [blended_path(CORNERS, 0.05), spline_path(CORNERS)])
def test_limits_are_kept_at_both_ends_of_every_interval_and_used(path: JointPath) -> None:
    best = Best(path)
    shares = np.abs(best.accelerations()) / THREE.acceleration
    assert shares.max() <= 1.0 + 1e-9
    speeds = np.abs(best.begin.q_s * best.speed[:-1, None]) / THREE.velocity
    assert speeds.max() <= 1.0
    assert np.median(np.maximum(shares.max(axis=1), speeds[1:].max())) > 0.9
    assert best.speed[0] == best.speed[-1] == 0.0


def largest_square(rows: np.ndarray, step: float, cap: float, following: float) -> float:
    """The library's answer for rows a, b, c, shape (3, m)."""
    solve = native().library.so101_largest_square
    solve.restype = ctypes.c_double
    a, b, c = (ctypes.c_void_p(row.ctypes.data) for row in rows)
    return solve(a, b, c, rows.shape[1], *map(ctypes.c_double, (step, cap, following)))


@pytest.mark.parametrize(
    ("rows", "step", "cap", "following", "expected"),
    [
        ([(0.5, 0.0, 0.0)], 0.1, 9.0, 1.0, 1.4),  # braking as hard as it may
        ([(0.5, 0.0, 0.0)], 0.1, 1.2, 1.0, 1.2),  # the speed limit, where braking allows more
        ([(0.0, 0.25, 0.0)], 1.0, 9.0, 9.0, 4.0),  # a row without acceleration bounds the speed
        ([(1.0, 0.0, -0.5)], 0.5, 9.0, 1.0, 1.5),  # a constant load leaves less for braking
        ([(1.0, 0.0, 1.5), (1.0, 0.0, -1.5)], 0.5, 9.0, 1.0, 0.0),  # contradictory
    ],
)
def test_the_largest_square_is_what_the_tightest_row_leaves(rows, step, cap, following, expected):
    found = largest_square(np.array(rows).T.copy(), step, cap, following)
    assert found == pytest.approx(expected)


def test_the_result_is_the_largest_that_rows_allow() -> None:
    """Against a fine search over u, where every row is tried."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        a, b = rng.normal(size=(2, 1, 6))
        c = rng.uniform(-0.9, 0.9, (1, 6))
        x = largest_square(np.concatenate((a, b, c)), 0.3, 50.0, 0.7)
        assert is_allowed(x * (1.0 - 1e-9), a, b, c)
        assert x == 50.0 or not is_allowed(x * (1.0 + 1e-3), a, b, c)


def is_allowed(x: float, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> bool:
    ends = np.sort(np.stack(((1.0 - c - b * x) / a, (-1.0 - c - b * x) / a)), axis=0)
    lower, upper = max(ends[0].max(), -x / 0.6), min(ends[1].min(), (0.7 - x) / 0.6)
    return lower <= upper


def of_toppra(rows: np.ndarray, steps: np.ndarray, caps: np.ndarray):
    """Toppra's solver of the same programs: of the N intervals with rows (3, N, m)."""
    constraint = pytest.importorskip("toppra.constraint", reason="no wheel for this system")
    from toppra.solverwrapper import seidelWrapper

    m = rows.shape[2]
    all_rows = np.concatenate((rows, rows[:, -1:]), axis=1)
    sides = np.vstack((np.eye(m), -np.eye(m)))
    given = (*all_rows, sides, np.ones(2 * m), None, np.column_stack((0.0 * caps, caps)))
    base = constraint.LinearConstraint()
    base.identical, base.compute_constraint_params = True, lambda *_: given
    cuts = np.append(0.0, np.cumsum(steps))
    path = SimpleNamespace(path_interval=(cuts[0], cuts[-1]))
    solve = seidelWrapper([base], path, cuts).solve_stagewise_optim
    up, free = np.array([1e-9, -1.0]), float("nan")
    return lambda i, following: max(solve(i, None, up, free, free, 0.0, following)[1], 0.0)


def test_it_agrees_with_toppra_on_all_benchmark_paths() -> None:
    for waypoints in random_waypoints():
        best = Best(spline_path(waypoints), BENCH)
        # Lengths in units of some intervals, accelerations in units of the limit.
        unit = 16.0 * float(best.steps.mean())
        steps, bend = best.steps / unit, best.end.q_ss * unit
        at_end = best.end.q_s + 2.0 * steps[:, None] * bend
        a = np.hstack((best.begin.q_s, at_end))
        rows = np.stack((a, np.hstack((best.begin.q_ss * unit, bend)), 0.0 * a))
        squares = 9.0 / (np.abs(np.vstack((best.begin.q_s, best.end.q_s[-1]))) ** 2).max(axis=1)
        caps = (1.0 - 1e-4) ** 2 * squares / (10.0 * unit)
        theirs, found = of_toppra(rows, steps, caps), [0.0]
        for i in range(len(steps) - 1, -1, -1):
            of_interval = np.ascontiguousarray(rows[:, i])
            x = largest_square(of_interval, float(steps[i]), float(caps[i]), found[-1])
            assert x == pytest.approx(theirs(i, found[-1]), rel=1e-9, abs=0.0)
            found.append(x)
        reached = best.speed**2 / (10.0 * unit)
        assert np.all(reached[1:] <= np.array(found[-2::-1]) * (1.0 + 1e-9))


@pytest.mark.parametrize("tolerance", [0.002, 0.02, 0.1])
def test_a_coarse_grid_with_exact_straights_is_as_quick_as_a_fine_one(tolerance: float) -> None:
    # Each piece split into many is the same path, with as many more cuts.
    path, parts = blended_path(CORNERS, tolerance), 25
    piece = np.repeat(np.arange(len(path.knots) - 1), parts)
    ends = np.interp(np.arange(len(piece) + 1) / parts, np.arange(len(path.knots)), path.knots)
    at = path.on_pieces(piece, ends[:-1] - path.knots[piece])
    split = np.stack((at.q, at.q_s, 0.5 * at.q_ss, path.coefficients[piece, 3]), axis=1)
    bound = Best(JointPath(knots=ends, coefficients=split)).duration
    assert bound * (1.0 - 1e-4) <= Best(path).duration <= 1.002 * bound


def test_further_limits_slow_the_motion_down_where_they_bind() -> None:
    path = blended_path(CORNERS, 0.05)

    def half_of_the_first_joint(points) -> LimitRows:
        first = points.q_s[:, :1] / 5.0, points.q_ss[:, :1] / 5.0
        return LimitRows(*first, np.zeros((len(points.q), 1)))

    best = Best(path, further=half_of_the_first_joint)
    assert np.abs(best.accelerations()[:, 0]).max() <= 5.0 * (1.0 + 1e-5)
    assert best.duration > Best(path).duration


def test_a_constant_load_leaves_less_on_one_side() -> None:
    def leaning(points) -> LimitRows:
        a = points.q_s[:, :1] / 10.0
        return LimitRows(a, 0.0 * a, np.full_like(a, 0.5))

    best = Best(blended_path([np.zeros(3), [0.1, 0.0, 0.0]], 0.01), further=leaning)
    first = best.accelerations()[: len(best.steps), 0]
    assert first.max() == pytest.approx(5.0, rel=1e-3)
    assert first.min() == pytest.approx(-10.0, rel=0.1)


def test_rows_that_contradict_each_other_leave_no_motion() -> None:
    def contradictory(points) -> LimitRows:
        a = np.tile(points.q_s[:, :1] / 10.0, 2)
        c = np.zeros_like(a)
        c[30] = 1.5, -1.5
        return LimitRows(a, 0.0 * a, c)

    with pytest.raises(PlanningError, match="no speed along this path"):
        Best(blended_path(CORNERS, 0.05), further=contradictory)


def test_an_error_of_a_limit_is_raised_after_the_library_has_ended() -> None:
    def broken(points) -> LimitRows:
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        Best(blended_path(CORNERS, 0.05), further=broken)
