"""From a request to a motion that may be sent as it is, or to an error that says what is off.

The stages, for every kind of goal:

    departure   only if the start is beyond a limit or in contact: a short, slow way out
    ik          a pose becomes joint angles; all that are free of contact are candidates
    path        a polyline in joint space proven free, straight if possible
    retime      the polyline becomes a motion: ruckig along a straight line, toppra through corners,
                one number along the line for a straight line of the tool
    verify      every sample of the motion against limits and contact

The same request gives the same motion, byte for byte; only the times in the report differ.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from so101_motion.errors import PlanningError
from so101_motion.geometry import Array
from so101_motion.planning.cartesian import LinePlanner
from so101_motion.planning.collision import CollisionModel
from so101_motion.planning.departure import find_departure, needs_departure
from so101_motion.planning.freeing import freed
from so101_motion.planning.goals import JointGoal, LineGoal, PathGoal, PoseGoal
from so101_motion.planning.ik import IkSolution, IkSolver
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.model import RobotModel
from so101_motion.planning.moves import MoveMaker, Pieces, joined
from so101_motion.planning.path import PathFinder
from so101_motion.planning.plan import Plan, PlanReport, PlanRequest
from so101_motion.planning.waypoints import checked_way

__all__ = ["Plan", "PlanReport", "PlanRequest", "Planner"]

CORNER = 0.1
"""How far each joint may cut the corners of a path that was found here [rad]. Chosen: large enough
to keep the speed up; a corner that proves blocked is cut less."""

_PICTURE_POINTS = 64
"""How many points of the tool's way a plan carries for pictures."""


