"""A planned program over time: motions, jaws and pauses, one after the other."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from so101_motion.arm.cell import Cell
from so101_motion.arm.cell_member import Stand
from so101_motion.arm.gripper import JAW_LIMITS
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.collision import Clearance
from so101_motion.planning.collision.course import Course
from so101_motion.tasks.program import ARM, Arms, Rehearsal
from so101_motion.tasks.program.loops import Visit
from so101_motion.tasks.program.rehearsal import Arrival, Leg

from ..page.plan_view import Between, clearances

SHOWN_PAUSE = 2.0  # longer pauses are shown for this long [s]; chosen

_LOOKS = 15
"""Instants of a step at which the clearance is computed; chosen: takes a few milliseconds."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Span:
    """A leg over time: when it begins, when all arms have arrived, and when it ends [s].

    Once all arms have arrived, jaws go to an angle [rad] in a time [s], by the name of their arm.
    """

    visit: Visit
    leg: Leg
    begins: float
    arrived: float
    ends: float
    jaws: Mapping[str, tuple[float, float]]

    def index_at(self, t: float) -> int:
        """Which step of the planned program is done at a time [s]."""
        return self.leg.indices[bisect_right(self.leg.at[:-1], t - self.begins)]

    def at(self, t: float) -> dict[str, Stand]:
        """Where the arms stand at a time [s]."""
        found = {}
        for name, (q, q_jaw) in self.leg.stands.items():
            plan = self.leg.plans.get(name)
            if plan is not None:
                q = plan.trajectory.sample(min(max(t - self.begins, 0.0), plan.duration)).q
            q_wanted, lasts = self.jaws.get(name, (q_jaw, 0.0))
            if name in self.leg.picks and t > self.arrived:
                q, q_jaw = self.leg.picks[name].at(t - self.arrived)
            elif t > self.arrived:
                q_jaw += min((t - self.arrived) / max(lasts, 1e-9), 1.0) * (q_wanted - q_jaw)
            found[name] = Stand(q, q_jaw)
        return found


class RehearsalTime:
    """A first round of a planned program, and the way back to the first stop if there are more.

    Loops are shown twice: the second time stands for all later ones. Jaws are assumed to move at
    full speed; an object in one ends that earlier.

    Attributes:
        between: The clearance of every two arms over the whole program.
        nearest: How near one arm comes to anything, by ``clearance``, or two arms to each other, in
            each step of the whole program [m].
    """

    def __init__(
        self,
        rehearsal: Rehearsal,
        arms: Arms,
        clearance: Callable[[Array, float], Clearance] | None = None,
    ) -> None:
        self.rehearsal = rehearsal
        self._spans: list[_Span] = []
        for each in rehearsal.arrivals:
            self._add(each, arms)
            if each.visit.round > 0:
                break
        self._begins = [each.begins for each in self._spans]
        looks = [  # instants at which arms move [s], and the end
            np.linspace(each.begins, each.arrived, _LOOKS * len(each.leg.at), endpoint=False)
            for each in self._spans
            if each.leg.plans
        ]
        times = np.concatenate([*looks, [self.duration]])
        stands = [self.at(t)[1] for t in times]
        self.between = _between(arms, times, stands) if isinstance(arms, Cell) else ()
        closest = [(each.t, each.distance) for pair in self.between for each in pair.closest]
        if clearance is not None:
            seen = ((t, each[ARM]) for t, each in zip(times, stands, strict=True))
            closest = [(float(t), clearance(*stand).distance) for t, stand in seen]
        self.nearest: dict[int, float] = {}
        for t, distance in closest:
            index, _ = self.at(t)
            self.nearest[index] = min(distance, self.nearest.get(index, np.inf))

    @property
    def duration(self) -> float:
        """How long all of it takes [s], with pauses as they are shown."""
        return self._spans[-1].ends

    def at(self, t: float) -> tuple[int, dict[str, Stand]]:
        """Which step of the whole program is done, and where the arms stand, at a time [s]."""
        span = self._spans[max(bisect_right(self._begins, t) - 1, 0)]
        return self.rehearsal.program.before + span.index_at(t), span.at(t)

    def pieces(self) -> tuple[tuple[Visit, int, float, float], ...]:
        """The pieces of the line: arrival, index of the step that was planned, begin, end [s]."""
        found = []
        for each in self._spans:
            at = (each.begins, *(each.begins + t for t in each.leg.at[:-1]), each.ends)
            for index, (begins, ends) in zip(each.leg.indices, pairwise(at), strict=True):
                found.append((each.visit, index, begins, ends))
        return tuple(found)

    def _add(self, arrival: Arrival, arms: Arms) -> None:
        leg = arrival.leg
        begins = self._spans[-1].ends if self._spans else 0.0
        ends = arrived = begins + leg.at[-1]
        jaws, pace = {}, float(JAW_LIMITS.velocity[0])
        stop = self.rehearsal.program.steps[leg.indices[-1]] if arrival.visit.round == 0 else {}
        for name, each in stop.items():
            lasts, gripper = 0.0, arms.members[name].gripper
            if gripper is not None and each.aperture is not None:
                q_wanted = gripper.angle_of(each.aperture)
                lasts = abs(q_wanted - leg.stands[name].q_jaw) / pace
                jaws[name] = q_wanted, lasts
            elif name in leg.picks:
                lasts = leg.picks[name].duration
            ends = max(ends, arrived + lasts + min(each.pause, SHOWN_PAUSE))
        self._spans.append(
            _Span(
                visit=arrival.visit, leg=leg, begins=begins, arrived=arrived, ends=ends, jaws=jaws
            )
        )


def _between(arms: Cell, times: Array, stands: list[dict[str, Stand]]) -> tuple[Between, ...]:
    rows = {name: _rows([each[name] for each in stands]) for name in stands[0]}
    found = clearances(arms.members, rows, np.arange(len(times), dtype=np.float64))
    return tuple(
        pair._replace(
            closest=tuple(
                each._replace(t=float(t)) for each, t in zip(pair.closest, times, strict=True)
            )
        )
        for pair in found
    )


def _rows(stands: list[Stand]) -> Course:
    """The configurations of an arm, as if one second apart."""
    q: Array = np.array([np.append(each.q, each.q_jaw) for each in stands])
    return Course(t=0.0, dt=1.0, q=q)
