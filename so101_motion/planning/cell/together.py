"""Plan one motion for several arms, begun and ended together.

Four methods, the quickest first; each is tried only if the one before fails. *All at once*: every
arm is planned as if it were alone, and the faster ones are slowed down to the slowest. *One after
the other*: arms are planned in turn, each around the motions of those planned before
(``planning/among.py``), in the orders that suit where they stand; the one that ends earliest is
taken. *Folded between*: three arms or more fold first, then go to their goals. *As one*: where
arms have to make room for each other, a path is searched for all joints together and timed as one
motion, slower where the arms are near each other: a proof asks for more room where both are fast.

The result is proven as a whole: every arm by itself as always, and every two arms in time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations, pairwise, permutations

import numpy as np

from so101_motion.common.errors import InCollision, NoPath, OutsideLimits, Overloaded, PlanningError
from so101_motion.common.geometry import Array
from so101_motion.common.named_poses import POSES
from so101_motion.planning.among import crossing, plan_among
from so101_motion.planning.cell.team_requests import TeamMember
from so101_motion.planning.collision.apart import (
    EARLY,
    ROOM,
    Meeting,
    distances,
    first_meeting,
    placement,
)
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.batch_check import MOST_ARMS, Couple, LineCheck
from so101_motion.planning.collision.course import Course
from so101_motion.planning.goals import JointGoal, PathGoal
from so101_motion.planning.paths.compiled_search import (
    CompiledSearch,
    Deadline,
    Seeds,
    Space,
    compiled_shortened,
)
from so101_motion.planning.paths.path import SPACING
from so101_motion.planning.planner import CORNER, Planner
from so101_motion.planning.planning_context import PlanningContext
from so101_motion.planning.request import HURRIED_EFFORT, Plan, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point
from so101_motion.planning.timing.path_geometry import JointPath, blended_path
from so101_motion.planning.timing.retime import retime
from so101_motion.planning.timing.torque import slowed
from so101_motion.planning.timing.trajectory import Trajectory, joined

LOOKS = 64  # number of places of a path at which distances are measured; chosen, a millisecond
FAR = 0.3  # bodies further apart than this limit no speed [m]; chosen
SHARE = 0.8  # share of the spare room that is used; chosen: between places there may be less
SLOWEST = 0.02  # lowest limit of a speed [m/s]; chosen


def pace_on(path: JointPath, team: Sequence[TeamMember]) -> Callable[[Array, Array], Array] | None:
    """Make a function for the speed of arms on a path, as a share of what will probably be proven.

    It takes joint angles (m, n) on the path and their rates (m, n), five for each arm in turn, and
    returns (m,). None if arms come so near to each other that they could not move at all.
    """
    places = path.evaluate(np.linspace(0.0, path.length, LOOKS)).q
    bodies = [bodies_of(each.request.scene.attached) for each in team]
    q = [
        np.column_stack([places[:, 5 * k : 5 * k + 5], np.full(LOOKS, each.request.q_jaw)])
        for k, each in enumerate(team)
    ]
    allowed = []
    for i, j in combinations(range(len(team)), 2):
        T = team[i].T_cell_base.inverse @ team[j].T_cell_base
        near = distances(bodies[i], bodies[j], T, q[i], q[j], need=ROOM, enough=FAR)
        room = near - ROOM
        if room.min() <= 0.0:
            return None
        allowed.append((i, j, np.maximum(SHARE * room / EARLY, SLOWEST)))
    square = np.sum(places**2, axis=1)

    def pace(q: Array, qd: Array) -> Array:
        k = np.argmin(square - 2.0 * q @ places.T, axis=1)  # the nearest
        fast = [
            np.abs(qd[:, 5 * i : 5 * i + 5]) @ each.levers[:, :5].T for i, each in enumerate(bodies)
        ]
        shares = [
            (np.minimum(fast[i][:, :, None], fast[j][:, None]) / most[k]).max(axis=(1, 2))
            for i, j, most in allowed
        ]
        return np.asarray(np.max(shares, axis=0))

    return pace


SLOWER = (1.0, 1.5, 2.2, 3.3, 5.0)  # factors of slowing: slow arms may be nearer; chosen
SPARE = 0.005  # extra room of a common path [m], because its corners are cut; chosen
MOST_ORDERS = 6  # orders of planning one after the other; chosen, all of three
HOPELESS = 1000  # how bad an order is in which an arm stands at the goal of one before it
KEPT = 32  # beginnings of orders that are gone on with; chosen

SHARES = 0.4, 0.55, 0.75, 1.1
"""Of the time budget, after which each method leaves it to the next; chosen. The last is all
that a plan may take: an arm that finds nothing must leave time for the others."""

FOLD = next(pose.q for pose in POSES if pose.name == "rest")
LEAST = 0.01  # shortest search of one arm [s]; chosen

TURN = 0.25, 0.05
"""Longest search of one arm among the others [s], which may shut it in: until a common motion was
found, and for better ones. Chosen: a search takes 5 ms, but machines may be busy."""


def plan_together(planner: Planner, team: Sequence[TeamMember]) -> dict[str, Plan]:
    """Plan one motion for several arms, which they begin and end together.

    Returns:
        The plan of each arm by its name; all have the same number of samples. An arm that arrives
        before the others rests until the end.

    Raises:
        PlanningError: A goal cannot be reached, two of them not at the same time, or no motion was
            found in time.
    """
    if any(isinstance(each.request.goal, PathGoal) for each in team):
        return _along_path(planner, team)
    now, budget = time.monotonic(), team[0].request.time_budget
    alone, in_turn, folded, ends = (now + share * budget for share in SHARES)
    team = _with_goals(planner, team, alone)
    return (
        _each_by_itself(planner, team, alone, in_turn)
        or (len(team) > 2 and _folded_between(planner, team, folded))
        or _as_one(planner, team, ends)
    )


def _each_by_itself(
    planner: Planner, team: Sequence[TeamMember], alone_ends: float, ends: float
) -> dict[str, Plan] | None:
    """Plans of arms on paths of their own: all at once, or one after the other."""
    alone = [_alone(planner, each, alone_ends) for each in team]
    at_once = _at_once(team, alone)
    if at_once is not None:  # nothing is quicker
        return at_once
    for plans in sorted(_in_turn(planner, team, alone, ends), key=_makespan):
        proven = _proven(team, plans, [each.trajectory for each in plans])
        if proven is not None:
            return proven
    return None


def _folded_between(
    planner: Planner, team: Sequence[TeamMember], ends: float
) -> dict[str, Plan] | None:
    """Plans in which all fold before any goes to its goal: folded, arms of a cell are apart."""
    places = [[each.request.q_start for each in team], [FOLD] * len(team), [*map(_goal_of, team)]]
    legs = list[dict[str, Plan]]()
    with suppress(PlanningError):  # there may be no room to fold
        for stand, goals in pairwise(places):
            asked = [
                replace(each, request=replace(each.request, q_start=q, goal=JointGoal(q=goal)))
                for each, q, goal in zip(team, stand, goals, strict=True)
            ]
            leg = _each_by_itself(planner, asked, ends, ends)
            if leg is None:
                break
            legs.append(leg)
    if len(legs) < 2:
        return None
    plans = []
    for each in team:
        parts = [leg[each.name] for leg in legs]
        path = np.concatenate([parts[0].path, parts[1].path[1:]])
        whole = joined([part.trajectory for part in parts])
        plans.append(planner.plan_of(planner.context(each.request), whole, path))
    return _proven(team, plans, [each.trajectory for each in plans])


def _until(ends: float, request: PlanRequest) -> PlanRequest:
    """The request with what is left of the time until ``ends`` [s]."""
    left = max(ends - time.monotonic(), LEAST)
    return replace(request, time_budget=min(left, request.time_budget))


def _along_path(planner: Planner, team: Sequence[TeamMember]) -> dict[str, Plan]:
    """Plan for an arm that follows a path, while the others stand where they are."""
    plans = []
    for member in team:
        others = [
            each.seen_from(member, each.resting(each.request.q_start))
            for each in team
            if each is not member
        ]
        with member.named():
            plans.append(planner.plan(replace(member.request, others=tuple(others))))
    proven = _proven(team, plans, [each.trajectory for each in plans])
    if proven is None:
        names = " and ".join(each.name for each in team)
        raise NoPath(
            f"on this path {names} would come too near to each other; stop at its corners",
            where="path",
            blockers=(),
        )
    return proven


def _makespan(plans: Sequence[Plan]) -> float:
    return max(each.duration for each in plans)


def _with_goals(planner: Planner, team: Sequence[TeamMember], ends: float) -> list[TeamMember]:
    """The same arms with joint angles as goals, at which all can stand at the same time."""
    fixed: list[TeamMember] = []
    for member in team:
        goal = member.request.goal
        if isinstance(goal, JointGoal):
            q_goal = goal.q
        else:
            others = tuple(each.seen_from(member, each.resting(_goal_of(each))) for each in fixed)
            with member.named():
                asked = _until(ends, replace(member.request, others=others))
                q_goal = planner.plan(asked).q_goal
        request = replace(member.request, goal=JointGoal(q=q_goal), others=())
        fixed.append(replace(member, request=request))
    for a, b in combinations(fixed, 2):
        if (met := _met(a, _goal_of(a)[None], b, _goal_of(b))) is not None:
            near = max(met.distance, 0.0)
            raise InCollision(
                f"at the goals {a.name}'s {met.first} would be {near * 1e3:.0f} mm from"
                f" {b.name}'s {met.second} ({ROOM * 1e3:.0f} mm must stay free); choose other"
                " goals",
                first=f"{a.name}'s {met.first}",
                second=f"{b.name}'s {met.second}",
                where="goal",
            )
    return fixed


def _goal_of(member: TeamMember) -> Array:
    goal = member.request.goal
    assert isinstance(goal, JointGoal | PathGoal)
    return goal.q if isinstance(goal, JointGoal) else goal.waypoints[-1]


def _alone(planner: Planner, member: TeamMember, ends: float) -> Plan | None:
    """Plan an arm as if there were no others; None if no path is found.

    Raises:
        PlanningError: The arm cannot be at its start or its goal, whatever the others do.
    """
    with member.named():
        try:
            return planner.plan(_until(ends, member.request))
        except (InCollision, OutsideLimits, Overloaded):  # no motion of the others helps
            raise
        except PlanningError:
            return None


def _at_once(team: Sequence[TeamMember], alone: Sequence[Plan | None]) -> dict[str, Plan] | None:
    """Every arm's own plan, slowed down to the slowest; None if arms would meet."""
    plans = [each for each in alone if each is not None]
    if len(plans) < len(team):
        return None
    longest = max(each.duration for each in plans)
    steady = [
        slowed(each.trajectory, longest / each.duration)
        if 0.0 < each.duration < longest
        else each.trajectory
        for each in plans
    ]
    return _proven(team, plans, steady)


