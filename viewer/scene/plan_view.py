"""Compute what to draw of a plan: its path, configurations along it, the closest approach."""

from __future__ import annotations

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.request import Plan

from ..page.screen_state import PathLine, PlanView
from ..page.target_ik import TargetSolver

_GHOSTS = 5
"""Configurations that show the swept motion; chosen: more of them hide the arm."""

_LOOKS = 40
"""Configurations at which the clearance is computed; chosen: takes a few milliseconds."""

_LINE = 60
"""Points of the path of a frame other than the tool; chosen: it looks smooth."""


def plan_view(
    plan: Plan,
    solver: TargetSolver,
    frame: str,
    *,
    scene: Scene,
    q_jaw: float,
    name: str = "Plan",
) -> PlanView:
    """Compute what to draw of a plan: the path of ``frame``, clearances with that jaw angle."""
    trajectory = plan.trajectory
    t = np.linspace(0.0, trajectory.duration, _LOOKS)
    closest = [solver.clearance(q, q_jaw) for q in trajectory.at(t)[0]]
    k = min(range(_LOOKS), key=lambda k: closest[k].distance)
    return PlanView(
        plan=plan,
        path=PathLine(points=_line(plan, solver, frame), planned=True),
        sweep=_spread(plan),
        closest=closest[k],
        t_closest=float(t[k]),
        scene=scene,
        q_jaw=q_jaw,
        name=name,
    )


def _line(plan: Plan, solver: TargetSolver, frame: str) -> Array:
    if frame == "tool":
        return plan.tool_path
    t = np.linspace(0.0, plan.trajectory.duration, _LINE)
    return np.array([solver.point(q, frame) for q in plan.trajectory.at(t)[0]])


def _spread(plan: Plan) -> Array:
    """Configurations equally spaced along the path, not in time."""
    q = plan.trajectory.q
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    places = np.linspace(0.0, length[-1], _GHOSTS + 2)[1:-1]
    return np.asarray(q[np.searchsorted(length, places)])
