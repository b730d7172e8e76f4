"""Explain how far a tool path can be followed, and what stops the arm there.

How it works. The failed search knows the last column of configurations that is reached. From there
the path is followed in steps of half a millimetre, with every configuration that is near one before
it, until none is left. The configurations that would be needed next show what stops the arm: one in
contact, one beyond a joint limit, one that turns the tool off too far, or none at all, because the
point itself is out of reach.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.errors import InCollision, PlanningError, Unreachable
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_deg, to_mm
from so101_motion.planning.cartesian.configuration_columns import Columns
from so101_motion.planning.cartesian.curve_fit import FitFailure
from so101_motion.planning.cartesian.ladder_graph import are_near
from so101_motion.planning.cartesian.path_search import PathSearch
from so101_motion.planning.cartesian.tool_path import LEVER
from so101_motion.planning.goals import PoseGoal, ToolPathGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.ik_task import limit_name

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