def _in_turn(
    planner: Planner, team: Sequence[TeamMember], alone: Sequence[Plan | None], ends: float
) -> list[list[Plan]]:
    """Plans made one after the other, in several orders; longer ones are given up early."""
    found: list[list[Plan]] = []
    for order in _orders(team, alone):
        if time.monotonic() > ends:
            break
        plans: dict[int, Plan] = {}
        shortest = min(map(_makespan, found), default=math.inf)
        with suppress(PlanningError):
            for k in order:
                me = team[k]
                others = [
                    other.seen_from(
                        me,
                        Course.along(plans[i].trajectory, other.request.q_jaw)
                        if i in plans
                        else other.resting(other.request.q_start),
                    )
                    for i, other in enumerate(team)
                    if i != k
                ]
                few = min(me.request.route_effort, HURRIED_EFFORT)  # in each of many orders
                known = replace(me.request, others=tuple(others), route_effort=few)
                asked = _until(min(ends, time.monotonic() + TURN[bool(found)]), known)
                plans[k] = plan_among(planner.plan, asked, alone=alone[k], before=shortest)
                if plans[k].duration >= shortest:
                    break
            else:
                found.append([plans[k] for k in range(len(team))])
    return found


def _orders(team: Sequence[TeamMember], alone: Sequence[Plan | None]) -> list[tuple[int, ...]]:
    """Orders to plan in: an arm goes after those whose start and before those whose goal it meets.

    None if arms stand at each other's goals.
    """
    wrong = [[0] * len(team) for _ in team]  # to plan one before another
    for (i, one), (j, other) in permutations(enumerate(team), 2):
        begin, end = other.request.q_start, _goal_of(one)
        wrong[i][j] += HOPELESS * (_met(one, end[None], other, begin) is not None)
        if (plan := alone[i]) is not None:
            wrong[i][j] += _met(one, plan.trajectory.q, other, begin) is not None
        if (plan := alone[j]) is not None:
            wrong[i][j] += _met(other, plan.trajectory.q, one, end) is not None
    random, orders = np.random.default_rng(0), dict[tuple[int, ...], int]({(): 0})
    for _ in team:
        longer = {}
        for order, cost in orders.items():
            left = [k for k in range(len(team)) if k not in order]
            for k in left:
                longer[(*order, k)] = cost + sum(wrong[k][j] for j in left)
        best = sorted(longer, key=lambda order: (longer[order], random.random()))
        orders = {order: longer[order] for order in best[:KEPT]}
    return [order for order, cost in orders.items() if cost < HOPELESS][:MOST_ORDERS]


