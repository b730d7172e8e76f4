"""A planned program of several arms over time: motions, jaws and pauses."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from so101_motion.arm.cell_member import CellMember, Stand
from so101_motion.arm.gripper import JAW_LIMITS
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.apart import clearance_over_time
from so101_motion.planning.collision.course import Course
from so101_motion.tasks.program import CellRehearsal
from so101_motion.tasks.program.cell_run import PlannedStep
from so101_motion.tasks.program.loops import Visit

from ..cell_model import Between
from .rehearsal_time import SHOWN_PAUSE

_LOOKS = 15
"""Instants of a motion at which the clearance is computed; chosen: takes two milliseconds."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Span:
    """A step over time: when it begins, when all arms have arrived, and when it ends [s].

    Once all arms have arrived, jaws go to an angle [rad] in a time [s], by the name of their arm.
    """

    visit: Visit
    index: int  # in the whole program
    begins: float
    arrived: float
    ends: float
    planned: PlannedStep
    jaws: Mapping[str, tuple[float, float]]

    def at(self, t: float) -> dict[str, Stand]:
        """Where the arms stand at a time [s]."""
        found = {}
        for name, stand in self.planned.stands.items():
            plan, (q, q_jaw) = self.planned.plans.get(name), stand
            if plan is not None:
                q = plan.trajectory.sample(min(max(t - self.begins, 0.0), plan.duration)).q
            q_wanted, lasts = self.jaws.get(name, (q_jaw, 0.0))
            if t > self.arrived:
                q_jaw += min((t - self.arrived) / max(lasts, 1e-9), 1.0) * (q_wanted - q_jaw)
            found[name] = Stand(q, q_jaw)
        return found


class CellRehearsalTime:
    """A first round of a planned program, and the first step of the next if there are more.

    Loops are shown twice: the second time stands for all later ones.
    Jaws are assumed to close at full speed; an object in them ends that earlier.

    Args:
        rehearsal: What was planned.
        members: The arms of the cell, by their names.

    Attributes:
        rehearsal: What was planned.
        clearances: The clearance of every two arms over the whole program.
        nearest: How near two arms come to each other in each step of the whole program [m].
    """

    def __init__(self, rehearsal: CellRehearsal, members: Mapping[str, CellMember]) -> None:
        self.rehearsal = rehearsal
        self._spans: list[_Span] = []
        for planned in rehearsal.steps:
            self._add(planned, members)
            if planned.visit.round > 0:
                break
        self._begins = [each.begins for each in self._spans]
        self.clearances = self._between(members)
        self.nearest = self._by_step()

    @property
    def duration(self) -> float:
        """How long all of it takes [s], with pauses as they are shown."""
        return self._spans[-1].ends

    def at(self, t: float) -> tuple[int, dict[str, Stand]]:
        """Which step of the whole program is done, and where the arms stand, at a time [s]."""
        span = self._spans[self._place(t)]
        return span.index, span.at(t)

    def spans(self) -> tuple[tuple[Visit, int, float, float], ...]:
        """The pieces of the line: arrival, index of the step that was planned, begin, end [s]."""
        return tuple(
            (each.visit, each.visit.indices[-1], each.begins, each.ends) for each in self._spans
        )

    def _place(self, t: float) -> int:
        return max(bisect_right(self._begins, t) - 1, 0)

    def _add(self, planned: PlannedStep, members: Mapping[str, CellMember]) -> None:
        index = planned.step_index
        begins = self._spans[-1].ends if self._spans else 0.0
        arrived = begins + planned.duration
        jaws, ends, pace = {}, arrived, float(JAW_LIMITS.velocity[0])
        for name, waypoint in self.rehearsal.program.steps[index].items():
            lasts, q_jaw = 0.0, planned.stands[name].q_jaw
            if waypoint.aperture is not None:
                q_wanted = members[name].gripper.angle_of(waypoint.aperture)
                lasts = abs(q_wanted - q_jaw) / pace
                jaws[name] = q_wanted, lasts
            ends = max(ends, arrived + lasts + min(waypoint.pause, SHOWN_PAUSE))
        self._spans.append(
            _Span(
                visit=planned.visit,
                index=self.rehearsal.program.before + index,
                begins=begins,
                arrived=arrived,
                ends=ends,
                planned=planned,
                jaws=jaws,
            )
        )

    def _between(self, members: Mapping[str, CellMember]) -> tuple[Between, ...]:
        times = np.concatenate(
            [np.linspace(each.begins, each.arrived, _LOOKS, endpoint=False) for each in self._spans]
        )
        times = np.append(times, self.duration)
        stands = [self.at(t)[1] for t in times]
        found = []
        rows = {name: _rows([each[name] for each in stands]) for name in stands[0]}
        for a, b in combinations(rows, 2):
            T = members[a].T_cell_base.inverse @ members[b].T_cell_base
            pair = (members[a].bodies, rows[a]), (members[b].bodies, rows[b])
            looks = clearance_over_time(*pair, T, np.arange(len(times), dtype=np.float64))
            closest = (each._replace(t=float(t)) for each, t in zip(looks, times, strict=True))
            found.append(Between(a, b, tuple(closest)))
        return tuple(found)

    def _by_step(self) -> dict[int, float]:
        found: dict[int, float] = {}
        for between in self.clearances:
            for each in between.closest:
                index = self._spans[self._place(each.t)].index
                found[index] = min(each.distance, found.get(index, np.inf))
        return found


def _rows(stands: list[Stand]) -> Course:
    """The configurations of an arm, as if one second apart."""
    q: Array = np.array([np.append(each.q, each.q_jaw) for each in stands])
    return Course(t=0.0, dt=1.0, q=q)
