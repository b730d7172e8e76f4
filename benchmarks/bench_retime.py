"""Timing of paths: computing time, closeness to the optimum, limits; and stopping.

100 random joint paths of 10 to 50 waypoints, 0.1 to 0.4 rad apart, under 3 rad/s, 10 rad/s^2 and
500 rad/s^3. Velocity, acceleration and jerk are the first three differences of positions sampled
at 1 kHz, with the arm at rest before and after: what a servo would be sent. Durations are compared
with toppra's optimum on 4001 grid points, which knows no jerk limit.

Peers on the same paths: toppra as it comes (automatic grid, its default parametrizer), ruckig from
waypoint to waypoint, and straight trapezoids with a stop at each waypoint. The last two follow the
polyline instead of the spline.

The planner's own paths are different: few corners, far apart, rounded. Those are timed as well.

The stops are from random instants of those motions, under limits a fifth (acceleration) and a half
(jerk) above the motion's own.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks import _common
from so101_motion.common.geometry import Array
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.path_geometry import JointPath, blended_path, spline_path
from so101_motion.planning.timing.retime import retime
from so101_motion.planning.timing.trajectory import Trajectory

N = 100
SEED = 0
DT = 0.01
SAMPLING = 1e-3
BOUND_GRID = 4001
LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
STOP_LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=12.0, jerk=750.0)
REACH = np.array([1.9, 1.7, 1.6, 1.6, 2.7])
STOPS_PER_PATH = 10


def main() -> None:
    """Run everything, print the table, write the results."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    _common.single_thread()
    waypoints = random_waypoints()
    paths = [spline_path(points) for points in waypoints]
    retime(paths[0], LIMITS, DT)  # toppra is loaded here, without matplotlib
    bounds = np.array([optimum(path) for path in paths])
    rows = [
        *ours(paths, bounds),
        *rounded(),
        toppra_default(paths, bounds),
        ruckig_by_waypoint(waypoints, bounds),
        trapezoids(waypoints, bounds),
        *stops(paths),
    ]
    _common.write("bench_retime", rows, peers=("scipy",))


def random_waypoints() -> list[Array]:
    """Wandering paths within the joints' reach, each of shape (10 to 50, 5), [rad]."""
    rng = np.random.default_rng(SEED)
    found = []
    for _ in range(N):
        count = int(rng.integers(10, 51))
        points, heading = [rng.uniform(-0.8 * REACH, 0.8 * REACH)], rng.normal(size=5)
        while len(points) < count:
            heading = 0.7 * heading + 0.7 * rng.normal(size=5)
            step = heading / np.linalg.norm(heading) * rng.uniform(0.1, 0.4)
            point = np.clip(points[-1] + step, -0.95 * REACH, 0.95 * REACH)
            if np.linalg.norm(point - points[-1]) > 0.05:
                points.append(point)
            else:  # held by the edge of the reach: turn round
                heading = rng.normal(size=5)
        found.append(np.array(points))
    return found


def ours(paths: Sequence[JointPath], bounds: Array) -> list[dict[str, Any]]:
    """This project: timed at the executor's spacing, judged at 1 kHz."""
    timed, times = _common.measure(lambda path: retime(path, LIMITS, DT), paths)
    fine, fine_times = _common.measure(lambda path: retime(path, LIMITS, SAMPLING), paths)
    durations = np.array([trajectory.duration for trajectory in timed])
    sampled = [trajectory.q for trajectory in fine]
    away = max(deviation(path, q) for path, q in zip(paths, sampled, strict=True))
    judged = judgement(durations / bounds, sampled)
    return [
        row("so101_motion, samples 10 ms apart", times, judged) | {"off_path_rad": away},
        row("so101_motion, samples 1 ms apart", fine_times, judged) | {"off_path_rad": away},
    ]


def rounded() -> list[dict[str, Any]]:
    """This project on what the planner finds: polylines with few, far corners, rounded."""
    rows = []
    for corners in (1, 4, 13):
        rng = np.random.default_rng(SEED + corners)
        polylines = [rng.uniform(-0.8 * REACH, 0.8 * REACH, (corners + 2, 5)) for _ in range(N)]
        paths = [blended_path(points, 0.08) for points in polylines]
        _, times = _common.measure(lambda path: retime(path, LIMITS, DT), paths)
        sampled = [retime(path, LIMITS, SAMPLING).q for path in paths]
        shares = np.array([limit_shares(q) for q in sampled]).max(axis=0)
        judged = dict(zip(("velocity", "acceleration", "jerk"), shares.tolist(), strict=True))
        rows.append(row(f"so101_motion, {corners} rounded corners", times, judged))
    return rows


def toppra_default(paths: Sequence[JointPath], bounds: Array) -> dict[str, Any]:
    """Toppra with its own grid and its default parametrizer."""

    def timed(path: JointPath) -> Any:
        return instance(path, None).compute_trajectory(0.0, 0.0)

    found, times = _common.measure(timed, paths)
    durations = np.array([trajectory.duration for trajectory in found])
    sampled = [
        trajectory(np.minimum(np.arange(math.ceil(end / SAMPLING) + 1) * SAMPLING, end))
        for trajectory, end in zip(found, durations, strict=True)
    ]
    return row("toppra, defaults", times, judgement(durations / bounds, sampled))


def ruckig_by_waypoint(waypoints: Sequence[Array], bounds: Array) -> dict[str, Any]:
    """Jerk-limited straight moves with a stop at each waypoint."""
    found, times = _common.measure(lambda points: moves(points, DT), waypoints)
    durations = np.array([sum(move.duration for move in parts) for parts in found])
    # Each move is sampled from its own start; what it holds at its end adds nothing to a maximum.
    sampled = [move.q for points in waypoints for move in moves(points, SAMPLING)]
    return row("ruckig, stop at each waypoint", times, judgement(durations / bounds, sampled))