def _met(one: TeamMember, q: Array, other: TeamMember, q_other: Array) -> Meeting | None:
    """Where an arm that goes through ``q`` (n, 5) meets another one that stands at ``q_other``."""
    return first_meeting(
        (
            bodies_of(one.request.scene.attached),
            Course.through(q, one.request.q_jaw, t=0.0, dt=1.0),
        ),
        (bodies_of(other.request.scene.attached), other.resting(q_other)),
        one.T_cell_base.inverse @ other.T_cell_base,
        since=0.0,
        early=0.0,
    )


def _proven(
    team: Sequence[TeamMember], plans: Sequence[Plan], trajectories: Sequence[Trajectory]
) -> dict[str, Plan] | None:
    """Plans with trajectories of the same length; None if two arms come too near to each other."""
    length = max(map(len, trajectories))
    even = [each.with_rest(after=length - len(each)) for each in trajectories]
    if not _keep_apart(team, even):
        return None
    return {
        member.name: replace(plan, trajectory=each)
        for member, plan, each in zip(team, plans, even, strict=True)
    }


def _keep_apart(team: Sequence[TeamMember], trajectories: Sequence[Trajectory]) -> bool:
    """Whether every two arms keep apart, and can all brake at any instant."""
    for (a, one), (b, other) in combinations(zip(team, trajectories, strict=True), 2):
        course = Course.along(one, a.request.q_jaw)
        seen = b.seen_from(a, Course.along(other, b.request.q_jaw))
        if crossing(a.request.scene.attached, course, [seen]) is not None:
            return False
    return True


