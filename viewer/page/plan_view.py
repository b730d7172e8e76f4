"""A plan as it is drawn: its path, configurations along it, the closest approach, the ghost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from itertools import combinations
from typing import NamedTuple

import numpy as np

from so101_motion.arm.cell_member import CellMember
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.apart import Meeting, clearance_over_time
from so101_motion.planning.collision.collision import Clearance
from so101_motion.planning.collision.course import Course
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.request import Plan

from .target_ik import TargetSolver

_GHOSTS = 5  # configurations that show the swept motion; chosen: more of them hide the arm
_LOOKS = 40  # configurations at which the clearance is computed; chosen: takes a few milliseconds
_LINE = 60  # points of the path of a frame other than the tool; chosen: it looks smooth
RATES = (0.25, 0.5, 1.0, 2.0)  # how fast a plan can be played, against the time it takes the arm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathLine:
    """The tool's path to the target, or a guess of it: shape (k, 3), [m], in the base frame."""

    points: Array
    planned: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanView:
    """A plan and what is drawn of it."""

    plan: Plan
    path: PathLine  # the line of the frame that the target is for
    sweep: Array  # configurations along the path, both ends left out, shape (k, 5), [rad]
    # the closest approach of two bodies anywhere on the path, at t_closest [s]
    closest: Clearance
    t_closest: float
    scene: Scene  # what was around the arm
    q_jaw: float  # jaw angle [rad]
    name: str = "Plan"  # what the page calls it, such as ``"Plan 3"``
    made_at: datetime = field(default_factory=datetime.now)

    @property
    def duration(self) -> float:
        """How long the plan takes [s]."""
        return self.plan.duration


class Between(NamedTuple):
    """The clearance between two arms over the time of their plans: their closest bodies at each."""

    first: str
    second: str
    closest: tuple[Meeting, ...]

    @property
    def least(self) -> Meeting:
        return min(self.closest, key=lambda each: each.distance)


def clearances(
    members: Mapping[str, CellMember], courses: Mapping[str, Course], times: Array
) -> tuple[Between, ...]:
    """The clearance of every two arms of a cell on their courses, at times [s]."""
    found = []
    for a, b in combinations(courses, 2):
        T = members[a].T_cell_base.inverse @ members[b].T_cell_base
        pair = (members[a].bodies, courses[a]), (members[b].bodies, courses[b])
        found.append(Between(a, b, tuple(clearance_over_time(*pair, T, times))))
    return tuple(found)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CommonPlan:
    """A plan for all arms, by their names, with the clearance of every two arms."""

    plans: Mapping[str, Plan]
    clearances: tuple[Between, ...] = ()
    name: str = ""

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return max(each.duration for each in self.plans.values())


def plan_view(
    plan: Plan, solver: TargetSolver, frame: str, *, scene: Scene, q_jaw: float, name: str = "Plan"
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


class Playback:
    """A place on a timeline that is dragged or plays."""

    def __init__(self) -> None:
        self.t = 0.0
        self._duration = 0.0
        self._rate: float | None = None
        self._seen: float | None = None

    def load(self, duration: float) -> None:
        """Load a plan of ``duration`` [s]; pauses at its end."""
        self.t = self._duration = duration
        self._rate = None

    def seek(self, t: float) -> None:
        """Pause at ``t`` [s]."""
        self.t = min(max(t, 0.0), self._duration)
        self._rate = None

    def play(self, rate: float) -> None:
        """Play at ``rate``, from the beginning if it is at the end; the same rate pauses it."""
        if self._rate == rate:
            self._rate = None
            return
        if self.t >= self._duration:
            self.t = 0.0
        self._rate, self._seen = rate, None

    def advance(self, now: float) -> bool:
        """Advance to the time ``now`` [s] while it plays; return whether it moved."""
        if self._rate is None:
            return False
        before, self._seen = self._seen, now
        if before is None:
            return True
        self.t = min(self.t + self._rate * (now - before), self._duration)
        if self.t >= self._duration:
            self._rate = None
        return True
