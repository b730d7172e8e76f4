"""A planned program over time: motions, jaw and pauses, one after the other."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np

from so101_motion.arm.gripper import JAW_LIMITS
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.collision import Clearance
from so101_motion.planning.request import Plan
from so101_motion.tasks.program import Rehearsal
from so101_motion.tasks.program.loops import Visit
from so101_motion.tasks.program.rehearsal import ProgramLeg

SHOWN_PAUSE = 2.0
"""Longer pauses are shown for this long [s]; chosen."""

_LOOKS = 15
"""Configurations of a step at which the clearance is computed; chosen, a few milliseconds."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Phase:
    """A piece of a rehearsal in which one thing happens.

    Attributes:
        visit: The arrival at a stop that it belongs to.
        index: The waypoint it leads to, or is at.
        begins: When it begins [s].
        ends: When it ends [s].
        q: Where the arm stands if it does not move, shape (5,), [rad].
        plan: What it moves along, from the time ``plan_begins`` [s] of the plan.
        plan_begins: See ``plan``.
        q_jaw: The jaw's angle at the beginning and at the end [rad].
    """

    visit: Visit
    index: int
    begins: float
    ends: float
    q: Array
    q_jaw: tuple[float, float]
    plan: Plan | None = None
    plan_begins: float = 0.0

    def at(self, t: float) -> tuple[Array, float]:
        """Where arm (5,) and jaw are at the time ``t`` [s] of the rehearsal [rad]."""
        share = (t - self.begins) / max(self.ends - self.begins, 1e-9)
        first, last = self.q_jaw
        q_jaw = first + min(max(share, 0.0), 1.0) * (last - first)
        if self.plan is None:
            return self.q, q_jaw
        t_plan = min(max(t - self.begins, 0.0) + self.plan_begins, self.plan.duration)
        return self.plan.trajectory.sample(t_plan).q, q_jaw


class RehearsalTime:
    """A first round of a planned program, and the way back to the first stop if there are more.

    Loops are shown twice: the second time stands for all later ones. The jaw is assumed to move at
    full speed; an object in it ends that earlier.

    Args:
        rehearsal: What was planned.
        angle_of: The jaw's angle [rad] for an aperture.
    """

    def __init__(self, rehearsal: Rehearsal, angle_of: Callable[[float], float]) -> None:
        self.rehearsal = rehearsal
        self._angle_of = angle_of
        self._phases: list[Phase] = []
        self._q, self._q_jaw = rehearsal.q_start, rehearsal.q_jaw_start
        for visit, leg, _ in rehearsal.visits:
            self._visit = visit
            self._add_leg(leg)
            if visit.round > 0:
                break
            self._add_stop(leg.indices[-1])

    @property
    def duration(self) -> float:
        """How long all of it takes [s], with pauses as they are shown."""
        return self._phases[-1].ends if self._phases else 0.0

    def at(self, t: float) -> tuple[int, Array, float]:
        """The waypoint that is gone to, the arm (5,) and the jaw [rad] at a time [s]."""
        if not self._phases:
            return 0, self._q, self._q_jaw
        place = bisect_right([each.begins for each in self._phases], max(t, 0.0)) - 1
        phase = self._phases[place]
        return (phase.index, *phase.at(t))

    def spans(self) -> tuple[tuple[Visit, int, float, float], ...]:
        """The pieces of the timeline: arrival, index of the waypoint, begin and end [s]."""
        pieces = groupby(self._phases, lambda phase: (phase.visit, phase.index))
        together = ([*phases] for _, phases in pieces)
        return tuple(
            (each[0].visit, each[0].index, each[0].begins, each[-1].ends) for each in together
        )

    def clearances(self, clearance: Callable[[Array, float], Clearance]) -> dict[int, float]:
        """How near the arm comes to anything on the way to each waypoint [m]."""
        nearest: dict[int, float] = {}
        for phase in self._phases:
            if phase.plan is not None:
                looks = (phase.at(t) for t in np.linspace(phase.begins, phase.ends, _LOOKS))
                found = min(clearance(q, q_jaw).distance for q, q_jaw in looks)
                nearest[phase.index] = min(found, nearest.get(phase.index, np.inf))
        return nearest

    def _add(
        self, index: int, lasts: float, q_jaw: float, plan: Plan | None = None, begins: float = 0.0
    ) -> None:
        now = self.duration
        phase = Phase(
            visit=self._visit,
            index=index,
            begins=now,
            ends=now + lasts,
            q=self._q,
            q_jaw=(self._q_jaw, q_jaw),
            plan=plan,
            plan_begins=begins,
        )
        if lasts > 0.0:
            self._phases.append(phase)

    def _add_leg(self, leg: ProgramLeg) -> None:
        if leg.plan is None:
            return
        for index, (begins, ends) in zip(leg.indices, pairwise((0.0, *leg.at)), strict=True):
            self._add(index, ends - begins, self._q_jaw, leg.plan, begins)
        self._q = leg.plan.q_goal

    def _add_stop(self, index: int) -> None:
        waypoint = self.rehearsal.program.waypoints[index]
        if waypoint.aperture is not None:
            q_jaw = self._angle_of(waypoint.aperture)
            pace = float(JAW_LIMITS.velocity[0])
            self._add(index, abs(q_jaw - self._q_jaw) / pace, q_jaw)
            self._q_jaw = q_jaw
        self._add(index, min(waypoint.pause, SHOWN_PAUSE), self._q_jaw)