def _as_one(planner: Planner, team: Sequence[TeamMember], ends: float) -> dict[str, Plan]:
    """Search one path for all joints together, and time it as one motion."""
    first = team[0].request
    if len(team) > MOST_ARMS:
        raise NoPath(
            f"{len(team)} arms would have to move around each other at once; planning handles"
            f" {MOST_ARMS} at most; move some of them first",
            where="path",
            blockers=(),
        )
    contexts = []
    for member in team:
        with member.named():
            contexts.append(planner.context(member.request))
    checker, deadline = _check_of(team, contexts), Deadline(_until(ends, first).time_budget)
    start = np.concatenate([each.request.q_start for each in team])
    goal = np.concatenate([_goal_of(each) for each in team])
    space = Space(
        lower=np.concatenate([each.model.lower for each in contexts]),
        upper=np.concatenate([each.model.upper for each in contexts]),
        weights=np.concatenate([each.moves.collision.reach for each in contexts]),
    )
    names = " and ".join(each.name for each in team)
    if not checker.is_free(start):
        raise NoPath(
            f"{names} cannot be moved together, because they stand too near to each other or to an"
            " obstacle; move one of them away first",
            where="start",
            blockers=(),
        )
    points: list[Array] | None = [start, goal]
    if not checker.is_clear(start, goal):
        points = _searched(space, checker, start, goal, first.seed, deadline)
        if points is None:
            raise NoPath(
                f"no common motion of {names} was found in {first.time_budget:.1f} s; move them one"
                " after the other, or allow more time",
                where="path",
                blockers=(),
            )
    problem: PlanningError | None = None
    motions: list[Trajectory] = []
    for slower in SLOWER:
        for trajectory in motions or _timed(np.array(points), team, contexts):
            if slower == SLOWER[0]:
                motions.append(trajectory)
            parts = _split(slowed(trajectory, slower) if slower > 1.0 else trajectory)
            if not _keep_apart(team, parts):
                continue
            try:
                for member, part, context in zip(team, parts, contexts, strict=True):
                    with member.named():
                        context.check([part])
            except PlanningError as error:
                problem = error
                continue
            plans = [
                planner.plan_of(context, part, np.array(points)[:, 5 * i : 5 * i + 5])
                for i, (context, part) in enumerate(zip(contexts, parts, strict=True))
            ]
            return {
                member.name: replace(plan, trajectory=part)
                for member, plan, part in zip(team, plans, parts, strict=True)
            }
    raise problem or NoPath(
        f"no common motion of {names} keeps them far enough apart; move them one after the other",
        where="path",
        blockers=(),
    )


