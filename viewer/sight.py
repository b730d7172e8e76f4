"""What there is to see of a plan: its line, postures on the way, and where it comes close."""

from __future__ import annotations

import numpy as np

from so101_motion.geometry import Array
from so101_motion.planning.plan import Plan

from .aim import Aimer
from .screen import PlanSight, Way

_GHOSTS = 5
"""Postures that show the swept motion; chosen: more of them hide the arm."""

_LOOKS = 40
"""At so many places on the way it is looked how near bodies come; chosen, a few milliseconds."""

_LINE = 60
"""Points of the line of a frame other than the tool; chosen, it looks smooth."""


def sight(plan: Plan, aimer: Aimer, frame: str, q_jaw: float) -> PlanSight:
    """Look at ``plan``.

    Args:
        plan: The plan.
        aimer: Knows the arm and what is around it.
        frame: Whose line is drawn.
        q_jaw: Jaw angle on the way [rad].
    """
    trajectory = plan.trajectory
    t = np.linspace(0.0, trajectory.duration, _LOOKS)
    closest = [aimer.clearance(q, q_jaw) for q in trajectory.at(t)[0]]
    k = min(range(_LOOKS), key=lambda k: closest[k].distance)
    return PlanSight(
        plan=plan,
        way=Way(points=_line(plan, aimer, frame), planned=True),
        sweep=_spread(plan),
        closest=closest[k],
        t_closest=float(t[k]),
    )


def _line(plan: Plan, aimer: Aimer, frame: str) -> Array:
    if frame == "tool":
        return plan.tool_path
    t = np.linspace(0.0, plan.trajectory.duration, _LINE)
    return np.array([aimer.point(q, frame) for q in plan.trajectory.at(t)[0]])


def _spread(plan: Plan) -> Array:
    """Postures that are equally far from each other along the way, not in time."""
    q = plan.trajectory.q
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    places = np.linspace(0.0, way[-1], _GHOSTS + 2)[1:-1]
    return np.asarray(q[np.searchsorted(way, places)])
