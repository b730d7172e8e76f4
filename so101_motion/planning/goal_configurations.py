"""Turn the goal of a request into configurations: free joint angles for a pose, checked waypoints.

Joint angles for a pose come the nearest first, one by one while a path to them is searched: most
requests only need the first. A prescribed path of waypoints is followed or refused, never replaced
by another; so the error names the waypoint, or the two waypoints between which the path is blocked.
Waypoints are counted from 1, without the start.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import islice, pairwise

import numpy as np

from so101_motion.common.errors import ConfigError, OutsideLimits, Overloaded, Unreachable
from so101_motion.common.geometry import Array
from so101_motion.planning.cartesian.path_search import ToolMotion
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.goals import ApproachGoal, PoseGoal
from so101_motion.planning.kinematics.ik import IkSolution, IkSolver
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.motion_builder import SAME, MotionBuilder
from so101_motion.planning.planning_context import PlanningContext

APPROACHES = 12  # configurations from which a line to a pose is tried; chosen
LARGEST_LACK = 0.015  # of clearance in configurations tried [m]; chosen, one step of the gripper
APART = 0.3  # difference of improved candidates in some joint [rad]; chosen
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
    load, heavy, any_free = context.moves.load, None, False
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
            any_free = True
            yield solution.q
    if any_free:
        return
    if heavy is not None:
        raise heavy
    for solution in _freed(
        context.ik, collision, goal, blocked, q_jaw=request.q_jaw, seed=request.seed
    ):
        any_free = True
        yield solution.q
    if not any_free:
        least = max(
            (solution.q for solution in blocked),
            key=lambda q: collision.clearance(q, request.q_jaw).room,
        )
        every = f"at the goal, even in the best of {len(blocked)} postures,"
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
    context: PlanningContext, q_from: Array, goal: ApproachGoal, kept: list[ToolMotion]
) -> Iterator[Array]:
    """Free configurations, shape (5,), [rad], above a pose from which the line can be followed.

    Those near ``q_from`` first. ``kept`` is output: the line from each.

    Raises:
        PlanningError: There are none; the message is about the line from the nearest.
    """
    nearest = None
    for q in islice(free_configurations(context, goal.above, q_from), APPROACHES):
        nearest = q if nearest is None else nearest
        line = context.lines.find_if_any(
            goal.line, q, context.moves.collision, context.request.q_jaw
        )
        if line is not None:
            kept.append(line)
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


_ONE = 2.0 * math.pi / 4096.0  # nearer waypoints are one [rad]: an encoder's tick
_TURN = 1e-6  # a waypoint at which the direction changes less than this is on a line


def checked_path(model: RobotModel, moves: MotionBuilder, q_from: Array, waypoints: Array) -> Array:
    """The collision-free polyline (m, 5) [rad] from a start through waypoints, simplified.

    Args:
        moves: Checks configurations and lines for contact.
        q_from: A free configuration inside the limits, shape (5,), [rad].
        waypoints: Shape (n, 5), n >= 1, [rad].

    Raises:
        OutsideLimits: A waypoint is outside the joint limits; the message says which.
        InCollision: A waypoint, or the path to it, is in contact; the message says which.
        ConfigError: There is no waypoint.
    """
    if len(waypoints) == 0:
        raise ConfigError("waypoints", [], "a path needs at least one waypoint")
    for number, q in enumerate(waypoints, 1):
        _check(model, moves, q, f"waypoint {number} of {len(waypoints)}")
    drawn_in = np.clip(waypoints, model.lower, model.upper)
    corners = np.concatenate([q_from[None], drawn_in])
    for number, leg in enumerate(pairwise(corners)):
        blocked = moves.collision.first_blocked(np.array(leg), moves.q_jaw)
        if blocked is not None:
            begin = f"waypoint {number}" if number else "the start"
            when = f"between {begin} and waypoint {number + 1}"
            raise moves.in_collision(blocked, "path", when)
    return simplified(corners)


def _check(model: RobotModel, moves: MotionBuilder, q: Array, name: str) -> None:
    try:
        model.check_limits(q)
    except OutsideLimits as error:
        raise error.about(name) from None
    if not moves.collision.is_free(q, moves.q_jaw):
        raise moves.in_collision(q, "path", f"at {name}")


def simplified(waypoints: Array) -> Array:
    """A polyline without (nearly) repeated waypoints and those on a straight line.

    Args:
        waypoints: Shape (m, n), m >= 2, [rad].

    Returns:
        At least two of them, first and last included; equal if all are.
    """
    kept = [waypoints[0]]
    for q in waypoints[1:-1]:
        if np.abs(q - kept[-1]).max() > _ONE:
            kept.append(q)
    if len(kept) > 1 and np.abs(waypoints[-1] - kept[-1]).max() <= _ONE:
        kept.pop()
    points = np.array([*kept, waypoints[-1]])
    steps = np.diff(points, axis=0)
    steps /= np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), SAME)
    turns = np.abs(np.diff(steps, axis=0)).max(axis=1, initial=0.0)
    return np.asarray(points[np.concatenate([[True], turns > _TURN, [True]])])
