"""Time a path so that the motion stays exactly on it, even after smoothing.

``retime.py`` bounds jerk by averaging the joint angles over time. That cuts corners by up to a
hundredth of a radian, which does not matter between two configurations but is too much for a tool
on a line. Here the *place along the path* is timed by it, as if it were the only joint. The joints
stay on the path at any speed, but the motion takes longer, because a bent path has jerk that no
such average removes.

1. Each place has a largest speed: by the joint and tool speed limits, and in bends so that part of
   the acceleration and jerk limits is left for speeding up.
2. ``retime`` keeps that and the joints' acceleration limits, and averages the place over a time in
   which no joint's acceleration changes faster than its jerk limit.
3. The result is measured. Where it exceeds a limit, the speed near there is lowered, and the motion
   made again. Any excess that is left is removed by slowing all of it.
"""

from __future__ import annotations

import math

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.limits import MotionLimits, ToolSpeed
from so101_motion.planning.timing.path_geometry import JointPath, PathPoints
from so101_motion.planning.timing.retime import retime
from so101_motion.planning.timing.trajectory import Trajectory

PLACES = 300  # places along a path where speeds are lowered

FOR_BENDS = 0.8, 0.6
"""Shares of the acceleration and of the jerk limits that a bend of the path may use at constant
speed. Chosen: of eight pairs the one with the shortest motions along 146 random lines."""

MARGIN = 0.998  # share of the limits that is used, so that samples at another phase keep them too
ROUNDS = 7  # most motions made; all but the second are the one before, slowed as a whole
PHASE = 1.005
"""By how much more than is missing speeds are lowered: samples at another phase show other peaks.
Chosen: of 133 random lines 125 then need two motions, and they are as short as after four."""


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
    course = _Course(path, limits, tool_speed_fn if limits.tool_speed is not None else None)
    slower = np.ones(PLACES + 1)
    for tries in range(ROUNDS):
        s, trajectory = course.timed(slower, dt)
        of_cap = float(course.of_cap(trajectory.q, trajectory.qd).max())
        most = max(verify.limit_report(trajectory, limits).stretch, of_cap)
        if most <= 1.0:
            break
        slower = slower * PHASE * (most if tries else course.worst_near(s, trajectory))
    return trajectory


class _Course:
    """The way along a path, as the only joint of a path."""

    def __init__(self, path: JointPath, limits: MotionLimits, tool: ToolSpeed | None) -> None:
        self._path, self._limits, self._tool = path, limits, tool
        self._places = np.linspace(0.0, path.length, PLACES + 1)
        straight = np.array([[[0.0], [1.0], [0.0], [0.0]]])
        self._line = JointPath(knots=self._places[[0, -1]], coefficients=straight)
        self._rows = self._limit_rows()
        least = float(np.abs(self._rows[0]).max(axis=1).min())
        self._hardest = 1.0 / max(least, _SHORTEST_TIME**2 / path.length)
        self._width = float(np.max(2.0 * limits.acceleration / limits.jerk))

    def timed(self, slower: Array, dt: float) -> tuple[Array, Trajectory]:
        """The motion that is ``slower`` by factors at the places, and where its samples are."""
        least = float(slower.min())
        limits = MotionLimits.uniform(
            n=1,
            velocity=self._path.length / _SHORTEST_TIME,
            acceleration=self._hardest / least**2,
            jerk=2.0 * self._hardest / least**3 / self._width,
        )

        lowered = self._rows * slower[:, None] ** 2

        def rows(at: PathPoints) -> Array:
            return lowered[:, np.round(at.q[:, 0] / self._places[1]).astype(int)]  # at the places

        along = retime(self._line, limits, dt, further=rows, deviation=self._path.length)
        s, v, a = along.q[:, 0], along.qd, along.qdd
        q, q_s, q_ss = self._path.evaluate(s)
        return s, Trajectory(
            dt=dt, q=q, qd=q_s * v, qdd=q_s * a + q_ss * v**2, duration=along.duration
        )

    def _limit_rows(self) -> Array:
        """The limits of the joints and of the tool on the motion along the path, at its places."""
        path, limits, (of_acceleration, of_jerk) = self._path, self._limits, FOR_BENDS
        q, q_s, q_ss = path.evaluate(self._places)
        piece = np.searchsorted(path.knots, self._places, "right") - 1
        piece = np.minimum(piece, len(path.knots) - 2)
        third = 6.0 * np.abs(path.coefficients[:, 3])
        q_sss = np.maximum(third[piece], third[np.maximum(piece - 1, 0)])
        slowness = [  # the least, by each limit
            np.max(np.abs(q_s) / limits.velocity, axis=1) / MARGIN,
            np.sqrt(np.max(np.abs(q_ss) / limits.acceleration, axis=1) / of_acceleration),
            np.cbrt(np.max(q_sss / limits.jerk, axis=1) / of_jerk),
            self.of_cap(q, q_s) / MARGIN,
        ]
        square = np.max(slowness, axis=0)[:, None] ** 2
        a = np.hstack([q_s / (MARGIN * limits.acceleration), np.zeros_like(square)])
        b = np.hstack([q_ss / limits.acceleration, square])
        return np.stack((a, b, np.zeros_like(a)))

    def _excess(self, motion: Trajectory) -> Array:
        """The factor by which each sample of a motion is too fast, shape (m,)."""
        limits = self._limits
        jerk = np.abs(np.diff(motion.qdd, axis=0)) / (motion.dt * limits.jerk)
        over = np.maximum(
            np.max(np.abs(motion.qd) / limits.velocity, axis=1),
            np.sqrt(np.max(np.abs(motion.qdd) / limits.acceleration, axis=1)),
        )
        over[1:] = np.maximum(over[1:], np.cbrt(np.max(jerk, axis=1)))
        return np.asarray(np.maximum(over, self.of_cap(motion.q, motion.qd)))

    def worst_near(self, s: Array, motion: Trajectory) -> Array:
        """For each place the largest excess of the samples near it, which are at ``s``; at least 1.

        Near is what is passed within the time over which the place is averaged.
        """
        step = float(self._places[1])
        worst = np.ones(len(self._places))
        np.maximum.at(worst, np.round(s / step).astype(int), self._excess(motion))
        fastest = float(np.diff(s).max(initial=0.0)) / motion.dt
        around = math.ceil(fastest * self._width / step)
        padded = np.pad(worst, around, constant_values=1.0)
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1)
        return np.asarray(windows.max(axis=1))

    def of_cap(self, q: Array, qd: Array) -> Array:
        """The share of the tool's speed cap that is used, shape (m,); 0 where there is none."""
        if self._tool is None or self._limits.tool_speed is None:
            return np.zeros(len(q))
        return self._tool(q, qd) / self._limits.tool_speed


_SHORTEST_TIME = 1e-3  # no motion is shorter than this [s]; it bounds speeds that no joint bounds
