"""Find collision-free joint angles for a tool goal, the nearest first.

They are computed one by one while a path to them is searched: most requests only need the first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from so101_motion.common.errors import Overloaded, Unreachable
from so101_motion.common.geometry import Array
from so101_motion.planning.cartesian.tool_motion import ToolMotion
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.goals import ApproachGoal, PoseGoal
from so101_motion.planning.kinematics.ik import IkSolution, IkSolver
from so101_motion.planning.planning_context import PlanningContext

APPROACHES = 12
"""Number of configurations above a pose from which the line to it is tried. Chosen: a few branches,
each with a few pitches."""

LARGEST_LACK = 0.015
"""Configurations that lack more clearance than this are not tried [m]. Chosen: the motion of the
gripper's edge by a step of pitch or roll between candidates."""

APART = 0.3
"""Improved candidates differ by this in some joint [rad], so that they reach different maxima."""

CLIMBERS = 12
STEPS = 25  # number of candidates to improve, and of variations of each. Chosen: 50 ms at most

_FIRST_STEP = 0.1
_SMALLER = 0.8


def free_configurations(context: PlanningContext, goal: PoseGoal, q_from: Array) -> Iterator[Array]:
    """Collision-free joint angles for a pose, shape (5,), [rad], those near ``q_from`` first.

    Raises:
        InCollision: There are joint angles for the pose, but none are free.
        Overloaded: Some are free, but the servos cannot hold the arm there.
    """
    request, collision = context.request, context.moves.collision
    blocked: list[IkSolution] = []
    load, heavy = context.moves.load, None
    for solution in _solutions(context, goal, q_from):
        if not context.is_free(solution.q):
            blocked.append(solution)
            continue
        try:
            if load is not None:
                load.check_goal(solution.q)
        except Overloaded as error:
            heavy = heavy or error
        else:
            context.branches.append(solution.branch)
            yield solution.q
    if context.branches:
        return
    if heavy is not None:
        raise heavy
    for solution in _freed(
        context.ik, collision, goal, blocked, q_jaw=request.q_jaw, seed=request.seed
    ):
        context.branches.append(solution.branch)
        yield solution.q
    if not context.branches:
        least = max(
            (solution.q for solution in blocked),
            key=lambda q: collision.clearance(q, request.q_jaw).room,
        )
        every = f"at the goal, in the best of {len(blocked)} configurations,"
        raise context.moves.in_collision(least, "goal", every if len(blocked) > 1 else None)


def _solutions(context: PlanningContext, goal: PoseGoal, q_from: Array) -> Iterator[IkSolution]:
    """All solutions for a pose, nearest first; their time is counted."""
    with context.stage("ik"):
        solutions = context.ik.candidates(goal, q_from)
    while True:
        with context.stage("ik"):
            solution = next(solutions, None)
        if solution is None:
            return
        yield solution


def configurations_above(
    context: PlanningContext, q_from: Array, goal: ApproachGoal, kept: list[tuple[int, ToolMotion]]
) -> Iterator[Array]:
    """Free configurations, shape (5,), [rad], above a pose from which the line can be followed.

    Those near ``q_from`` first. ``kept`` is output: the number of each, and the line from there.

    Raises:
        PlanningError: There are none; the message is about the line from the nearest.
    """
    nearest = None
    for number, q in enumerate(free_configurations(context, goal.above, q_from)):
        if number == APPROACHES:
            break
        nearest = q if nearest is None else nearest
        line = context.lines.find_if_any(
            goal.line, q, context.moves.collision, context.request.q_jaw
        )
        if line is not None:
            kept.append((number, line))
            yield q
    if not kept and nearest is not None:
        context.lines.find(goal.line, nearest, context.moves.collision, context.request.q_jaw)


def _freed(
    ik: IkSolver,
    collision: CollisionModel,
    goal: PoseGoal,
    solutions: Sequence[IkSolution],
    *,
    q_jaw: float,
    seed: int,
) -> Iterator[IkSolution]:
    """Solutions free of contact near the given ones, which are in contact.

    Candidates are spread over pitch and roll some degrees apart, and may all miss a narrow free
    range. So the best are improved by hill climbing: varied a little at random, solved for the goal
    again from there, and kept if they have more clearance; steps without gain become smaller.
    """
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
