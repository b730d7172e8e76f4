"""Plan a motion for a request: run all stages, and verify every sample.

The stages, for every kind of goal:

    departure   only if the start is beyond a limit or in contact: a short, slow motion out of it
    ik          a pose becomes joint angles; all that are free of contact are candidates
    path        a polyline in joint space proven free, straight if possible; else the quickest of
                several, with a motion that takes cuts in time
    retime      that becomes a motion of bounded jerk: ruckig along a straight line, an average over
                time of cuts, TOPP-RA through corners, one number along a straight line of the tool
    verify      every sample of the motion against limits and contact

The same request gives the same motion, byte for byte; only the times in the report differ.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.among import plan_among
from so101_motion.planning.cartesian.cartesian import CartesianPlanner
from so101_motion.planning.cartesian.path_search import ToolMotion
from so101_motion.planning.checkpoint import Checkpoint, never_abandoned
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import Obstacle, Scene, Sphere
from so101_motion.planning.goal_configurations import (
    checked_path,
    configurations_above,
    free_configurations,
)
from so101_motion.planning.goals import (
    ApproachGoal,
    JointGoal,
    LeaveContactGoal,
    LineGoal,
    PathGoal,
    PoseGoal,
)
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.motion_builder import MotionBuilder, Pieces
from so101_motion.planning.paths.path import PathFinder
from so101_motion.planning.paths.start_recovery import FARTHEST, find_departure, needs_departure
from so101_motion.planning.planning_context import PlanningContext
from so101_motion.planning.request import PathDeviation, Plan, PlanReport, PlanRequest
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.path_geometry import JointPath
from so101_motion.planning.timing.torque import Load, carried
from so101_motion.planning.timing.trajectory import Trajectory, joined

__all__ = ["Plan", "PlanReport", "PlanRequest", "Planner"]

CORNER = 0.1  # how far joints may cut corners [rad]; chosen to keep the speed up
_PICTURE_POINTS = 64  # number of points of the tool's path in a plan, for pictures

_Frame = tuple[str, tuple[float, ...], tuple[float, ...]]
"""A further frame's name, rotation and position, as a cache key."""


class _Solvers(NamedTuple):
    """The solvers that depend on the joint limits."""

    model: RobotModel
    ik: IkSolver
    lines: CartesianPlanner


