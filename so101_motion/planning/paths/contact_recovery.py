"""Use a goal's free degrees of freedom to move a configuration out of contact.

Candidates from inverse kinematics are spread over pitch and roll some degrees apart. If only a
narrow range of them is free, all candidates may miss it. So if none is free, the best ones are
improved by hill climbing: their joint angles are varied a little at random, solved for the goal
again from there, and kept if they have more clearance; steps without gain become smaller.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from so101_motion.common.errors import Unreachable
from so101_motion.common.geometry import Array
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.goals import PoseGoal
from so101_motion.planning.kinematics.ik import IkSolution, IkSolver

LARGEST_LACK = 0.015
"""Configurations that lack more clearance than this are not tried [m]. Chosen: the motion of the
gripper's edge by a step of pitch or roll between candidates."""

APART = 0.3
"""Improved candidates differ by this in some joint [rad], so that they reach different maxima."""

CLIMBERS = 12
STEPS = 25
"""Number of candidates to improve, and of variations of each. Chosen: 50 ms at most."""

_FIRST_STEP = 0.1
_SMALLER = 0.8


def freed(
    ik: IkSolver,
    collision: CollisionModel,
    goal: PoseGoal,
    solutions: Sequence[IkSolution],
    *,
    q_jaw: float,
    seed: int,
) -> Iterator[IkSolution]:
    """Solutions free of contact near the given ones, which are in contact."""
    if goal.cloud is not None:  # its solutions already cover its tolerances
        return
    random = np.random.default_rng(seed)
    rated = [(collision.clearance(each.q, q_jaw).room, each) for each in solutions]
    rated.sort(key=lambda pair: -pair[0])
    tried: list[Array] = []
    for room, solution in rated:
        if room < -LARGEST_LACK or len(tried) == CLIMBERS:
            return
        if any(np.abs(solution.q - q).max() < APART for q in tried):
            continue
        tried.append(solution.q)
        found = _climbed(ik, collision, goal, solution, q_jaw, random)
        if found is not None:
            yield found


def _climbed(
    ik: IkSolver,
    collision: CollisionModel,
    goal: PoseGoal,
    solution: IkSolution,
    q_jaw: float,
    random: np.random.Generator,
) -> IkSolution | None:
    best, step = collision.clearance(solution.q, q_jaw).room, _FIRST_STEP
    for _ in range(STEPS):
        q_seed: Array = solution.q + step * random.standard_normal(5)
        try:
            varied = ik.solve(goal, q_seed)
        except Unreachable:
            return None
        room = collision.clearance(varied.q, q_jaw).room
        if room > best:
            best, solution = room, varied
            if collision.is_free(solution.q, q_jaw):
                return solution
        else:
            step *= _SMALLER
    return None
