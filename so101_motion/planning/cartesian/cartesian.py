"""Turn a tool path into smooth joint curves.

How it works. A line prescribes every point of the tool's path; five joints leave the pitch free,
for some goals the roll, and the side to which the elbow bends. These are chosen for the whole line
at once:

1. *List* configurations in columns, one column about each centimetre
   (``configuration_columns.py``).
2. *Search* them for the best sequence from the start to the end (``ladder_graph.py``).
3. *Check* the sequence for contact. Configurations in contact are forbidden, and the search is
   repeated; if that does not soon help, all configurations that might still be used are checked.
4. *Fit a smooth curve* through it along which the tool keeps to its path (``curve_fit.py``).

If a search finds nothing, a finer one follows (``path_search.py`` is one search). If the finest
finds nothing either, the error says how far the path can be followed, to the millimetre, and what
stops the arm there: from the last column that is reached the path is followed in steps of half a
millimetre, with every configuration near one before it, until none is left.

``exact_retiming.py`` then times the curves.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.errors import InCollision, PlanningError, Unreachable
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_deg, to_mm
from so101_motion.planning.cartesian.configuration_columns import Columns, Resolution
from so101_motion.planning.cartesian.curve_fit import FitFailure
from so101_motion.planning.cartesian.ladder_graph import are_near
from so101_motion.planning.cartesian.path_search import PathSearch, PathTask, ToolMotion, Tools
from so101_motion.planning.cartesian.tool_path import LEVER, ToolPath, path_through, straight_path
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.goals import GoalMetric, LineGoal, PoseGoal, ToolGoal, ToolPathGoal
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.ik_task import check_goal, limit_name

LOOKS = (
    Resolution(spacing=0.0125, pitch_step=math.radians(5.0), offsets=9, rolls=1),
    Resolution(spacing=0.005, pitch_step=math.radians(2.0), offsets=9, rolls=9),
    Resolution(spacing=0.0025, pitch_step=math.radians(1.0), offsets=13, rolls=13),
)
"""The resolutions of the searches, one after the other. Chosen: benchmarks/bench_line.py."""

STILL = 1e-6  # a tool that turns by less than this does not turn [rad]. Chosen


class CartesianPlanner:
    """Finds joint motions for lines and paths of the tool. Belongs to one thread."""

    def __init__(self, ik: IkSolver) -> None:
        self._ik = ik
        self._chain = lru_cache(maxsize=8)(lambda frame: ArmChain(ik.model, frame))

    @property
    def tool(self) -> ArmChain:
        """Kinematics of the tool point."""
        return self._chain("tool")

    def find(
        self, goal: ToolGoal, q_start: Array, collision: CollisionModel, q_jaw: float
    ) -> ToolMotion:
        """Find joint curves along which the tool follows the goal's path, free of contact.

        The path starts at ``q_start``, a free configuration (5,) [rad] inside the limits.

        Raises:
            Unreachable: The path cannot be followed to its end; says for how many millimetres it
                can, and what stops the arm there.
            InCollision: It can be followed, but not free of contact.
            ConfigError: The goal holds numbers that are not valid.
        """
        found = self._look(goal, q_start, collision, q_jaw)
        if isinstance(found, ToolMotion):
            return found
        raise refusal(self._ik, found)

    def find_if_any(
        self, goal: ToolGoal, q_start: Array, collision: CollisionModel, q_jaw: float
    ) -> ToolMotion | None:
        """Like :meth:`find`, but None if the path cannot be followed; saves finding out why."""
        found = self._look(goal, q_start, collision, q_jaw)
        return found if isinstance(found, ToolMotion) else None

    def _look(
        self, goal: ToolGoal, q_start: Array, collision: CollisionModel, q_jaw: float
    ) -> ToolMotion | PathSearch:
        """The motion; or the finest search, if none found one."""
        tools = self._tools(goal.frame)
        tool_path = self._tool_path(goal, q_start)
        if tool_path.spin and (goal.metric is GoalMetric.POSITION_ONLY or tool_path.turn < STILL):
            return ToolMotion(q_start=q_start, curves=(), off=0.0, turned=0.0)
        task = PathTask(
            goal=goal, tool_path=tool_path, q_start=q_start, collision=collision, q_jaw=q_jaw
        )
        for resolution in LOOKS:
            search = PathSearch(tools, task, resolution)
            found = search.run()
            if found is not None:
                return found
        return search

    def _tools(self, frame: str) -> Tools:
        return Tools(
            ik=self._ik,
            structure=self._ik.structure,
            chain=self._chain(frame),
            tool_chain=self.tool,
        )

    def _tool_path(self, goal: ToolGoal, q_start: Array) -> ToolPath:
        """The path of a goal that has been checked."""
        if isinstance(goal, LineGoal):
            poses = [goal.T_base_tool]
        else:
            poses = [segment.T_base_tool for segment in goal.segments]
        for T_base_tool in poses:
            pose = PoseGoal(T_base_tool=T_base_tool, metric=goal.metric, frame=goal.frame)
            check_goal(self._ik.model, pose)
        T_start = self._ik.model.frame(q_start, goal.frame)
        if isinstance(goal, LineGoal):
            return straight_path(T_start, goal.T_base_tool)
        return path_through(T_start, goal.segments, goal.blend)


STEP = 0.0005  # step in which the path is followed [m]. Chosen: messages are in whole millimetres

NEAR = 0.15
"""Largest change of the joints but the pan in one step [rad]. Chosen: half a millimetre takes a
tenth of that, except near singular configurations."""

PAN_NEAR = 0.6  # the same for the pan, as in half a millimetre beside its axis
NEAR_END = 0.010  # if a point so soon after the end is out of reach, that is the reason [m]. Chosen

_ADVICE = "end it earlier, or start it from another configuration"
_SINGULAR = "a singular configuration, past which the joints would have to turn over at once"


class _End(NamedTuple):
    """The end of the part of a path that can be followed."""

    s: float  # how far along the path it is [m]
    q: Array  # configurations there, shape (k, 5), k >= 1, [rad]
    # configurations of the next point; None if they are not the reason
    ahead: Columns | None = None
    # why no curve can be fitted any further, if that is the reason
    fit_failure: FitFailure | None = None


def refusal(ik: IkSolver, search: PathSearch) -> PlanningError:
    """The error for a path that even the finest search, ``search``, could not follow."""
    end = _followed(search)
    task = search.task
    done_so_far = _progress(search, end.s)
    fraction = min(end.s / task.tool_path.length, 1.0)
    blocked = _blocked(end)
    if blocked is not None:
        closest = task.collision.clearance(blocked, task.q_jaw)
        return InCollision(
            f"{done_so_far}, then {closest.message()} ({to_mm(closest.margin):.0f} mm must stay"
            f" free); {_ADVICE}",
            first=closest.first,
            second=closest.second,
            where="path",
            fraction=fraction,
        )
    limit, turned = _limit(ik, search, end)
    why = f"stopped by {limit}" if limit else f"turned off by {to_deg(turned):.1f} deg"
    allowed = to_deg(task.goal.orientation_tolerance)
    more = "" if limit else f", and {allowed:.1f} deg are allowed"
    return Unreachable(
        f"{done_so_far}: there it is {why}{more}; {_ADVICE}",
        error_position=task.tool_path.length - end.s,
        error_angle=turned,
        p_base_nearest=task.tool_path.places(np.array([end.s]))[0],
        q_nearest=end.q[0],
        limit=limit,
        fraction=fraction,
    )


def _progress(search: PathSearch, s: float) -> str:
    """How far the path can be followed, in words."""
    tool_path, goal = search.task.tool_path, search.task.goal
    if tool_path.spin:
        turned, all_of_it = to_deg(s / LEVER), to_deg(tool_path.length / LEVER)
        return f"the {goal.frame} can do {turned:.0f} of the {all_of_it:.0f} deg of the turn"
    done, length = to_mm(s), to_mm(tool_path.length)
    if not isinstance(goal, ToolPathGoal):
        return f"the {goal.frame} can follow {done:.0f} of the {length:.0f} mm of the line"
    return (
        f"the {goal.frame} can follow {done:.0f} of the {length:.0f} mm of the path, into segment"
        f" {tool_path.segment_at(s) + 1} of {tool_path.segments}"
    )


def _followed(search: PathSearch) -> _End:
    """Follow the path from the last column that is reached, as far as possible."""
    column, q_reached = search.farthest()
    reached = float(search.s[column])
    if column == len(search.s) - 1:
        # Every column is reached, but no curve can be fitted through them.
        fit_failure = min(search.fit_failures, key=lambda each: each.s, default=None)
        return _End(fit_failure.s if fit_failure else reached, q_reached, fit_failure=fit_failure)
    q, here = q_reached, reached
    for ahead in search.s[column + 1 :]:
        s = np.arange(here + STEP, ahead + STEP, STEP)
        columns = search.columns(s)
        for i, each in enumerate(s):
            point = columns.at(i)
            allowed = point.allowed()[0].q
            next_q = [near for near in allowed[_near(q, allowed)] if search.task.is_free(near)]
            if not next_q:
                return _End(here, q, point)
            q, here = np.array(next_q), float(each)
    # Small steps pass a point where a whole motion would have to turn over at once.
    return _End(reached, q_reached)


def _near(q: Array, others: Array) -> NDArray[np.bool_]:
    """Which of ``others`` (m, 5) are near any of ``q`` (k, 5)."""
    return np.asarray(are_near(q, others, NEAR, PAN_NEAR).any(axis=0))


def _blocked(end: _End) -> Array | None:
    """A configuration in contact that would be needed next, or None."""
    if end.fit_failure is not None and end.fit_failure.in_contact:
        return end.fit_failure.q
    if end.ahead is None:
        return None
    needed = end.ahead.allowed()[0].q
    near = needed[_near(end.q, needed)]
    return near[0] if len(near) else None


def _limit(ik: IkSolver, search: PathSearch, end: _End) -> tuple[str | None, float]:
    """The name of the limit that stops the arm, or None and the tool's orientation error [rad]."""
    task = search.task
    if not task.tool_path.spin:
        until = min(task.tool_path.length, end.s + NEAR_END)
        for p in task.tool_path.places(np.linspace(end.s, until, 11)):
            task.collision.checkpoint()
            try:
                ik.solve(PoseGoal.at_point(p, frame=task.goal.frame), end.q[0])
            except Unreachable as error:
                return error.limit, 0.0
    if end.fit_failure is not None and end.fit_failure.turned:
        return None, end.fit_failure.turned
    if end.ahead is None:
        return _SINGULAR, 0.0
    q, _, excess, deviation, _ = (values[0] for values in end.ahead)
    off = np.maximum(deviation - task.goal.orientation_tolerance, 0.0)
    beyond = np.where(_near(end.q, q), np.maximum(excess, 0.0) + off, np.inf)
    least = int(np.argmin(beyond))
    if not np.isfinite(beyond[least]):
        return _SINGULAR, 0.0
    if excess[least] > 0.0:
        over, under = q[least] - ik.model.upper, ik.model.lower - q[least]
        i = int(np.argmax(np.maximum(over, under)))
        return limit_name(i, 1.0 if over[i] > under[i] else -1.0), 0.0
    return None, float(deviation[least])
