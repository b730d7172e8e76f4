"""Time a path so that the motion stays exactly on it, even after smoothing.

``retime.py`` bounds jerk by averaging the joint angles over time. That cuts corners by up to a
hundredth of a radian, which does not matter between two configurations but is too much for a tool
on a line. Here the *place along the path* is averaged instead. The joints stay on the path at any
speed, but the motion takes longer, because a bent path has jerk that no such average removes.

1. Each place has a largest speed: by the joint and tool speed limits, and in bends so that part of
   the acceleration and jerk limits is left for speeding up.
2. One pass forwards and one backwards keep the acceleration that is left at each speed (J. E.
   Bobrow, S. Dubowsky, J. S. Gibson, Time-Optimal Control of Robotic Manipulators, 1985).
3. The place over time is averaged over a window that turns steps of acceleration into ramps of the
   jerk limit (see ``native/retime.c``).
4. The result is measured. Where it exceeds a limit, the speed near there is lowered, and the motion
   made again. Any excess after a few rounds is removed by slowing all of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.limits import MotionLimits, ToolSpeed
from so101_motion.planning.timing.path_geometry import JointPath
from so101_motion.planning.timing.trajectory import Trajectory

POINTS = 128
"""Fewest points of a path at which the speed is computed. Chosen: twice as many make motions along
lines shorter by a thousandth."""

PER_PIECE = 4  # fewest of these points on a piece of the path

FOR_BENDS = 0.8, 0.6
"""Shares of the acceleration and of the jerk limits that a bend of the path may use at constant
speed. Chosen: of eight pairs the one with the shortest motions along 146 random lines, 12 % longer
at the median than motions that may leave the path."""

MARGIN = 0.998  # share of the limits that is used, so that samples at another phase keep them too
ROUNDS = 4  # how often the speed is lowered where a limit is exceeded
CORRECTIONS = 4  # how often the whole motion is slowed until its own samples keep the limits
_STEPS = 256  # number of times at which a motion is measured


def time_exactly(
    path: JointPath, limits: MotionLimits, dt: float, *, tool_speed_fn: ToolSpeed | None = None
) -> Trajectory:
    """A fast motion exactly along a path, from rest to rest, within the limits.

    Args:
        path: The path, with any parameter.
        limits: Caps for every joint, and for the tool if ``limits.tool_speed`` is set.
        tool_speed_fn: Speed of the tool; needed when ``limits.tool_speed`` is set.

    Returns:
        The motion; the caller has to verify that it keeps the limits.

    Raises:
        ValueError: A tool speed cap without ``tool_speed_fn``.
    """
    if limits.tool_speed is not None and tool_speed_fn is None:
        raise ValueError("a tool speed cap needs tool_speed_fn")
    tool = tool_speed_fn if limits.tool_speed is not None else None
    grid = _Grid.on(path)
    cap = grid.fastest(limits, tool)
    at_rest, at_cap = (grid.acceleration(limits, speed) for speed in (0.0 * cap, cap))
    width = float(np.max(2.0 * limits.acceleration / limits.jerk))
    motion = _Motion.along(grid.s, cap, at_rest, at_cap, width)
    for _ in range(ROUNDS):
        s, over = motion.excess(path, limits, tool)
        if over.max() <= 1.0:
            break
        worst = _worst_near(grid.s, s, over, motion.reach())
        cap, at_rest, at_cap = cap / worst, at_rest / worst**2, at_cap / worst**2
        motion = _Motion.along(grid.s, cap, at_rest, at_cap, width)
    stretch = 1.0
    trajectory = motion.sampled(path, dt, stretch)
    for _ in range(CORRECTIONS):
        slower = verify.limit_report(trajectory, limits).stretch
        slower = max(slower, float(_of_cap(tool, limits, trajectory.q, trajectory.qd).max()))
        if slower <= 1.0:
            break
        stretch *= slower * (1.0 + verify.TOLERANCE)
        trajectory = motion.sampled(path, dt, stretch)
    return trajectory


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Grid:
    """Places along a path, and how the joints move there."""

    s: Array  # the places, shape (m,), evenly spaced
    q: Array  # joint angles, shape (m, n), [rad]
    q_s: Array  # their first derivative by s, same shape
    q_ss: Array  # the second, the larger of those on either side where it jumps
    q_sss: Array  # the third, likewise

    @classmethod
    def on(cls, path: JointPath) -> _Grid:
        count = max(POINTS, PER_PIECE * (len(path.knots) - 1))
        s = np.linspace(0.0, path.length, count + 1)
        q, q_s, q_ss = path.evaluate(s)
        piece = np.clip(np.searchsorted(path.knots, s, "right") - 1, 0, len(path.knots) - 2)
        before = np.maximum(piece - 1, 0)
        third = 6.0 * np.abs(path.coefficients[:, 3])
        return cls(s=s, q=q, q_s=q_s, q_ss=q_ss, q_sss=np.maximum(third[piece], third[before]))

    def fastest(self, limits: MotionLimits, tool: ToolSpeed | None) -> Array:
        """The largest speed along the path at each place, shape (m,)."""
        of_acceleration, of_jerk = FOR_BENDS
        with np.errstate(divide="ignore"):
            caps = [
                MARGIN * np.min(limits.velocity / np.abs(self.q_s), axis=1),
                np.sqrt(of_acceleration * np.min(limits.acceleration / np.abs(self.q_ss), axis=1)),
                np.cbrt(of_jerk * np.min(limits.jerk / self.q_sss, axis=1)),
            ]
            caps.append(MARGIN / _of_cap(tool, limits, self.q, self.q_s))
        return np.asarray(np.minimum(np.min(caps, axis=0), self.s[-1] / _SHORTEST_TIME))

    def acceleration(self, limits: MotionLimits, speed: Array) -> Array:
        """The acceleration along the path that is left at these speeds, shape (m,)."""
        left = limits.acceleration - np.abs(self.q_ss) * speed[:, None] ** 2
        with np.errstate(divide="ignore"):
            largest = MARGIN * np.min(left / np.abs(self.q_s), axis=1)
        return np.asarray(np.minimum(largest, self.s[-1] / _SHORTEST_TIME**2))


_SHORTEST_TIME = 1e-3  # no motion is shorter than this [s]; it bounds speeds that no joint bounds


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Motion:
    """The place along a path as a function of time, before and after averaging.

    Between ``t[k]`` and ``t[k + 1]`` the acceleration is constant; the motion rests before and
    after.
    """

    t: Array  # times, shape (m,), [s]; from 0
    s: Array  # places, shape (m,)
    v: Array  # speeds, shape (m,); zero first and last
    integral: Array  # the integral of the place over time, shape (m,)
    width: float  # of the average [s]

    @classmethod
    def along(cls, s: Array, cap: Array, at_rest: Array, at_cap: Array, width: float) -> _Motion:
        """Nearly the fastest motion through places ``s`` under caps on speed and acceleration.

        The largest acceleration falls from ``at_rest`` to ``at_cap``, that at the largest speed,
        with the squared speed along a concave curve, so the straight line between is safe.
        ``width`` [s] is the average's.
        """
        steps = np.diff(s)
        fall = ((at_cap - at_rest) / cap**2).tolist()
        rest, twice, square = at_rest.tolist(), (2.0 * steps).tolist(), (cap**2).tolist()
        square[0] = square[-1] = 0.0
        for k, h in enumerate(twice):
            square[k + 1] = min(square[k + 1], _next(square[k], h, rest, fall, k, k + 1))
        for k in range(len(twice) - 1, -1, -1):
            square[k] = min(square[k], _next(square[k + 1], twice[k], rest, fall, k + 1, k))
        v = np.sqrt(square)
        lasting = 2.0 * steps / (v[:-1] + v[1:])
        change = np.diff(v) / lasting
        area = lasting * (s[:-1] + lasting * (v[:-1] / 2.0 + lasting * change / 6.0))
        t = np.concatenate(([0.0], np.cumsum(lasting)))
        return cls(t=t, s=s, v=v, integral=np.concatenate(([0.0], np.cumsum(area))), width=width)

    def reach(self) -> float:
        """Largest distance along the path at which a change of speed has an effect."""
        return float(self.v.max()) * self.width

    def excess(
        self, path: JointPath, limits: MotionLimits, tool: ToolSpeed | None
    ) -> tuple[Array, Array]:
        """Places, and the factor by which the motion is too fast there."""
        t = np.linspace(-0.5 * self.width, self.t[-1] + 0.5 * self.width, _STEPS)
        s, v, a, j = self.averaged(t)
        q, q_s, q_ss = path.evaluate(s)
        piece = np.clip(np.searchsorted(path.knots, s, "right") - 1, 0, len(path.knots) - 2)
        q_sss = 6.0 * path.coefficients[piece, 3]
        v, a, j = v[:, None], a[:, None], j[:, None]
        speed = np.abs(q_s * v) / limits.velocity
        acceleration = np.abs(q_s * a + q_ss * v**2) / limits.acceleration
        jerk = np.abs(q_s * j + 3.0 * q_ss * v * a + q_sss * v**3) / limits.jerk
        over = np.maximum(np.maximum(speed, np.sqrt(acceleration)), np.cbrt(jerk))
        return s, np.maximum(over.max(axis=1), _of_cap(tool, limits, q, q_s * v))

    def averaged(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Place, speed, acceleration and jerk along the path, averaged, at times ``t`` (m,)."""
        late, early = self._at(t + 0.5 * self.width), self._at(t - 0.5 * self.width)
        place, speed, acceleration, jerk = (
            (b - a) / self.width for a, b in zip(early, late, strict=True)
        )
        return place, speed, acceleration, jerk

    def sampled(self, path: JointPath, dt: float, stretch: float) -> Trajectory:
        """The averaged motion along the path, ``stretch`` times slower, every ``dt`` [s]."""
        begin, end = -0.5 * self.width, float(self.t[-1]) + 0.5 * self.width
        duration = stretch * (end - begin)
        count = math.ceil(duration / dt - 1e-9) + 1
        t = np.minimum(begin + np.arange(count) * (dt / stretch), end)
        s, v, a, _ = self.averaged(t)
        s[0], s[-1] = self.s[0], self.s[-1]
        v[[0, -1]] = a[[0, -1]] = 0.0
        q, q_s, q_ss = path.evaluate(s)
        v, a = v[:, None] / stretch, a[:, None] / stretch**2
        return Trajectory(dt=dt, q=q, qd=q_s * v, qdd=q_s * a + q_ss * v**2, duration=duration)

    def _at(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Integral of the place, place, speed and acceleration before averaging."""
        k = np.clip(np.searchsorted(self.t, t, "right") - 1, 0, len(self.t) - 2)
        lasting = self.t[k + 1] - self.t[k]
        u = np.clip(t - self.t[k], 0.0, lasting)
        inside = (t >= 0.0) & (t < self.t[-1])
        change = (self.v[k + 1] - self.v[k]) / lasting
        v = self.v[k] + u * change
        s = self.s[k] + u * (self.v[k] + 0.5 * u * change)
        integral = self.integral[k] + u * (self.s[k] + u * (self.v[k] / 2.0 + u * change / 6.0))
        integral += self.s[-1] * np.maximum(t - self.t[-1], 0.0)
        return integral, s, np.where(inside, v, 0.0), np.where(inside, change, 0.0)


def _next(x: float, h: float, rest: list[float], fall: list[float], here: int, there: int) -> float:
    """The largest squared speed at the next place, with the acceleration allowed at both.

    Acceleration at a place is ``rest`` less ``fall`` times the squared speed; ``h`` is twice the
    distance.
    """
    by_here = x + h * max(rest[here] + fall[here] * x, 0.0)
    by_there = (x + h * rest[there]) / (1.0 - h * fall[there])
    return by_here if by_here < by_there else by_there


def _of_cap(tool: ToolSpeed | None, limits: MotionLimits, q: Array, qd: Array) -> Array:
    """The share of the tool's speed cap that is used, shape (m,); 0 where there is none."""
    if tool is None or limits.tool_speed is None:
        return np.zeros(len(q))
    return tool(q, qd) / limits.tool_speed


def _worst_near(places: Array, s: Array, over: Array, reach: float) -> Array:
    """For each place the largest excess within ``reach`` of it, at least 1."""
    step = float(places[1] - places[0])
    worst = np.ones(len(places))
    np.maximum.at(worst, np.clip(np.round(s / step).astype(int), 0, len(places) - 1), over)
    around = math.ceil(reach / step)
    padded = np.pad(worst, around, constant_values=1.0)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1).max(axis=1))