class Planner:
    """Plans for one arm. Belongs to one thread.

    Attributes:
        around: The collision model of a scene, one of the last.
    """

    def __init__(self, model: RobotModel, checkpoint: Checkpoint = never_abandoned) -> None:
        self._model = model
        self._within = lru_cache(maxsize=4)(self._solvers)
        self.around = lru_cache(maxsize=16)(partial(CollisionModel, model, checkpoint=checkpoint))
        self._carrying = lru_cache(maxsize=4)(model.with_payload)

    def plan(self, request: PlanRequest) -> Plan:
        """Plan one motion.

        Args:
            request: Start, goal, limits and surroundings.

        Returns:
            A motion from rest to rest whose every sample has been verified; of duration 0 if the
            arm is at the goal.

        Raises:
            Unreachable: The goal is out of reach.
            OutsideLimits: A joint goal or a waypoint is outside the joint limits.
            InCollision: Start, goal, or a path that was prescribed, is in contact.
            NoPath: Start and goal are free, but no path was found between them in time.
            Overloaded: A servo would have to bear too much at any speed.
            ConfigError: The request holds a value that is not valid.
        """
        return plan_among(self._plan, request) if request.others else self._plan(request)

    def _plan(self, request: PlanRequest) -> Plan:
        begin = time.perf_counter()
        context = self.context(request)
        departure, q_from = self._departure(context)
        waypoints, pieces = self._move(context, q_from)
        trajectory = joined([*departure, *pieces])
        if departure:
            waypoints = np.concatenate([request.q_start[None], waypoints])
        if request.lead is not None:
            with context.stage("join"):
                trajectory = taken_up(context, request.lead, trajectory)
        if context.moves.load is not None:
            context.moves.load.check_goal(trajectory.q[-1])
        context.stages_ms["total"] = (time.perf_counter() - begin) * 1e3
        return self.plan_of(context, trajectory, waypoints, departure=bool(departure))

    def plan_of(
        self,
        context: PlanningContext,
        trajectory: Trajectory,
        waypoints: Array,
        *,
        departure: bool = False,
    ) -> Plan:
        """The plan for a verified motion along ``waypoints``, shape (m, 5), [rad]."""
        request = context.request
        closest = context.moves.collision.clearance(trajectory.q[-1], request.q_jaw)
        return Plan(
            q_start=request.q_start if request.lead is None else trajectory.q[0],
            q_goal=trajectory.q[-1],
            trajectory=trajectory,
            path=waypoints,
            tool_path=_tool_path(context.moves.tool, trajectory.q),
            limits=request.limits,
            report=PlanReport(
                stages_ms=context.stages_ms,
                straight=len(waypoints) == 2,
                departure=departure,
                blind=departure
                and bool(context.moves.collision.in_surface(request.q_start, request.q_jaw).any()),
                effort=context.effort,
                short_of_drive=""
                if context.moves.load is None
                else context.moves.load.short_of_drive,
                path_deviation=context.path_deviation,
                routes=context.routes,
                out_of_time=context.out_of_time,
                clearance=closest.distance,
                closest=(closest.first, closest.second),
            ),
        )

    def warm_up(self) -> None:
        """Run once everything that is slow the first time."""
        limits = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=50.0)
        steps = np.array([[0.2, -0.1, 0.0, 0.0, 0.0], [0.2, 0.1, 0.1, 0.0, 0.0]])
        for goal in (
            PathGoal(waypoints=steps),
            PoseGoal(T_base_tool=self._model.frame(steps[0])),
            LineGoal(T_base_tool=self._model.frame(0.5 * steps[0])),
        ):
            self.plan(PlanRequest(q_start=np.zeros(5), goal=goal, limits=limits, dt=0.02))
        ahead = SE3.from_translation((0.36, 0.0, 0.23))
        ball = Obstacle(name="ball", shape=Sphere(radius=0.05), T_base_obstacle=ahead)
        aside = np.array([0.6, 0.0, 0.0, 0.0, 0.0])
        self.plan(
            PlanRequest(
                q_start=aside,
                goal=JointGoal(q=-aside),
                limits=limits,
                scene=Scene(obstacles=(ball,)),
                dt=0.02,
            )
        )

    def _solvers(
        self, limits: tuple[tuple[float, ...], ...] | None, frames: tuple[_Frame, ...]
    ) -> _Solvers:
        model = self._model.narrowed(*limits) if limits else self._model
        for name, R, p in frames:
            model = model.with_frame(name, SE3(np.reshape(R, (3, 3)), np.array(p)))
        ik = IkSolver(model)
        return _Solvers(model, ik, CartesianPlanner(ik))

    def _narrower(self, request: PlanRequest) -> tuple[tuple[float, ...], ...] | None:
        """The narrower of the request's and the model's joint limits; None if the model's."""
        model = self._model
        lower = model.lower if request.lower is None else np.maximum(model.lower, request.lower)
        upper = model.upper if request.upper is None else np.minimum(model.upper, request.upper)
        if np.array_equal(lower, model.lower) and np.array_equal(upper, model.upper):
            return None
        return tuple(lower.tolist()), tuple(upper.tolist())

    def context(self, request: PlanRequest) -> PlanningContext:
        """The solvers and checks for one request."""
        frames = tuple(
            (name, tuple(T.R.ravel().tolist()), tuple(T.p.tolist()))
            for name, T in sorted(request.frames.items())
        )
        model, ik, lines = self._within(self._narrower(request), frames)
        collision = self.around(request.scene)
        return PlanningContext(
            request=request,
            model=model,
            ik=ik,
            lines=lines,
            moves=MotionBuilder(
                model=model,
                collision=collision,
                q_jaw=request.q_jaw,
                limits=request.limits,
                dt=request.dt,
                tool=lines.tool,
                load=self._load(request),
            ),
            finder=PathFinder(model, collision, q_jaw=request.q_jaw, seed=request.seed),
        )

    def _load(self, request: PlanRequest) -> Load | None:
        """The load of the servos; None if the request does not check torques."""
        if request.strength is None:
            return None
        payload = carried(request.payload, request.scene.attached)
        model = self._model if payload is None else self._carrying(payload.mass, payload.com)
        return Load(model, request.strength, request.q_start, payload)

    def _departure(self, context: PlanningContext) -> tuple[Pieces, Array]:
        """The slow motion out of a bad start, none for a good one, and where planning begins."""
        request, moves = context.request, context.moves
        q_start, goal = request.q_start, request.goal
        if request.lead is not None and not context.is_free(q_start):
            raise moves.in_collision(q_start, "start")
        if not needs_departure(context.model, moves.collision, q_start, request.q_jaw):
            return [], q_start
        with context.stage("departure"):
            q_exit = find_departure(
                context.model,
                moves.collision,
                q_start,
                q_jaw=request.q_jaw,
                towards=_towards(context),
                seed=request.seed,
                farthest=goal.farthest if isinstance(goal, LeaveContactGoal) else FARTHEST,
            )
            return [moves.departing(q_start, q_exit)], q_exit

    def _move(self, context: PlanningContext, q_from: Array) -> tuple[Array, Pieces]:
        """Waypoints and motion from a good start to the goal."""
        goal = context.request.goal
        if isinstance(goal, PoseGoal):
            return self._to_any(context, q_from, free_configurations(context, goal, q_from))
        if isinstance(goal, LeaveContactGoal):
            return self._to_any(context, q_from, iter([q_from]))
        if isinstance(goal, JointGoal):
            q_goal = context.model.within_limits(goal.q)
            if not context.is_free(q_goal):
                raise context.moves.in_collision(q_goal, "goal")
            if context.moves.load is not None:
                context.moves.load.check_goal(q_goal)
            return self._to_any(context, q_from, iter([q_goal]))
        if isinstance(goal, PathGoal):
            with context.stage("path"):
                waypoints = checked_path(context.model, context.moves, q_from, goal.waypoints)
            return waypoints, self._timed(context, waypoints, goal.tolerance, spline=True)
        if isinstance(goal, ApproachGoal):
            return self._approach(context, q_from, goal)
        with context.stage("path"):
            found = context.lines.find(goal, q_from, context.moves.collision, context.request.q_jaw)
        return found.waypoints, self._followed(context, found)

    def _to_any(
        self, context: PlanningContext, q_from: Array, goals: Iterator[Array]
    ) -> tuple[Array, Pieces]:
        """Waypoints and motion to the first of the goals that can be reached."""
        with context.stage("path"):
            found = context.find(q_from, goals)
        return found.waypoints, self._timed(context, found.waypoints, CORNER, quick=found.motion)

    def _followed(self, context: PlanningContext, found: ToolMotion) -> Pieces:
        """The motion along curves that keep the tool to its path."""
        with context.stage("retime"):
            pieces = found.timed(context.request.limits, context.request.dt, context.moves.tool)
            pieces = [context.moves.slowed_to_torque_limits(piece) for piece in pieces]
        with context.stage("verify"):
            context.check(pieces)
        context.path_deviation = PathDeviation(position=found.off, angle=found.turned)
        return pieces

    def _approach(
        self, context: PlanningContext, q_from: Array, goal: ApproachGoal
    ) -> tuple[Array, Pieces]:
        """Waypoints and motion by any free path to above a pose, then straight to it."""
        kept: list[ToolMotion] = []
        with context.stage("path"):
            above = configurations_above(context, q_from, goal, kept)
            found = context.find(q_from, above)
        line = kept[found.goal]
        pieces = self._timed(context, found.waypoints, CORNER, quick=found.motion)
        pieces += self._followed(context, line)
        return np.concatenate([found.waypoints, line.waypoints[1:]]), pieces

    def _timed(
        self,
        context: PlanningContext,
        waypoints: Array,
        tolerance: float,
        *,
        spline: bool = False,
        quick: JointPath | None = None,
    ) -> Pieces:
        """Time a polyline in several ways; the first result that passes verification."""
        motions = context.moves.motions(waypoints, tolerance, spline=spline, quick=quick)
        problem: PlanningError | None = None
        while True:
            with context.stage("retime"):
                pieces = next(motions, None)
            if pieces is None:
                raise problem or PlanningError("no motion along this path keeps the limits")
            with context.stage("verify"):
                try:
                    context.check(pieces)
                except PlanningError as error:
                    problem = error
                else:
                    return pieces