@dataclass(slots=True, kw_only=True)
class _Job:
    """One request under way: its tools, and what the report will say."""

    request: PlanRequest
    moves: MoveMaker
    finder: PathFinder
    stages_ms: dict[str, float] = field(default_factory=dict)
    branches: list[str] = field(default_factory=list)
    branch: str | None = None
    load: float = 0.0
    _inner_ms: float = 0.0

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time spent inside, without that of stages within, under ``name``."""
        outer_ms, self._inner_ms = self._inner_ms, 0.0
        begin = time.perf_counter()
        try:
            yield
        finally:
            spent_ms = (time.perf_counter() - begin) * 1e3
            own_ms = spent_ms - self._inner_ms
            self.stages_ms[name] = self.stages_ms.get(name, 0.0) + own_ms
            self._inner_ms = outer_ms + spent_ms


class Planner:
    """Plans for one arm. Belongs to one thread."""

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self._ik = IkSolver(model)
        self._lines = LinePlanner(self._ik)
        self._surroundings = lru_cache(maxsize=4)(self._collision_model)

    def plan(self, request: PlanRequest) -> Plan:
        """Plan one motion.

        Args:
            request: Where from, where to, how fast.

        Returns:
            A motion from rest to rest whose every sample has been verified. A goal that is where
            the arm stands gives a motion of duration 0.

        Raises:
            Unreachable: The goal is out of reach.
            OutsideLimits: A joint goal or a waypoint is outside the joint limits.
            InCollision: Start, goal, or a way that was prescribed, is in contact.
            NoPath: Start and goal are free, but no way was found between them in time.
            ConfigError: The request holds a value that cannot be meant.
        """
        begin = time.perf_counter()
        job = self._job(request)
        departure, q_from = self._departure(job)
        waypoints, pieces = self._move(job, q_from)
        trajectory = joined([*departure, *pieces])
        if departure:
            waypoints = np.concatenate([request.q_start[None], waypoints])
        tool_path = self._tool_path(trajectory.q)
        closest = job.moves.collision.clearance(trajectory.q[-1], request.q_jaw)
        job.stages_ms["total"] = (time.perf_counter() - begin) * 1e3
        return Plan(
            q_start=request.q_start,
            q_goal=trajectory.q[-1],
            trajectory=trajectory,
            path=waypoints,
            tool_path=tool_path,
            limits=request.limits,
            report=PlanReport(
                stages_ms=job.stages_ms,
                branch=job.branch,
                straight=len(waypoints) == 2,
                departure=bool(departure),
                load=job.load,
                clearance=closest.distance,
                closest=(closest.first, closest.second),
            ),
        )

    def warm_up(self) -> None:
        """Plan once through everything that is slow the first time, toppra's import included."""
        limits = MotionLimits.uniform(velocity=1.0, acceleration=2.0, jerk=50.0)
        steps = np.array([[0.2, -0.1, 0.0, 0.0, 0.0], [0.2, 0.1, 0.1, 0.0, 0.0]])
        for goal in (
            PathGoal(waypoints=steps),
            PoseGoal(T_base_tool=self._model.frame(steps[0])),
            LineGoal(T_base_tool=self._model.frame(0.5 * steps[0])),
        ):
            self.plan(PlanRequest(q_start=np.zeros(5), goal=goal, limits=limits, dt=0.02))

    def _collision_model(self, floor_z: float | None) -> CollisionModel:
        return CollisionModel(self._model, floor_z=floor_z)

    def _job(self, request: PlanRequest) -> _Job:
        collision = self._surroundings(request.floor_z)
        return _Job(
            request=request,
            moves=MoveMaker(
                model=self._model,
                collision=collision,
                q_jaw=request.q_jaw,
                limits=request.limits,
                dt=request.dt,
            ),
            finder=PathFinder(self._model, collision, q_jaw=request.q_jaw, seed=request.seed),
        )

    def _departure(self, job: _Job) -> tuple[Pieces, Array]:
        """The slow way out of a bad start, none for a good one, and where planning begins."""
        request, moves = job.request, job.moves
        q_start = request.q_start
        if not needs_departure(self._model, moves.collision, q_start, request.q_jaw):
            return [], q_start
        with job.stage("departure"):
            q_exit = find_departure(
                self._model,
                moves.collision,
                q_start,
                q_jaw=request.q_jaw,
                towards=self._towards(request),
                seed=request.seed,
            )
            return [moves.departing(q_start, q_exit)], q_exit

    def _towards(self, request: PlanRequest) -> list[Array]:
        goal = request.goal
        if isinstance(goal, JointGoal):
            return [goal.q]
        if isinstance(goal, PathGoal):
            return [*goal.waypoints[:1]]
        if isinstance(goal, PoseGoal):
            return [self._ik.solve(goal, request.q_start).q]
        return []

    def _move(self, job: _Job, q_from: Array) -> tuple[Array, Pieces]:
        """Waypoints and motion from a good start to the goal."""
        goal = job.request.goal
        if isinstance(goal, PoseGoal):
            return self._to_any(job, q_from, self._free_postures(job, goal, q_from))
        if isinstance(goal, JointGoal):
            self._model.check_limits(goal.q)
            if not self._is_free(job, goal.q):
                raise job.moves.in_collision(goal.q, "goal")
            return self._to_any(job, q_from, iter([goal.q]))
        if isinstance(goal, PathGoal):
            return self._along(job, q_from, goal)
        return self._on_line(job, q_from, goal)

    def _to_any(self, job: _Job, q_from: Array, goals: Iterator[Array]) -> tuple[Array, Pieces]:
        """A free way to the first of the goals that can be had."""
        with job.stage("path"):
            found = job.finder.find(q_from, goals, job.request.time_budget)
        if job.branches:
            job.branch = job.branches[found.goal]
        return found.waypoints, self._timed(job, found.waypoints, CORNER, spline=False)

    def _free_postures(self, job: _Job, goal: PoseGoal, q_from: Array) -> Iterator[Array]:
        """Joint angles for a pose that are free of contact, nearest first.

        Raises:
            InCollision: There are joint angles for the pose, but none is free.
        """
        request, collision = job.request, job.moves.collision
        blocked: list[IkSolution] = []
        for solution in self._solutions(job, goal, q_from):
            if self._is_free(job, solution.q):
                job.branches.append(solution.branch)
                yield solution.q
            else:
                blocked.append(solution)
        if job.branches:
            return
        for solution in freed(
            self._ik, collision, goal, blocked, q_jaw=request.q_jaw, seed=request.seed
        ):
            job.branches.append(solution.branch)
            yield solution.q
        if not job.branches:
            least = max(
                (solution.q for solution in blocked),
                key=lambda q: collision.clearance(q, request.q_jaw).distance,
            )
            every = f"at the goal, in the best of {len(blocked)} postures,"
            raise job.moves.in_collision(least, "goal", every if len(blocked) > 1 else None)

    def _solutions(self, job: _Job, goal: PoseGoal, q_from: Array) -> Iterator[IkSolution]:
        """All solutions for a pose, nearest first; the time they take is counted."""
        with job.stage("ik"):
            solutions = self._ik.candidates(goal, q_from)
        while True:
            with job.stage("ik"):
                solution = next(solutions, None)
            if solution is None:
                return
            yield solution

    def _along(self, job: _Job, q_from: Array, goal: PathGoal) -> tuple[Array, Pieces]:
        """Through waypoints that were given."""
        with job.stage("path"):
            waypoints = checked_way(self._model, job.moves, q_from, goal.waypoints)
        return waypoints, self._timed(job, waypoints, goal.tolerance, spline=True)

    def _on_line(self, job: _Job, q_from: Array, goal: LineGoal) -> tuple[Array, Pieces]:
        """Along a straight line of the tool."""
        moves = job.moves
        with job.stage("path"):
            line = self._lines.find(goal, q_from, moves.collision, job.request.q_jaw)
        with job.stage("retime"):
            trajectory = line.timed(job.request.limits, job.request.dt)
        with job.stage("verify"):
            job.load = moves.check(trajectory).worst
        return line.waypoints, [trajectory]

    def _timed(self, job: _Job, waypoints: Array, tolerance: float, *, spline: bool) -> Pieces:
        """The first of several ways to time a polyline that passes verification.

        Raises:
            PlanningError: None does, not even stopping at every corner.
        """
        motions = job.moves.motions(waypoints, tolerance, spline=spline)
        problem: PlanningError | None = None
        while True:
            with job.stage("retime"):
                pieces = next(motions, None)
            if pieces is None:
                raise problem or PlanningError("no motion along this path keeps the limits")
            with job.stage("verify"):
                try:
                    job.load = max(job.moves.check(piece).worst for piece in pieces)
                except PlanningError as error:
                    problem = error
                else:
                    return pieces

    def _is_free(self, job: _Job, q: Array) -> bool:
        return job.moves.collision.is_free(q, job.request.q_jaw)

    def _tool_path(self, q: Array) -> Array:
        chosen = np.unique(np.linspace(0, len(q) - 1, _PICTURE_POINTS).astype(int))
        return np.array([self._model.rotation_and_position(q[k])[1].copy() for k in chosen])