def moves(points: Array, dt: float) -> list[Trajectory]:
    """One move for each line of a polyline."""
    return [
        online.point_to_point(start, goal, LIMITS, dt) for start, goal in itertools.pairwise(points)
    ]


def trapezoids(waypoints: Sequence[Array], bounds: Array) -> dict[str, Any]:
    """Trapezoids of speed along straight lines: no jerk limit, a stop at each waypoint."""

    def total(points: Array) -> float:
        way = np.abs(np.diff(points, axis=0))
        speed, bend = LIMITS.velocity, LIMITS.acceleration
        full = way / speed + speed / bend
        return float(np.where(way < speed**2 / bend, 2.0 * np.sqrt(way / bend), full).max(1).sum())

    durations, times = _common.measure(total, waypoints)
    ratio = ratios(np.array(durations) / bounds)
    exact = {"velocity": 1.0, "acceleration": 1.0, "jerk": "no limit"}
    return row("trapezoid, stop at each waypoint", times, ratio | exact)


def stops(paths: Sequence[JointPath]) -> list[dict[str, Any]]:
    """Stopping at random instants: along the path, and the shortest that leaves it."""
    rng = np.random.default_rng(SEED)
    motions = [retime(path, LIMITS, DT) for path in paths]
    instants = [
        (motion, float(t))
        for motion in motions
        for t in rng.uniform(0.0, motion.duration, STOPS_PER_PATH)
    ]

    def along(instant: tuple[Trajectory, float]) -> Trajectory:
        return online.stop_on_path(*instant, STOP_LIMITS, DT)

    def shortest(instant: tuple[Trajectory, float]) -> Trajectory:
        motion, t = instant
        now = motion.sample(t)
        return online.stop(now.q, now.qd, now.qdd, STOP_LIMITS, DT)

    on_path, times = _common.measure(along, instants)
    shortcuts, short_times = _common.measure(shortest, instants)
    longer = np.array([stop.duration for stop in on_path])
    least = np.array([stop.duration for stop in shortcuts])
    left = [
        deviation_from_motion(motion, t, stop) > 1e-3
        for (motion, t), stop in zip(instants, on_path, strict=True)
    ]
    return [
        {"method": "stop on the path", **_common.summary(times)}
        | {"stop_median_s": float(np.median(longer)), "stop_max_s": float(longer.max())}
        | {"off_path": int(sum(left))},
        {"method": "stop, shortest", **_common.summary(short_times)}
        | {"stop_median_s": float(np.median(least)), "stop_max_s": float(least.max())},
    ]


def optimum(path: JointPath) -> float:
    """Toppra's duration on a fine even grid [s]: the bound."""
    grid = np.linspace(0.0, path.length, BOUND_GRID)
    _, speed, _ = instance(path, grid).compute_parameterization(0.0, 0.0)
    return float(np.sum(2.0 * np.diff(grid) / (speed[1:] + speed[:-1])))


def instance(path: JointPath, grid: Array | None) -> Any:
    """Toppra's problem for this spline under the velocity and acceleration limits."""
    from toppra import SplineInterpolator
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

    constraints = [
        JointVelocityConstraint(LIMITS.velocity),
        JointAccelerationConstraint(LIMITS.acceleration),
    ]
    waypoints = path.evaluate(path.knots).q
    spline = SplineInterpolator(path.knots, waypoints, bc_type="natural")
    return TOPPRA(constraints, spline, gridpoints=grid, solver_wrapper="seidel")


def judgement(ratio: Array, sampled: Sequence[Array]) -> dict[str, Any]:
    """Durations against the bound, and the worst shares of the limits over all motions."""
    shares = np.array([limit_shares(q) for q in sampled]).max(axis=0)
    names = ("velocity", "acceleration", "jerk")
    return ratios(ratio) | dict(zip(names, shares.tolist(), strict=True))


def ratios(ratio: Array) -> dict[str, float]:
    """Median and largest duration in terms of the bound."""
    return {"ratio_median": float(np.median(ratio)), "ratio_max": float(ratio.max())}


def limit_shares(q: Array) -> Array:
    """Largest share of the velocity, acceleration and jerk limits in positions 1 ms apart."""
    rest = np.concatenate((np.repeat(q[:1], 3, 0), q, np.repeat(q[-1:], 3, 0)))
    caps = (LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk)
    return np.array(
        [
            np.max(np.abs(np.diff(rest, order, axis=0)) / SAMPLING**order / cap)
            for order, cap in enumerate(caps, start=1)
        ]
    )


def deviation(path: JointPath, q: Array) -> float:
    """How far the joint that is furthest off gets from the nearest point of the path [rad]."""
    coarse = np.linspace(0.0, path.length, 4000)
    dense, gap = path.evaluate(coarse).q, coarse[1]
    worst = 0.0
    for one in q[::25]:
        near = coarse[np.abs(dense - one).max(axis=1).argmin()]
        around = path.evaluate(np.linspace(near - gap, near + gap, 200)).q
        worst = max(worst, float(np.abs(around - one).max(axis=1).min()))
    return worst


def deviation_from_motion(motion: Trajectory, begin: float, stop: Trajectory) -> float:
    """How far a stop gets from the positions the motion would have visited [rad]."""
    t = np.arange(begin, begin + stop.duration + 2.0 * DT, 5e-4)
    dense = motion.at(t)[0]
    return max(float(np.abs(dense - one).max(axis=1).min()) for one in stop.q)


def row(method: str, times: Sequence[float], judged: dict[str, Any]) -> dict[str, Any]:
    """One line of the table."""
    return {"method": method, **_common.summary(times), **judged}


if __name__ == "__main__":
    main()
