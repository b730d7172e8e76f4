"""Compute motions within a control tick: straight to a goal, to a new goal while moving, to a stop.

``pursuit.py`` follows goals that move.

Each takes tens of microseconds to a millisecond. The caller checks collisions and position limits,
and catches ``PlanningError`` where ruckig finds no motion; ``ValueError`` says that shapes do not
fit or values are not finite. Positions, velocities and accelerations are of shape (n,).

ruckig (L. Berscheid and T. Kroeger, Jerk-limited Real-time Trajectory Generation with Arbitrary
Target States, 2021) is imported here and in ``pursuit.py``. Its community edition ignores position
limits, silently accepts lists of the wrong length, and sends intermediate waypoints to a server:
lengths are checked here, and waypoints are never set.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import ruckig
from numpy.typing import ArrayLike

from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import Array
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.time_scaling import shortest_slowdown
from so101_motion.planning.timing.trajectory import Setpoint, Trajectory

SAME_POSITION = 1e-9  # nearer goals need no motion [rad]; chosen
LESS_JERK = 1.0 - 1e-9  # for a second search; chosen far above rounding


def point_to_point(
    q_start: ArrayLike, q_goal: ArrayLike, limits: MotionLimits, dt: float
) -> Trajectory:
    """The fastest motion along the straight line in joint space [rad], from rest to rest.

    One number, the place along the line, is timed under the strictest joint's limits; without
    ``limits.tool_speed``, which ``retime`` keeps. A single sample if start and goal are the same.
    """
    q_start, q_goal = map(np.array, numbers(limits, dt, q_start=q_start, q_goal=q_goal))
    path = q_goal - q_start
    length = float(np.abs(path).max())
    if length < SAME_POSITION:
        rest = np.zeros((1, len(q_goal)))
        return Trajectory(dt=dt, q=q_goal[None], qd=rest, qdd=rest, duration=0.0)
    direction = path / length
    caps = [
        1.0 / float(np.max(np.abs(direction) / cap))
        for cap in (limits.velocity, limits.acceleration, limits.jerk)
    ]
    request = ruckig.InputParameter(1)
    request.target_position = [length]
    request.max_velocity, request.max_acceleration, request.max_jerk = ([cap] for cap in caps)
    s, s_t, s_tt, duration = _calculated(request, dt)
    _land(s, np.array([length]))
    q = q_start + s * direction
    q[-1] = q_goal
    return Trajectory(dt=dt, q=q, qd=s_t * direction, qdd=s_tt * direction, duration=duration)


def from_state(
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    q_goal: ArrayLike,
    limits: MotionLimits,
    dt: float,
) -> Trajectory:
    """The fastest motion from any state to rest at a goal; all joints arrive together.

    The state is ``q`` [rad], ``qd`` [rad/s] and ``qdd`` [rad/s^2], each of shape (n,). A state
    beyond the limits is first brought back inside as fast as they allow. The motion may swing past
    the goal, or go on in its present direction before it turns.
    """
    *state, goal = numbers(limits, dt, q=q, qd=qd, qdd=qdd, q_goal=q_goal)
    request = _request(state, limits)
    request.target_position = goal
    positions, velocities, accelerations, duration = _calculated(request, dt)
    _land(positions, np.array(goal))
    return Trajectory(dt=dt, q=positions, qd=velocities, qdd=accelerations, duration=duration)


def between(
    now: Setpoint, then: Setpoint, limits: MotionLimits, dt: float
) -> tuple[int, Callable[[], Trajectory]]:
    """The fastest motion between two states that takes a whole number of periods.

    Returns that number, and a function that makes the motion, whose last sample is ``then``.
    """
    request = _request(numbers(limits, dt, q=now.q, qd=now.qd, qdd=now.qdd), limits)
    request.target_position, request.target_velocity, request.target_acceleration = numbers(
        limits, dt, q=then.q, qd=then.qd, qdd=then.qdd
    )
    count = math.ceil(found_motion(request).duration / dt - 1e-9)
    request.minimum_duration = count * dt
    found = found_motion(request)
    if found.duration > (count + 1e-6) * dt:
        raise PlanningError("no motion between these states takes a whole number of periods")

    def made() -> Trajectory:
        states = np.array([found.at_time(k * dt) for k in range(count + 1)])
        states[-1] = then.q, then.qd, then.qdd  # where ruckig's sums are off by rounding
        q, qd, qdd = states.swapaxes(0, 1)
        return Trajectory(dt=dt, q=q, qd=qd, qdd=qdd, duration=count * dt)

    return count, made


def stop(
    q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, limits: MotionLimits, dt: float
) -> Trajectory:
    """The shortest stop: each joint comes to rest as fast as acceleration and jerk caps allow.

    It leaves the path as far as the joints' braking times differ. No joint gets faster, unless it
    is accelerating now and the jerk cap forbids less.
    """
    request = _request(numbers(limits, dt, q=q, qd=qd, qdd=qdd), limits)
    request.control_interface = ruckig.ControlInterface.Velocity
    request.synchronization = ruckig.Synchronization.No
    positions, velocities, accelerations, duration = _calculated(request, dt)
    return Trajectory(dt=dt, q=positions, qd=velocities, qdd=accelerations, duration=duration)


def stop_on_path(trajectory: Trajectory, t: float, limits: MotionLimits, dt: float) -> Trajectory:
    """The shortest stop from time ``t`` [s] on that stays on a verified motion.

    The motion's own time is slowed down until it stands (``time_scaling.py``), so every position of
    the stop is one of the motion's, and no joint gets faster than in it; jerk stays within 1.02 of
    its cap. If no such slowdown keeps the limits, each joint stops by itself (``stop``); with
    limits above the motion's own by a fifth for acceleration and a half for jerk that was not seen
    in thousands of stops.
    """
    numbers(limits, dt, q=trajectory.q[0])
    if not math.isfinite(t):
        raise ValueError(f"t must be finite, got {t}")
    stopped = shortest_slowdown(trajectory, max(0.0, t), limits, dt)
    if stopped is not None:
        return stopped[0]
    now = trajectory.sample(t)
    return stop(now.q, now.qd, now.qdd, limits, dt)


def numbers(limits: MotionLimits, dt: float, **given: ArrayLike) -> list[list[float]]:
    """The given values as plain numbers, one for each joint of the limits.

    This runs in every control cycle: for so few numbers numpy takes several times as long.
    """
    if not 0.0 < dt < math.inf:
        raise ValueError(f"dt must be positive and finite, got {dt}")
    found = list[list[float]]()
    for name, value in given.items():
        vector = np.asarray(value, dtype=np.float64)
        numbers = vector.tolist()
        if vector.shape != limits.velocity.shape or not all(map(math.isfinite, numbers)):
            raise ValueError(f"{name} must be {len(limits.velocity)} finite numbers, got {value!r}")
        found.append(numbers)
    return found


def _request(state: list[list[float]], limits: MotionLimits) -> ruckig.InputParameter:
    """A request from a position, a velocity and an acceleration."""
    request = ruckig.InputParameter(len(state[0]))
    request.current_position, request.current_velocity, request.current_acceleration = state
    request.max_velocity = limits.velocity.tolist()
    request.max_acceleration = limits.acceleration.tolist()
    request.max_jerk = limits.jerk.tolist()
    return request


def found_motion(request: ruckig.InputParameter) -> ruckig.Trajectory:
    """Let ruckig compute a motion; if it fails, again with slightly less jerk.

    It fails where a joint has its largest acceleration only for an instant and rounding hides that:
    with the arm's own caps, in many moves by exactly 2 degrees.
    """
    n = request.degrees_of_freedom
    try:
        return searched(request, ruckig.Ruckig(n), ruckig.Trajectory(n))
    except PlanningError:
        request.max_jerk = [LESS_JERK * jerk for jerk in request.max_jerk]
        return searched(request, ruckig.Ruckig(n), ruckig.Trajectory(n))


def searched(
    request: ruckig.InputParameter, by: ruckig.Ruckig, found: ruckig.Trajectory
) -> ruckig.Trajectory:
    """Let ruckig write the motion to ``found``, which is returned."""
    try:
        result = by.calculate(request, found)
    except (ruckig.RuckigError, ValueError) as error:  # some of its results it cannot name itself
        raise PlanningError(f"no motion from this state under these limits: {error}") from error
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise PlanningError(f"no motion from this state under these limits: ruckig says {result}")
    return found


def _calculated(request: ruckig.InputParameter, dt: float) -> tuple[Array, Array, Array, float]:
    """Position, velocity and acceleration every ``dt``, each (N, n), and the duration [s]."""
    found = found_motion(request)
    duration = float(found.duration)
    count = math.ceil(duration / dt - 1e-9) + 1
    states = np.array([found.at_time(k * dt) for k in range(count)])
    states[-1, 1:] = 0.0  # at or past the end, where ruckig's sums are off by rounding
    return states[:, 0], states[:, 1], states[:, 2], duration


def _land(q: Array, q_goal: Array) -> None:
    """Move positions (N, n) in place so that the last one is exactly the goal.

    ruckig ends within 1e-8 rad of it. A jump of that size in the last sample would be a spike of
    30 rad/s^3 at 1 kHz, so the error is spread over the motion.
    """
    x = np.linspace(0.0, 1.0, len(q))[:, None]
    q += (q_goal - q[-1]) * (x * x * (3.0 - 2.0 * x))
    q[-1] = q_goal
