"""Search long for the shortest common motion of several arms, to compare a quick plan with.

The planner takes the first motion that it can prove. This goes on: for as much processor time as it
is given it plans the same task again and again, and keeps the shortest motion. Four kinds of tries,
in turn:

*another seed*: the planner itself (``plan_together``), with other random choices;
*as one*: its search of one path for all joints, which it tries last, with other random choices;
*detours*: each arm, or one of them, goes through a random configuration about halfway; the
planner's first two methods order them in time, all at once and one after the other;
*nearby*: the best detours so far, changed a little, by steps that become smaller.

Every motion is proven as the planner proves its own, and ``accept`` may refuse it by other means.
It ends early at a bound that nothing can beat: the time that one arm takes alone in a straight
line of its joints, if its caps are the same for all of them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import Array
from so101_motion.planning.cell import together
from so101_motion.planning.cell.team_requests import TeamMember
from so101_motion.planning.goals import JointGoal, PathGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import CORNER, Planner
from so101_motion.planning.request import Plan

Plans = Mapping[str, Plan]
Detours = tuple[Array | None, ...]
"""A configuration on the way of each arm, None for none."""

WIDE, NARROW = 0.6, 0.05
"""Standard deviation of a detour from halfway, and of the last changes to one [rad]; chosen."""

TRIED = 1.0
"""Longest single search for a path [s]; chosen, so that there are many."""


def makespan(plans: Plans) -> float:
    """When the last arm arrives [s]."""
    return max(each.duration for each in plans.values())


@dataclass
class Found:
    """The result of a search.

    Attributes:
        best: The shortest motion that was found; the one to begin with if none is shorter.
        by: The kind of try that found it.
        tries: How many tries of each kind there were.
        refused: How many shorter motions ``accept`` has refused.
        at_bound: Whether nothing can be shorter.
    """

    best: Plans
    by: str = "the plan itself"
    tries: dict[str, int] = field(default_factory=dict)
    refused: int = 0
    at_bound: bool = False


class LongSearch:
    """Searches for shorter motions than a given one.

    Args:
        planner: Plans.
        team: The task, with joint angles as goals.
        accept: Whether a motion is good, judged by other means.
        seed: Seed of all random choices.
    """

    def __init__(
        self,
        planner: Planner,
        team: Sequence[TeamMember],
        accept: Callable[[Plans], bool],
        seed: int,
    ) -> None:
        self._planner, self._accept = planner, accept
        self._team = [
            replace(each, request=replace(each.request, time_budget=TRIED)) for each in team
        ]
        self._random, self._model = np.random.default_rng(seed), RobotModel.load()
        self._detours: Detours = (None,) * len(team)  # the best so far
        self._by_detours = math.inf  # how long the motion by way of them takes [s]

    def run(self, first: Plans, seconds: float) -> Found:
        """Search for so much processor time; ``first`` is the motion to beat."""
        found, bound = Found(first), self._bound()
        kinds: dict[str, Callable[[int, float], Plans | None]] = {
            "another seed": self._another_seed,
            "as one": self._as_one,
            "detours": self._anywhere,
            "nearby": self._nearby,
        }
        begin, number = time.process_time(), 0
        while True:
            spent = time.process_time() - begin
            found.at_bound = makespan(found.best) <= bound + 1e-9
            if spent >= seconds or found.at_bound:
                return found
            number += 1
            for name, attempt in kinds.items():
                found.tries[name] = found.tries.get(name, 0) + 1
                with suppress(PlanningError):
                    plans = attempt(number, min(spent / seconds, 1.0))
                    if plans is None or makespan(plans) >= makespan(found.best) - 1e-9:
                        continue
                    if self._accept(plans):
                        found.best, found.by = plans, name
                    else:
                        found.refused += 1

    def _bound(self) -> float:
        """The longest time that an arm takes alone in a straight line [s]; 0 if none goes so."""
        longest = 0.0
        for member in self._team:
            caps = member.request.limits
            alike = all(np.ptp(each) == 0.0 for each in (caps.velocity, caps.acceleration))
            with suppress(PlanningError):
                plan = self._planner.plan(member.request)
                if alike and plan.report.straight and not plan.report.departure:
                    longest = max(longest, plan.duration)
        return longest

    def _seeded(self, number: int) -> list[TeamMember]:
        return [replace(each, request=replace(each.request, seed=number)) for each in self._team]

    def _another_seed(self, number: int, _share: float) -> Plans:
        return together.plan_together(self._planner, self._seeded(number))

    def _as_one(self, number: int, _share: float) -> Plans:
        return together._as_one(self._planner, self._seeded(number), math.inf)

    def _anywhere(self, number: int, _share: float) -> Plans | None:
        some = self._random.random(len(self._team)) < 0.6
        some[self._random.integers(len(some))] = True
        detours = tuple(
            self._halfway(each) + self._random.normal(0.0, WIDE, 5) if detour else None
            for each, detour in zip(self._team, some, strict=True)
        )
        return self._by(detours, number)

    def _nearby(self, number: int, share: float) -> Plans | None:
        spread = WIDE * (NARROW / WIDE) ** share
        detours = tuple(
            (self._halfway(member) if detour is None else detour)
            + self._random.normal(0.0, spread, 5)
            if detour is not None or self._random.random() < 0.3
            else None
            for member, detour in zip(self._team, self._detours, strict=True)
        )
        return self._by(detours, number)

    def _by(self, detours: Detours, number: int) -> Plans | None:
        """The shortest motion by way of these configurations; None if there is none."""
        plans = self._ordered(detours, number)
        if plans is not None and makespan(plans) < self._by_detours:
            self._detours, self._by_detours = detours, makespan(plans)
        return plans

    def _ordered(self, detours: Detours, number: int) -> Plans | None:
        team = []
        for member, detour in zip(self._seeded(number), detours, strict=True):
            if detour is not None:
                way = np.clip(detour, self._model.lower, self._model.upper)
                goal = PathGoal(waypoints=np.array([way, _goal(member)]), tolerance=CORNER)
                member = replace(member, request=replace(member.request, goal=goal))
            team.append(member)
        alone = [self._planner.plan(each.request) for each in team]
        at_once = together._at_once(team, alone)
        if at_once is not None:
            return at_once
        in_turn = together._in_turn(self._planner, team, alone, math.inf)
        for plans in sorted(in_turn, key=together._makespan):
            proven = together._proven(team, plans, [each.trajectory for each in plans])
            if proven is not None:
                return proven
        return None

    def _halfway(self, member: TeamMember) -> Array:
        middle: Array = 0.5 * (member.request.q_start + _goal(member))
        return middle


def _goal(member: TeamMember) -> Array:
    goal = member.request.goal
    assert isinstance(goal, JointGoal)
    return goal.q