def _tool_path(tool: ArmChain, q: Array) -> Array:
    return tool.positions(q[np.unique(np.linspace(0, len(q) - 1, _PICTURE_POINTS).astype(int))])


def _towards(context: PlanningContext) -> list[Array]:
    """Configurations that the motion will go to, if known."""
    goal = context.request.goal
    if isinstance(goal, JointGoal):
        return [goal.q]
    if isinstance(goal, PathGoal):
        return [*goal.waypoints[:1]]
    if isinstance(goal, PoseGoal):
        return [context.ik.solve(goal, context.request.q_start).q]
    return []


TRIED = 16  # number of states that are tried as the end of the cut; chosen: each takes 50 us


def taken_up(context: PlanningContext, lead: Trajectory, motion: Trajectory) -> Trajectory:
    """The motion from the first state of ``lead`` to the end of ``motion``, which starts at rest.

    ``lead`` would come to rest where ``motion``, which was checked, begins. It may brake harder
    than the request's limits allow, as a stop does that nothing softer can replace. Any instant of
    that is a state, and the fastest motion from the first to a later one cuts off what lies
    between. The shortest cut that keeps all limits and is proven free is taken.

    Raises:
        InCollision: Not even coming to rest first is free of contact.
    """
    whole, limits, moves = lead.then(len(lead) - 1, motion), context.request.limits, context.moves
    last, begin = len(whole) - 1, whole.sample(0.0)
    tried: list[tuple[int, int, Callable[[], Trajectory]]] = []
    for k in np.unique(np.linspace(1, last, TRIED).astype(int)).tolist():
        with suppress(PlanningError):
            count, cut = online.between(begin, whole.sample(k * whole.dt), limits, whole.dt)
            tried.append((count - k, k, cut))
    for saved, k, cut in sorted(tried, key=lambda each: each[0]):
        shorter = cut().then(saved + k, whole.since(k))
        if saved < 0 and moves.is_free(shorter):
            with suppress(PlanningError):
                context.check([shorter])
                return shorter
    moves.check_contact(whole)
    return whole
