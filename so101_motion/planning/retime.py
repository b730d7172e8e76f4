"""Timing a path: as fast as the joints may go, with bounded jerk, measured before it is used.

How it works, in four steps:

1. *Optimal speed along the path* (toppra's method: Pham and Pham, A New Approach to Time-Optimal
   Path Parameterization Based on Reachability Analysis, 2018). With ``x`` the squared speed along
   the path and ``u`` its acceleration, joint velocity limits cap x, joint acceleration limits are
   linear in u and x. One pass from the end finds the largest x from which the arm can still stop,
   one pass from the start then accelerates as hard as it may below that. The grid meets every knot
   of the path, and both ends of each interval are held to the limits; a coarser or unaligned grid
   exceeds them in between or stalls.
2. *Motion in time.* Between grid points u is constant, which gives time, velocity and acceleration
   exactly.
3. *Bounded jerk* by a moving average (:mod:`~so101_motion.planning.smoothing`).
4. *Measure and scale.* The result is sampled at 1 kHz; if it exceeds anything, the tool speed cap
   included, its time is stretched by exactly that. What is returned has been checked.

toppra is imported on first use, not with this module, and only here. Its package imports
matplotlib for a plotting method (seconds, and more memory than the planner); empty stand-ins take
its place during that one import.
"""

from __future__ import annotations

import functools
import math
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from so101_motion.errors import PlanningError
from so101_motion.geometry import Array
from so101_motion.planning import verify
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.path_geometry import JointPath, PathPoints
from so101_motion.planning.smoothing import (
    CHECK_STEP,
    RAMP_WIDTHS,
    Curve,
    check_positions,
    curve_through,
    fitting_window,
    sampled,
)
from so101_motion.planning.trajectory import Trajectory

ToolSpeed = Callable[[Array, Array], Array]
"""From joint angles (m, n) and their rates (m, n) to the speed of the tool point, (m,)."""

GRID_POINTS = 800
"""How many grid points a path gets, shared out evenly among its pieces. Chosen: benchmarks/."""
GRID_PER_PIECE = (16, 300)
"""Fewest and most grid intervals on one piece. Fewer than 16 cost more than 1 % in time."""
EASED = 0.97
"""Share of the acceleration limits used near the ends, where the width of the average changes and
adds acceleration of its own. Chosen together with ``RAMP_WIDTHS``."""
EASED_PART = 0.1
"""Longest part of a path that may be eased. Where more were needed, steps of acceleration follow
each other too closely for a narrow window anyway. Chosen: benchmarks/."""
WIDTH_MARGIN = 1.004
"""How much wider the average is than its formula asks. Chosen: covers that differences at 1 kHz
see up to 0.3 % more jerk at one phase of the sampling than at another."""
NARROWEST = 0.012
"""Narrowest average [s], however high the jerk limit. Chosen: the 1 kHz samples on which limits
are measured resolve what is left, also at the ends where it is half as wide."""
CORRECTIONS = 3
"""How often a motion is slowed down because its own samples see a little more of a very short peak
than those at 1 kHz did. Chosen: of 5700 random paths one in fifty needed one, none two."""
SPEED_MARGIN = 1.0 - 1e-4
"""Share of the velocity limits used on the grid; covers what happens between its points."""


def retime(
    path: JointPath,
    limits: MotionLimits,
    dt: float,
    *,
    tool_speed_fn: ToolSpeed | None = None,
    deviation: float = 0.02,
) -> Trajectory:
    """The fastest motion along a path, from rest to rest, within the limits.

    Args:
        path: Where to go.
        limits: Caps for every joint, and for the tool if ``limits.tool_speed`` is set.
        dt: Time between the samples of the result [s].
        tool_speed_fn: How fast the tool moves; needed when ``limits.tool_speed`` is set.
        deviation: How far each joint may leave the path by the smoothing [rad]; accelerations are
            lowered where a low jerk limit would need more.

    Returns:
        The motion. It starts and ends exactly at the ends of the path.

    Raises:
        PlanningError: No speed satisfies the limits along this path.
        ValueError: Limits for another number of joints, a time step or deviation that is not
            positive, or a tool speed cap without ``tool_speed_fn``.
    """
    if len(limits.velocity) != path.n:
        raise ValueError(f"limits for {len(limits.velocity)} joints, a path for {path.n}")
    if not (0.0 < dt < math.inf and 0.0 < deviation < math.inf):
        raise ValueError(f"dt = {dt} and deviation = {deviation} must be positive and finite")
    if limits.tool_speed is not None and tool_speed_fn is None:
        raise ValueError("a tool speed cap needs tool_speed_fn")
    width, share = _width_of_average(limits, deviation)
    grid = _Grid.on(path)
    acceleration = _eased(grid, limits.acceleration * share, width)
    speed = _optimal_speed(grid, limits, acceleration, tool_speed_fn)
    curve = _in_time(grid, speed, rest=2.0 * width)
    window = fitting_window(curve, width, limits)
    stretch = _stretch(check_positions(curve, window), limits, tool_speed_fn)
    trajectory = sampled(curve, window, stretch, dt)
    for _ in range(CORRECTIONS):
        report = verify.violations(trajectory, limits)
        if report.velocity.max() <= 1.0 and report.worst <= 1.0 + verify.TOLERANCE:
            break
        stretch *= report.stretch * (1.0 + 0.5 * verify.TOLERANCE)
        trajectory = sampled(curve, window, stretch, dt)
    verify.check(trajectory, limits)
    return trajectory