def _check_of(team: Sequence[TeamMember], contexts: Sequence[PlanningContext]) -> LineCheck:
    """The check of all arms together, each in its scene and against the others."""
    arms = [
        context.moves.collision.sampled_check(member.request.q_jaw, spacing=SPACING).arms[0]
        for member, context in zip(team, contexts, strict=True)
    ]
    couples = []
    for (i, one), (j, other) in combinations(enumerate(team), 2):
        a, b = (bodies_of(each.request.scene.attached) for each in (one, other))
        T = one.T_cell_base.inverse @ other.T_cell_base
        levers = a.levers_pointer, b.levers_pointer
        couples.append(Couple(i, j, a.handle, b.handle, *levers, tuple(placement(T))))
    return LineCheck(arms, couples, ROOM + SPARE)


def _searched(
    space: Space, checker: LineCheck, start: Array, goal: Array, seed: int, deadline: Deadline
) -> list[Array] | None:
    """A short path for all joints; None if none was found in time."""
    seeds = Seeds(seed)
    found = CompiledSearch(space, checker, start, [goal], seeds).run(deadline)
    return found and compiled_shortened(found[0], checker, seeds, deadline)


def _timed(
    points: Array, team: Sequence[TeamMember], contexts: Sequence[PlanningContext]
) -> Iterator[Trajectory]:
    """Motions along a path of all joints.

    First with its corners cut, slower where arms are near each other; then with a stop at each.
    """
    limits = [each.moves.limits for each in contexts]
    caps = MotionLimits(
        velocity=np.concatenate([each.velocity for each in limits]),
        acceleration=np.concatenate([each.acceleration for each in limits]),
        jerk=np.concatenate([each.jerk for each in limits]),
    )
    dt, paced = team[0].request.dt, replace(caps, tool_speed=1.0)
    for tolerance in (CORNER, 0.25 * CORNER):
        path = blended_path(points, tolerance)
        pace = pace_on(path, team)
        if pace is not None:
            with suppress(PlanningError):
                yield _borne(retime(path, paced, dt, tool_speed_fn=pace), contexts)
    legs = [point_to_point(a, b, caps, dt) for a, b in pairwise(points)]
    yield _borne(joined(legs), contexts)


def _borne(trajectory: Trajectory, contexts: Sequence[PlanningContext]) -> Trajectory:
    """The same motion, slowed down until no servo is overloaded and all tool speeds are kept."""
    slower = 1.0
    for part, context in zip(_split(trajectory), contexts, strict=True):
        moves = context.moves
        if moves.load is not None:
            slower = max(slower, moves.load.stretch(part))
        if moves.limits.tool_speed is not None:
            fastest = float(moves.tool.speeds(part.q, part.qd).max())
            slower = max(slower, fastest / moves.limits.tool_speed)
    return slowed(trajectory, slower) if slower > 1.0 else trajectory


def _split(trajectory: Trajectory) -> list[Trajectory]:
    return [
        replace(
            trajectory,
            q=trajectory.q[:, i : i + 5],
            qd=trajectory.qd[:, i : i + 5],
            qdd=trajectory.qdd[:, i : i + 5],
        )
        for i in range(0, trajectory.n, 5)
    ]
