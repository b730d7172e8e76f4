"""Time a path as fast as the limits allow, with bounded jerk, and measure the result.

How it works, in four steps:

1. *Optimal speed along the path* (:mod:`~so101_motion.planning.timing.speed_profile`), as fast as
   the velocity and acceleration limits allow, without a bound of jerk.
2. *Motion in time.* Acceleration along the path is constant on each interval, which gives time,
   velocity and acceleration exactly.
3. *Bounded jerk* by a moving average (:mod:`~so101_motion.planning.timing.jerk_filter`).
4. *Measure and scale.* The result is sampled at 1 kHz; if it exceeds a limit or the tool speed cap,
   its time is stretched by exactly that. The returned motion has been checked.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.checkpoint import Checkpoint, never_abandoned
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.jerk_filter import (
    CHECK_STEP,
    RAMP_WIDTHS,
    Curve,
    check_positions,
    curve_through,
    fitting_window,
    sampled,
)
from so101_motion.planning.timing.limits import MotionLimits, ToolSpeed
from so101_motion.planning.timing.path_geometry import JointPath
from so101_motion.planning.timing.speed_profile import (
    SPEED_MARGIN,
    FurtherLimits,
    PathGrid,
    optimal_speed,
)
from so101_motion.planning.timing.trajectory import Trajectory

EASED = 0.97
"""Share of the acceleration limits used near the ends, where the changing width of the average adds
acceleration. Chosen together with ``RAMP_WIDTHS``."""
EASED_PART = 0.1
"""Longest part of a path that may be eased. If more were needed, steps of acceleration would follow
each other too closely for a narrow window anyway. Chosen: benchmarks/."""
WIDTH_MARGIN = 1.004
"""Factor by which the average is wider than its formula. Chosen: differences at 1 kHz show up to
0.3 % more jerk at one phase of the sampling than at another."""
NARROWEST = 0.012
"""Narrowest average [s], at any jerk limit. Chosen: the 1 kHz samples on which limits are measured
resolve it, also at the ends where it is half as wide."""
CORRECTIONS = 3
"""How often a motion is slowed down because its own samples show a little more of a very short peak
than those at 1 kHz. Chosen: of 5700 random paths one in fifty needed one, none two."""


def retime(
    path: JointPath,
    limits: MotionLimits,
    dt: float,
    *,
    tool_speed_fn: ToolSpeed | None = None,
    further: FurtherLimits | None = None,
    deviation: float = 0.02,
    checkpoint: Checkpoint = never_abandoned,
) -> Trajectory:
    """The fastest motion along a path, from rest to rest, within the limits.

    Args:
        path: The path.
        limits: Caps for every joint, and for the tool if ``limits.tool_speed`` is set.
        tool_speed_fn: Speed of the tool; needed when ``limits.tool_speed`` is set.
        further: More limits on the motion along the path, such as torques. They limit the speed
            profile; unlike the others they are not measured on the result.
        deviation: How far smoothing may move each joint off the path [rad]; accelerations are
            lowered if a low jerk limit would need more.

    Returns:
        The motion. It starts and ends exactly at the ends of the path.

    Raises:
        PlanningError: No speed satisfies the limits along this path.
        ValueError: Limits for another number of joints, a time step or deviation that is not
            positive, or a tool speed cap without ``tool_speed_fn``.
    """
    if len(limits.velocity) != path.n:
        raise ValueError(f"the limits are for {len(limits.velocity)} joints, the path for {path.n}")
    if not (0.0 < dt < math.inf and 0.0 < deviation < math.inf):
        raise ValueError(f"dt = {dt} and deviation = {deviation} must be positive and finite")
    if limits.tool_speed is not None and tool_speed_fn is None:
        raise ValueError("a tool speed cap needs tool_speed_fn")
    width, share = _width_of_average(limits, deviation)
    eased = replace(limits, acceleration=share * limits.acceleration)
    along = _speed_along(path, eased, tool_speed_fn, further, width, checkpoint)
    checkpoint()
    curve = _in_time(*along, rest=2.0 * width)
    checkpoint()
    window = fitting_window(curve, width, limits)
    checkpoint()
    stretch = _stretch(check_positions(curve, window), limits, tool_speed_fn)
    trajectory = sampled(curve, window, stretch, dt)
    for _ in range(CORRECTIONS):
        checkpoint()
        report = verify.limit_report(trajectory, limits)
        if report.velocity.max() <= 1.0 and report.worst <= 1.0 + verify.TOLERANCE:
            return trajectory
        stretch *= report.stretch * (1.0 + 0.5 * verify.TOLERANCE)
        trajectory = sampled(curve, window, stretch, dt)
    verify.check(trajectory, limits)
    return trajectory


def _speed_along(
    path: JointPath,
    limits: MotionLimits,
    tool_speed_fn: ToolSpeed | None,
    further: FurtherLimits | None,
    width: float,
    checkpoint: Checkpoint,
) -> tuple[PathGrid, Array]:
    """The path cut into intervals, and the best speed at each cut [rad/s]."""
    near = _eased_length(path.length, limits.acceleration, width)
    grid = PathGrid.on(path, fine=limits.tool_speed is not None or further is not None)
    grid = grid.divided_at(np.array([near, path.length - near]))
    middles = np.cumsum(grid.steps) - 0.5 * grid.steps
    is_near = np.minimum(middles, path.length - middles) < near
    acceleration = np.where(is_near[:, None], EASED, 1.0) * limits.acceleration
    cap = _cap_on_speed(grid, limits, tool_speed_fn)
    checkpoint()
    return optimal_speed(grid, cap, acceleration, further, checkpoint)


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
    # Each value may cost a Jacobian: every fourth first, then all near the highest ones.
    coarse = tool_speed_fn(middle[::4], rate[::4])
    near = np.repeat(coarse > 0.98 * coarse.max(), 4)
    near = np.convolve(near, np.ones(9), "same")[: len(rate)] > 0.5
    fastest = float(np.max(tool_speed_fn(middle[near], rate[near])))
    return max(stretch, fastest / (SPEED_MARGIN * limits.tool_speed))


def _eased_length(length: float, acceleration: Array, width: float) -> float:
    """Length at both ends where acceleration is a little lower [rad]; 0 for none.

    It is the distance the joints can travel before the average has its full width.

    Args:
        length: Of the path [rad].
        acceleration: Joint acceleration limits, shape (n,), [rad/s^2].
        width: Of the moving average [s].
    """
    time = (RAMP_WIDTHS + 0.5) * width
    near = 0.5 * float(acceleration.max()) * time**2 * math.sqrt(len(acceleration))
    return near if near <= EASED_PART * length else 0.0


def _cap_on_speed(grid: PathGrid, limits: MotionLimits, tool_speed_fn: ToolSpeed | None) -> Array:
    """Largest speed along the path at each cut, shape (N + 1,), [rad/s]."""
    q, q_s = grid.nodes
    with np.errstate(divide="ignore", over="ignore"):  # a joint that hardly moves sets no bound
        fastest = 1.0 / np.max(np.abs(q_s) / limits.velocity, axis=1)
        if limits.tool_speed is not None and tool_speed_fn is not None:
            fastest = np.minimum(fastest, limits.tool_speed / tool_speed_fn(q, q_s))
    return np.asarray(fastest)


def _in_time(grid: PathGrid, speed: Array, rest: float) -> Curve:
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
