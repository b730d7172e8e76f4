"""Find collision-free joint angles for a tool goal, the nearest first.

They are computed one by one while a path to them is searched: most requests only need the first.
"""

from __future__ import annotations

from collections.abc import Iterator

from so101_motion.common.errors import Overloaded
from so101_motion.common.geometry import Array
from so101_motion.planning.cartesian.tool_motion import ToolMotion
from so101_motion.planning.goals import ApproachGoal, PoseGoal
from so101_motion.planning.kinematics.ik import IkSolution
from so101_motion.planning.paths.contact_recovery import freed
from so101_motion.planning.planning_context import PlanningContext

APPROACHES = 12
"""Number of configurations above a pose from which the line to it is tried. Chosen: a few branches,
each with a few pitches."""


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
    for solution in freed(
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

    Args:
        context: The request.
        q_from: Joint angles that they shall be near to.
        goal: The pose.
        kept: Output: the number of each such configuration and the line from there.

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