def _width_of_average(limits: MotionLimits, deviation: float) -> tuple[float, float]:
    """Width of the moving average [s] and the share of the acceleration limits to use.

    A joint may turn from full acceleration to full braking at once, so ``w = 2 a / j``; its
    distance from the path is then at most ``a w^2 / 24``, which must stay within ``deviation``.
    Lowering a lowers w with it, so the distance goes with the cube of the share.
    """
    width = max(NARROWEST, WIDTH_MARGIN * float(np.max(2.0 * limits.acceleration / limits.jerk)))
    furthest = float(np.max(limits.acceleration)) * width**2 / 24.0
    share = min(1.0, float(np.cbrt(deviation / furthest)))
    return width * share, share


def _stretch(q: Array, limits: MotionLimits, tool_speed_fn: ToolSpeed | None) -> float:
    """How much slower positions ``CHECK_STEP`` apart, (m, n), must be to keep every limit; >= 1."""
    stretch = max(1.0, verify.measure(q, CHECK_STEP, limits).stretch)
    if limits.tool_speed is None or tool_speed_fn is None:
        return stretch
    middle, rate = 0.5 * (q[1:] + q[:-1]), np.diff(q, axis=0) / CHECK_STEP
    # Each value may cost a Jacobian: every fourth first, then all around those near the highest.
    coarse = tool_speed_fn(middle[::4], rate[::4])
    near = np.repeat(coarse > 0.98 * coarse.max(), 4)
    near = np.convolve(near, np.ones(9), "same")[: len(rate)] > 0.5
    fastest = float(np.max(tool_speed_fn(middle[near], rate[near])))
    return max(stretch, fastest / (SPEED_MARGIN * limits.tool_speed))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Grid:
    """Points along a path, evenly spaced on each of its pieces.

    Attributes:
        steps: Distance to the next point, shape (N,), [rad].
        begin: The path at the beginning of each interval, arrays of shape (N, n).
        end: The same at its end. Curvature may jump between the end of one interval and the
            beginning of the next.
    """

    steps: Array
    begin: PathPoints
    end: PathPoints

    @classmethod
    def on(cls, path: JointPath) -> _Grid:
        pieces = len(path.knots) - 1
        count = int(np.clip(GRID_POINTS // pieces, *GRID_PER_PIECE))
        steps = np.diff(path.knots) / count
        offsets = steps[:, None] * np.arange(count + 1)
        points = path.on_pieces(np.arange(pieces)[:, None], offsets)
        begin = PathPoints(*(values[:, :-1].reshape(-1, path.n) for values in points))
        end = PathPoints(*(values[:, 1:].reshape(-1, path.n) for values in points))
        return cls(steps=np.repeat(steps, count), begin=begin, end=end)

    @property
    def nodes(self) -> tuple[Array, Array]:
        """Joint angles and their derivative by s at all points, each (N + 1, n)."""
        return (
            np.concatenate((self.begin.q, self.end.q[-1:])),
            np.concatenate((self.begin.q_s, self.end.q_s[-1:])),
        )


def _eased(grid: _Grid, acceleration: Array, width: float) -> Array:
    """Acceleration limits on each interval, shape (N, n): a little lower near the two ends.

    Near means as far as the joints can get before the average has its full width.
    """
    time = (RAMP_WIDTHS + 0.5) * width
    near = 0.5 * float(acceleration.max()) * time**2 * math.sqrt(len(acceleration))
    middles = np.cumsum(grid.steps) - 0.5 * grid.steps
    length = middles[0] + middles[-1]
    if near > EASED_PART * length:
        return np.tile(acceleration, (len(middles), 1))
    is_near = np.minimum(middles, length - middles) < near
    return np.where(is_near[:, None], EASED, 1.0) * acceleration


def _optimal_speed(
    grid: _Grid, limits: MotionLimits, acceleration: Array, tool_speed_fn: ToolSpeed | None
) -> Array:
    """The largest speed along the path at each grid point, shape (N + 1,), zero at both ends.

    Lengths and times are scaled so that the programs toppra solves have numbers near one, because
    its tolerances are absolute.
    """
    length = GRID_PER_PIECE[0] * float(grid.steps.mean())
    time = math.sqrt(length / float(acceleration.max()))
    q, q_s = grid.nodes
    with np.errstate(divide="ignore", over="ignore"):  # a joint that hardly moves sets no bound
        fastest = 1.0 / np.max(np.abs(q_s) / limits.velocity, axis=1)
        if limits.tool_speed is not None and tool_speed_fn is not None:
            fastest = np.minimum(fastest, limits.tool_speed / tool_speed_fn(q, q_s))
        cap = np.minimum((SPEED_MARGIN * fastest * time / length) ** 2, _LARGEST)
    weight = length / time**2 / acceleration
    steps = grid.steps / length
    # An interval of constant u ends with x + 2 u step: its end is one more row for each joint.
    bend = grid.end.q_ss * (weight * length)
    a = np.hstack((grid.begin.q_s * weight, grid.end.q_s * weight + 2.0 * steps[:, None] * bend))
    b = np.hstack((grid.begin.q_ss * (weight * length), bend))
    x = _largest_squares(steps, a, b, cap)
    return np.sqrt(x) * (length / time)


_LARGEST = 1e6
"""Largest squared speed in scaled units; toppra wants a bound even where there is none."""


def _largest_squares(steps: Array, a: Array, b: Array, cap: Array) -> Array:
    """Maximise x at each grid point subject to ``|a u + b x| <= 1`` and ``0 <= x <= cap``.

    Args:
        steps: Length of each interval, shape (N,).
        a: Rows for u, shape (N, m).
        b: Rows for x, shape (N, m).
        cap: Shape (N + 1,).

    The two passes are toppra's, written out because both ends are at rest: x = 0 with u = 0 is
    allowed everywhere, so no lower bound has to be found, and a third of the work goes.
    """
    solver = _solver(steps, a, b, cap)
    count = len(steps)
    free, upward = math.nan, np.array([1e-9, -1.0])
    largest = [0.0] * (count + 1)
    for i in range(count - 1, -1, -1):
        largest[i] = solver(i, None, upward, free, free, 0.0, largest[i + 1])[1]
    x, forward = np.zeros(count + 1), np.array([0.0, -1.0])
    here = 0.0
    for i, step in enumerate(steps.tolist()):
        forward[0] = -2.0 * step
        u = solver(i, None, forward, here, here, 0.0, largest[i + 1])[0]
        # Exactly on the bound the next program would be infeasible by rounding.
        here = max(0.0, min(here + 2.0 * step * u, largest[i + 1] * (1.0 - 1e-7) - 1e-10))
        x[i + 1] = here
    if not np.all(x[1:-1] > 0.0):
        raise PlanningError(
            "no speed along this path satisfies the limits; check for a corner that is too sharp"
        )
    return x


def _solver(steps: Array, a: Array, b: Array, cap: Array) -> Callable[..., Any]:
    """Toppra's solver for the linear program of one interval."""
    base, wrapper = _toppra()
    rows = a.shape[1]
    both = np.vstack((np.eye(rows), -np.eye(rows)))
    last = (np.vstack((values, values[-1:])) for values in (a, b))
    bounds = np.column_stack((np.zeros_like(cap), cap))
    constraint = base()
    constraint.identical = True
    parameters = (*last, np.zeros((len(cap), rows)), both, np.ones(2 * rows), None, bounds)
    constraint.compute_constraint_params = lambda *_: parameters
    grid = np.concatenate(([0.0], np.cumsum(steps)))
    interval = _PathInterval(path_interval=(grid[0], grid[-1]))
    solve: Callable[..., Any] = wrapper([constraint], interval, grid).solve_stagewise_optim
    return solve


@dataclass(frozen=True, slots=True)
class _PathInterval:
    """All that toppra's solver wants to know of a path when the constraint has the rest."""

    path_interval: tuple[float, float]


@functools.cache
def _toppra() -> tuple[Any, Any]:
    """Toppra's constraint base class and its solver, imported without matplotlib."""
    with _stand_ins("matplotlib", "matplotlib.pyplot"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its docstrings hold invalid escapes
        from toppra.constraint import LinearConstraint
        from toppra.solverwrapper import seidelWrapper
    return LinearConstraint, seidelWrapper


@contextmanager
def _stand_ins(*names: str) -> Iterator[None]:
    """Empty modules in place of those of ``names`` that are not loaded yet."""
    missing = {name: ModuleType(name) for name in names if name not in sys.modules}
    sys.modules.update(missing)
    try:
        yield
    finally:
        for name in missing:
            del sys.modules[name]


def _in_time(grid: _Grid, speed: Array, rest: float) -> Curve:
    """The motion along the grid with these speeds at its points; u is constant in between."""
    u = (speed[1:] ** 2 - speed[:-1] ** 2) / (2.0 * grid.steps)
    begin, end = grid.begin, grid.end
    q, q_s = grid.nodes
    square, along = speed[:, None] ** 2, u[:, None]
    return curve_through(
        2.0 * grid.steps / (speed[:-1] + speed[1:]),
        q,
        q_s * speed[:, None],
        begin.q_s * along + begin.q_ss * square[:-1],
        end.q_s * along + end.q_ss * square[1:],
        rest,
    )
