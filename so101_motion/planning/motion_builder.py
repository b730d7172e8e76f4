"""Turn a collision-free path into a motion, and verify every sample of it.

A motion is a path with timing; it leaves the path where corners are rounded and acceleration is
smoothed. So every motion is checked again, sample by sample as it will be sent, against position,
velocity, acceleration and jerk limits, the cap on the tool's speed, and contact. If a rounded
motion fails, the corners are rounded less; in the end the arm stops at each corner, which keeps it
exactly on the lines that were proven.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from so101_motion.common.errors import InCollision, OutsideLimits, PlanningError
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import MARGIN_TOLERANCE
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.paths.start_recovery import is_harmless
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point
from so101_motion.planning.timing.path_geometry import (
    JointPath,
    blended_path,
    rounded_corners,
    spline_path,
)
from so101_motion.planning.timing.retime import retime
from so101_motion.planning.timing.torque import Load, slowed
from so101_motion.planning.timing.trajectory import Trajectory

_WHEN = {"start": "leaving the start", "goal": "at the goal", "path": "on the way"}
_ADVICE = {
    "start": "move the arm by hand (manual mode) and try again",
    "goal": "choose another goal, or correct the scene if that is not there",
    "path": "choose waypoints further away from it",
}

Pieces = list[Trajectory]  # a motion in parts, with the arm at rest between them

DEPARTURE_SPEED = 0.25  # of the fastest joint leaving a bad start [rad/s]; chosen to be watched
SMOOTHING_SHARE = 0.25  # share of a corner tolerance for the smoothing of acceleration. Chosen
SMOOTHING_MOST = 0.02  # largest deviation by smoothing [rad]; ``retime``'s default

NARROWEST, WIDEST = 0.002, 0.5
"""With a corner tolerance below the first the arm stops at corners, which is then faster than
rounding (seen: at 0.001 rad by a tenth); above the second no corner gets any rounder [rad].
Chosen."""

_ROUNDER = 0.25  # factor of the roundings in the second attempt
LOOK = 0.02  # travel between the samples of a quick check before a motion is timed [m]
_PER_PIECE = 16  # points of each piece of a rounded path in a quick check before it is timed
SAME = 1e-6  # joints that agree so far are equal [rad]; chosen: a tick is 1.5e-3
_TOOL_POINTS = 65
_TOOL_SLACK = 1e-3  # accepted excess of tool speed: it is limited at points
SMALLER = 0.35  # factor for a blocked corner; chosen, three sizes from 0.1 to 0.01 rad
PER_CORNER = 12  # number of configurations of a rounded corner that are checked


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionBuilder:
    """Makes motions for one request."""

    model: RobotModel  # the arm
    collision: CollisionModel  # checks for contact
    q_jaw: float  # jaw angle during the motion [rad]
    limits: MotionLimits  # caps of the motion
    dt: float  # time between samples [s]
    tool: ArmChain  # kinematics of the tool point, whose speed has a cap
    load: Load | None = None  # load of the servos; None not to check it

    def straight(self, q_from: Array, q_to: Array) -> Trajectory:
        """The motion along the straight joint line, from rest to rest; duration 0 if equal."""
        if np.abs(q_to - q_from).max() <= SAME:
            q_to = q_from
        limits = self.limits
        if limits.tool_speed is not None:
            limits = self._within_tool_speed(q_from, q_to, limits, limits.tool_speed)
        trajectory = point_to_point(q_from, q_to, limits, self.dt)
        if self.load is None or self.load.stretch(trajectory) == 1.0:
            return trajectory
        line = np.array([q_from, q_to])
        return self._retimed(blended_path(line, WIDEST), line, SMOOTHING_MOST)

    def departing(self, q_from: Array, q_to: Array) -> Trajectory:
        """The slow straight joint motion out of a bad start; refused if it is not harmless."""
        slow = self.limits.lowered_to(np.full(5, DEPARTURE_SPEED), np.inf)
        trajectory = replace(self, limits=slow).straight(q_from, q_to)
        if not any(
            is_harmless(self.collision, trajectory.q, self.q_jaw, judged)
            for judged in (True, self.collision.measured)
        ):
            raise self.in_collision(q_from, "start")
        return trajectory

    def motions(
        self,
        waypoints: Array,
        tolerance: float,
        *,
        spline: bool,
        quick: JointPath | None = None,
    ) -> Iterator[Pieces]:
        """Motions along a free polyline (m, 5), the fastest first; none has been checked.

        The last one stops at every corner and stays on the polyline. A motion of several pieces
        rests between them. Each joint may leave the polyline by ``tolerance`` [rad]; with
        ``spline`` the curve through all waypoints is tried first. ``quick`` is another motion
        between the same ends, over time [s], which leaves the polyline.
        """
        along = self._along(waypoints, tolerance, spline=spline)
        if quick is None:
            yield from along
            return
        motions: list[Pieces] = []
        with suppress(PlanningError):
            fast = _between_ends(retime(quick, self.limits, self.dt, in_time=True), waypoints)
            motions.append([self.slowed_to_torque_limits(fast)])
            if motions != [[fast]]:  # along the polyline only the heavy part becomes slower
                motions.append(next(along))
        yield from sorted(motions, key=lambda pieces: sum(each.duration for each in pieces))
        yield from along

    def _along(self, waypoints: Array, tolerance: float, *, spline: bool) -> Iterator[Pieces]:
        """Motions that keep to a polyline."""
        if self.load is not None:
            self.load.check_holding(_between(waypoints), "on the way")
        tolerance = min(tolerance, WIDEST)
        if len(waypoints) > 2 and tolerance >= NARROWEST:
            smoothing = min(SMOOTHING_SHARE * tolerance, SMOOTHING_MOST)
            if spline:
                yield from self._splined(waypoints, tolerance, smoothing)
            look = self.collision.sampled_check(self.q_jaw, spacing=LOOK)
            corners = roomy_corners(waypoints, tolerance - smoothing, NARROWEST, look.touching)
            yield from self._rounded(waypoints, corners, smoothing)
            tighter = np.where(_ROUNDER * corners < NARROWEST, 0.0, _ROUNDER * corners)
            if np.any(tighter > 0.0):
                yield from self._rounded(waypoints, tighter, _ROUNDER * smoothing)
        yield [self.straight(a, b) for a, b in pairwise(waypoints)]

    def _retimed(self, path: JointPath, waypoints: Array, smoothing: float) -> Trajectory:
        tool_speed = self.tool.speeds if self.limits.tool_speed else None
        make = partial(
            retime,
            path,
            self.limits,
            self.dt,
            tool_speed_fn=tool_speed,
            deviation=smoothing,
            checkpoint=self.collision.checkpoint,
        )
        trajectory = _between_ends(make(), waypoints)
        if self.load is not None and self.load.stretch(trajectory) > 1.0:
            slower = _between_ends(make(further=self.load.rows), waypoints)
            trajectory = self.slowed_to_torque_limits(slower)
        return trajectory

    def slowed_to_torque_limits(self, trajectory: Trajectory) -> Trajectory:
        """The same motion, slowed down until the servos can bear it, if they can at any speed."""
        if self.load is None:
            return trajectory
        self.load.check_holding(trajectory.q, "on the way")
        longer = self.load.stretch(trajectory)
        return slowed(trajectory, longer) if longer > 1.0 else trajectory

    def check(self, trajectory: Trajectory) -> verify.LimitReport:
        """Refuse a motion that breaks a limit, touches something or overloads a servo."""
        report = self.check_limits(trajectory)
        if self.load is not None:
            report = replace(report, effort=self.load.check(trajectory))
        self.check_contact(trajectory)
        return report

    def check_contact(self, trajectory: Trajectory) -> None:
        """Refuse a motion that touches something."""
        blocked = self._first_blocked(trajectory)
        if blocked is not None:
            raise self.in_collision(blocked, "path")

    def is_free(self, trajectory: Trajectory) -> bool:
        """Whether a motion touches nothing; ``check`` says what else is wrong with it."""
        return self._first_blocked(trajectory) is None

    def _first_blocked(self, trajectory: Trajectory) -> Array | None:
        return self.collision.first_blocked(trajectory.q, self.q_jaw, tolerance=MARGIN_TOLERANCE)

    def check_limits(self, trajectory: Trajectory) -> verify.LimitReport:
        """Refuse a motion that breaks a limit; one that starts outside may come in from there."""
        lower = np.minimum(self.model.lower, trajectory.q[0])
        upper = np.maximum(self.model.upper, trajectory.q[0])
        report = verify.check(trajectory, self.limits, lower, upper)
        cap = self.limits.tool_speed
        if cap is not None:
            fastest = float(self.tool.speeds(trajectory.q, trajectory.qd).max())
            if fastest > cap * (1.0 + _TOOL_SLACK):
                raise OutsideLimits(
                    f"the tool would move at {fastest * 1e3:.0f} mm/s, its limit is"
                    f" {cap * 1e3:.0f} mm/s; move more slowly",
                    joint="tool",
                    value=fastest,
                    lower=0.0,
                    upper=cap,
                )
        return report

    def in_collision(self, q: Array, where: str, when: str | None = None) -> InCollision:
        """The error for a configuration in contact; ``when`` begins the sentence."""
        closest = self.collision.clearance(q, self.q_jaw)
        bodies = closest.first, closest.second
        arms = self.collision.scene.arms
        near = (a.name for a in arms if any(each.startswith(a.called("")) for each in bodies))
        arm, advice = next(near, None), _ADVICE[where]
        if arm is not None and where == "goal":
            advice = f"choose another goal, or move {arm} away first"
        return InCollision(
            f"{when or _WHEN[where]} {closest.message()} ({closest.margin * 1e3:.0f} mm must"
            f" stay free); {advice}",
            first=closest.first,
            second=closest.second,
            where=where,
        )

    def _within_tool_speed(
        self, q_from: Array, q_to: Array, limits: MotionLimits, cap: float
    ) -> MotionLimits:
        """Limits with which the tool keeps its cap anywhere on a straight joint line."""
        step = q_to - q_from
        share = np.linspace(0.0, 1.0, _TOOL_POINTS)[:, None]
        per_path = float(
            self.tool.speeds(q_from + share * step, np.broadcast_to(step, (len(share), 5))).max()
        )
        if per_path == 0.0:
            return limits
        with np.errstate(divide="ignore"):
            fastest = np.where(step == 0.0, np.inf, np.abs(step) * (cap / per_path))
        return limits.lowered_to(fastest, np.inf)

    def _splined(self, waypoints: Array, tolerance: float, smoothing: float) -> Iterator[Pieces]:
        """The motion along the curve through all waypoints, if that stays near and is free."""
        path = spline_path(waypoints)
        if _deviation(path, waypoints) > tolerance - smoothing:
            return
        # Most motions that would be refused after timing are refused here already.
        look = self.collision.sampled_check(self.q_jaw, spacing=LOOK)
        if look.touching(_dense(path)).any():
            return
        with suppress(PlanningError):
            yield [self._retimed(path, waypoints, smoothing)]

    def _rounded(self, waypoints: Array, corners: Array, smoothing: float) -> Iterator[Pieces]:
        """The motion along a polyline with corners cut by ``corners``, with stops where it is 0."""
        with suppress(PlanningError):
            yield [
                self._retimed(blended_path(part, cut), part, smoothing)
                if len(cut)
                else self.straight(*part)
                for part, cut in between_stops(waypoints, corners)
            ]


def _between_ends(trajectory: Trajectory, waypoints: Array) -> Trajectory:
    """The same motion with exactly the first and the last waypoint at its ends.

    The path's own ends are values of polynomials, equal to the waypoints except for rounding.
    """
    q = np.array(trajectory.q)
    q[0], q[-1] = waypoints[0], waypoints[-1]
    return replace(trajectory, q=q)


def _between(waypoints: Array) -> Array:
    """Points along a polyline, its corners among them, shape (m, n)."""
    share = np.linspace(0.0, 1.0, _PER_PIECE + 1)[:-1, None]
    parts = [a + share * (b - a) for a, b in pairwise(waypoints)]
    return np.concatenate([*parts, waypoints[-1:]])


def _dense(path: JointPath) -> Array:
    """Points on every piece of a path, ends included, shape (m, n)."""
    pieces = np.arange(len(path.knots) - 1)
    offsets = np.diff(path.knots)[:, None] * np.linspace(0.0, 1.0, _PER_PIECE + 1)[:-1]
    q = path.on_pieces(pieces[:, None], offsets).q.reshape(-1, path.n)
    return np.concatenate([q, path.evaluate([path.length]).q])


def _deviation(path: JointPath, waypoints: Array) -> float:
    """How far any joint of a curve through waypoints is from the line between its neighbours."""
    pieces = np.arange(len(waypoints) - 1)
    share = np.linspace(0.0, 1.0, _PER_PIECE + 1)[None, :, None]
    q = path.on_pieces(pieces[:, None], np.diff(path.knots)[:, None] * share[0, :, 0]).q
    start, step = waypoints[:-1, None], np.diff(waypoints, axis=0)[:, None]
    along = np.clip(np.sum((q - start) * step, axis=2) / np.sum(step * step, axis=2), 0.0, 1.0)
    return float(np.abs(q - start - along[..., None] * step).max())


def roomy_corners(
    waypoints: Array, tolerance: float, narrowest: float, touching: Callable[[Array], Array]
) -> Array:
    """How far a joint may leave a polyline (m, 5) at its corners, (m - 2,) [rad]; 0 for a stop.

    A corner with enough room is cut widely, so that the arm keeps its speed; one beside an obstacle
    less, down to ``narrowest``, and if even that is blocked the arm stops there. ``touching`` tells
    which of several configurations (n, 5) touch something, (n,).
    """
    tolerances = np.full(len(waypoints) - 2, tolerance)
    tight = np.arange(len(tolerances))
    while len(tight):
        corners = rounded_corners(waypoints, np.maximum(tolerances, narrowest))
        tight = tight[corners.reach[tight] > 0.0]  # the others are straight
        q = corners.at(np.linspace(0.0, 1.0, PER_CORNER))[tight]
        blocked = touching(q.reshape(-1, q.shape[2])).reshape(-1, PER_CORNER).any(axis=1)
        tight = tight[blocked]
        tolerances[tight] *= SMALLER
        tolerances[tolerances < narrowest] = 0.0
        tight = tight[tolerances[tight] > 0.0]
    return tolerances


def between_stops(waypoints: Array, tolerances: Array) -> Iterator[tuple[Array, Array]]:
    """The parts (k, 5) of a polyline between stops, with the cuts of their corners, (k - 2,)."""
    stops = [0, *(1 + np.flatnonzero(tolerances == 0.0)), len(waypoints) - 1]
    for begin, end in pairwise(stops):
        yield waypoints[begin : end + 1], tolerances[begin : end - 1]
