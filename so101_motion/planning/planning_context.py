"""State of the planner for one request: solvers, stage times and figures for the report."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

from so101_motion.common.geometry import Array
from so101_motion.planning.cartesian.cartesian import CartesianPlanner
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.motion_builder import MotionBuilder, Pieces
from so101_motion.planning.paths.path import FreePath, PathFinder
from so101_motion.planning.paths.routes import Routing
from so101_motion.planning.request import PathDeviation, PlanRequest


@dataclass(slots=True, kw_only=True)
class PlanningContext:
    """The request that is being planned."""

    request: PlanRequest  # the request
    model: RobotModel  # the arm with its own joint limits and frames
    ik: IkSolver  # inverse kinematics for it
    lines: CartesianPlanner  # plans lines and arcs of its tool
    moves: MotionBuilder  # makes and checks motions
    finder: PathFinder  # finds collision-free paths
    stages_ms: dict[str, float] = field(default_factory=dict)  # wall time of each stage so far [ms]
    effort: float = 0.0  # largest share of a servo's torque that is used
    # how far the tool is from a prescribed path, if there is one
    path_deviation: PathDeviation | None = None
    routes: int = 0  # how many routes were compared
    out_of_time: bool = False  # whether the time budget ended that
    _inner_ms: float = 0.0

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the time spent in this block, without that of stages within it."""
        self.moves.collision.checkpoint()
        outer_ms, self._inner_ms = self._inner_ms, 0.0
        begin = time.perf_counter()
        try:
            yield
        finally:
            spent_ms = (time.perf_counter() - begin) * 1e3
            own_ms = spent_ms - self._inner_ms
            self.stages_ms[name] = self.stages_ms.get(name, 0.0) + own_ms
            self._inner_ms = outer_ms + spent_ms

    def find(self, q_from: Array, goals: Iterator[Array]) -> FreePath:
        """A free path to one of the goals, as quick as the request's effort finds."""
        request, routing = self.request, None
        if request.limits.tool_speed is None:  # under such a cap other routes are quick
            routing = partial(Routing.within, request.limits, request.route_effort)
        found = self.finder.find(q_from, goals, request.time_budget, routing)
        self.routes, self.out_of_time = found.routes, found.out_of_time
        return found

    def check(self, pieces: Pieces) -> None:
        """Check motions, and note how much torque they use; raises if one fails."""
        self.effort = max(self.effort, *(self.moves.check(piece).effort for piece in pieces))

    def is_free(self, q: Array) -> bool:
        """Whether joint angles ``q``, shape (5,), [rad], are free of contact."""
        return self.moves.collision.is_free(q, self.request.q_jaw)
