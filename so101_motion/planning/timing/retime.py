"""Time a path as fast as the limits allow, with bounded jerk, and measure the result.

How it works, in four steps:

1. *Optimal speed along the path* (TOPP-RA), as fast as the velocity and acceleration limits allow,
   without a bound of jerk.
2. *Motion in time.* Acceleration along the path is constant on each interval, which gives time,
   velocity and acceleration exactly.
3. *Bounded jerk* by a moving average over time.
4. *Measure and scale.* The result is sampled at 1 kHz; if it exceeds a limit or the tool speed cap,
   its time is stretched by exactly that. The returned motion has been checked.

The compiled library does it; ``native/retime.c`` tells how and why.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import Array
from so101_motion.native.library import native
from so101_motion.planning.checkpoint import Checkpoint, never_abandoned
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.limits import MotionLimits, ToolSpeed
from so101_motion.planning.timing.path_geometry import JointPath, PathPoints
from so101_motion.planning.timing.trajectory import Trajectory

FurtherLimits = Callable[[PathPoints], Array]
"""Limits at N points of a path besides those of velocity and acceleration, ``|a u + b x + c| <= 1``
with the acceleration u [rad/s^2] and the squared speed x [rad^2/s^2] along it: a, b and c, shape
(3, N, m); c, what is used at rest, is less than 1 in magnitude."""

DEVIATION = 0.02  # how far smoothing may move a joint off the path by default [rad]. Chosen

_SAMPLES, _TOOL_SPEEDS, _ROWS, _CHECKPOINT = range(4)
_NO_SPEED, _NO_MEMORY = 2, 3
"""What the library asks for, and two ways in which it ends, as in retime.c."""

_int, _numbers = ctypes.c_int, ctypes.POINTER(ctypes.c_double)
_Supply = ctypes.CFUNCTYPE(
    ctypes.c_void_p, _int, _int, _numbers, _numbers, _numbers, ctypes.POINTER(_int)
)


def retime(
    path: JointPath,
    limits: MotionLimits,
    dt: float,
    *,
    tool_speed_fn: ToolSpeed | None = None,
    further: FurtherLimits | None = None,
    deviation: float = DEVIATION,
    in_time: bool = False,
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
        in_time: Whether the path is a motion already, from rest to rest: its parameter is time [s].
            Only its jerk is bounded then, and what exceeds another limit is slowed down.

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
    timing = NativeTiming(path, limits, tool_speed_fn, further, checkpoint)
    duration = ctypes.c_double()
    numbers = (in_time, ctypes.c_double(dt), ctypes.c_double(deviation), ctypes.byref(duration))
    exceeds = timing.run(native().library.so101_retime, *numbers)
    q, qd, qdd = timing.samples
    trajectory = Trajectory(dt=dt, q=q, qd=qd, qdd=qdd, duration=duration.value)
    if exceeds:
        verify.check(trajectory, limits)
    return trajectory


def averaging(limits: MotionLimits, deviation: float = DEVIATION) -> tuple[float, float]:
    """The largest width of the average [s], and the share of the accelerations that fits to it."""
    caps, share = _caps(limits), ctypes.c_double()
    numbers = (len(limits.velocity), ctypes.c_double(deviation), ctypes.byref(share))
    return native().library.so101_averaging(caps.ctypes.data_as(_numbers), *numbers), share.value


def _caps(limits: MotionLimits) -> Array:
    return np.concatenate((limits.velocity, limits.acceleration, limits.jerk))


class NativeTiming:
    """Lets the library time one path, and answers what it asks for meanwhile.

    Attributes:
        samples: The samples that it asked for last, shape (3, N, n): positions [rad], velocities
            [rad/s] and accelerations [rad/s^2].
    """

    samples: Array

    def __init__(
        self,
        path: JointPath,
        limits: MotionLimits,
        tool_speed_fn: ToolSpeed | None,
        further: FurtherLimits | None,
        checkpoint: Checkpoint = never_abandoned,
    ) -> None:
        self._path, self._limits, self._checkpoint = path, limits, checkpoint
        self._tool, self._further = tool_speed_fn, further
        self._error: BaseException | None = None

    def run(self, function: Any, *arguments: Any) -> bool:
        """Call a function of retime.c; whether its result may still exceed a limit.

        Raises:
            PlanningError: No speed satisfies the limits along the path.
        """
        path, limits, answer = self._path, self._limits, _Supply(self._answer)
        given = path.knots, path.coefficients, _caps(limits)
        arrays = [np.ascontiguousarray(each) for each in given]
        tool = ctypes.c_double(limits.tool_speed or 0.0)
        ended = function(
            len(path.knots) - 1,
            path.n,
            *(ctypes.c_void_p(array.ctypes.data) for array in arrays),
            tool,
            self._further is not None,
            answer,
            *arguments,
        )
        if self._error is not None:
            raise self._error
        if ended == _NO_SPEED:
            raise PlanningError(
                "no speed along this path satisfies the limits; check for a corner that is too"
                " sharp"
            )
        if ended == _NO_MEMORY:
            raise MemoryError("no memory for the samples of a motion")
        return bool(ended)

    def _answer(self, what: int, count: int, q: Any, q_s: Any, q_ss: Any, rows: Any) -> int | None:
        try:
            if what == _CHECKPOINT:
                self._checkpoint()
                return 1
            if what == _SAMPLES:
                self.samples = np.empty((3, count, self._path.n))
                return self.samples.ctypes.data
            shape = count, self._path.n
            points = [np.ctypeslib.as_array(each, shape) for each in (q, q_s, q_ss) if each]
            self._kept = self._values(points, rows)  # until the library has copied them
            return self._kept.ctypes.data
        except BaseException as error:  # raised after the library returns
            self._error = error
            return None

    def _values(self, points: list[Array], rows: Any) -> Array:
        """The tool's speeds at points of the path, or with ``rows`` the further limits there."""
        if rows:
            assert self._further is not None
            found = self._further(PathPoints(*points))
            rows[0] = found.shape[2]
        else:
            assert self._tool is not None
            found = self._tool(*points[:2])
        return np.ascontiguousarray(found, dtype=np.float64)
