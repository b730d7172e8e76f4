"""Plan one arm's motion among other arms that share its space and may be moving.

The places where the others come to rest are obstacles. Around these two motions are planned: one
ignores the others' motions and waits until its path is free; the other avoids the place where it
would meet another arm, and need not wait. The one that ends earlier is taken. Both are proven
against the timed motions of the others (``apart.py``).

An arm that is already too near to another may only leave: the two come no nearer to each other than
they are, until there is room between them again.

The proof does not rely on all arms keeping their times. Any arm may be stopped, and then the arms
that would run into it have to stop as well. So at every instant all arms must be able to brake at
once, each along its own path, without coming near each other; that is checked, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from so101_motion.common.errors import InCollision, PlanningError
from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.apart import (
    EARLY,
    GUARDED,
    GUARDED_EARLY,
    PARTING,
    ROOM,
    Meeting,
    Moving,
    first_meeting,
    nearness,
    stops_meeting,
)
from so101_motion.planning.collision.arm_bodies import bodies_of
from so101_motion.planning.collision.course import Course, OtherArm
from so101_motion.planning.collision.scene import Attached, Scene, StandingArm
from so101_motion.planning.request import Plan, PlanRequest
from so101_motion.planning.timing.trajectory import Trajectory

WAIT = 0.05  # step by which a wait is made longer until the path is free [s]; chosen
SURELY = 0.7  # share of ``ROOM`` that no proof passes; chosen: proofs leave seven eighths
COARSE = 4  # waits are tried first in steps so many times as long; chosen
TRIED = 0.025  # longest search around moving arms [s]; chosen: waiting is the alternative
BRAKES = 0.1  # time between the instants at which it is checked that all arms can brake [s]; chosen
LEAVING = 0.1  # time between tries of two arms that were too near to be apart [s]


def crosses(arm: str, meeting: Meeting, *, since: float = 0.0) -> InCollision:
    """The error for a motion that comes too near to another arm, whenever it begins.

    ``since`` is when the motion would begin at the earliest [s].
    """
    first, second = meeting.first, f"{arm}'s {meeting.second}"
    distance = f"{max(meeting.distance, 0.0) * 1e3:.0f} mm"
    if meeting.t <= since:
        goal = "" if meeting.distance <= PARTING else "choose a goal straight away from it, "
        return InCollision(
            f"at the start the {first} is {distance} from {second}; {goal}move one of the arms away"
            " by hand (manual mode), or correct where their bases stand",
            first=first,
            second=second,
            where="start",
        )
    return InCollision(
        f"on its path the {first} would come within {distance} of {second} while {arm} moves; wait"
        f" until {arm} rests, or choose another goal",
        first=first,
        second=second,
        where="path",
    )


def plan_among(
    plan: Callable[[PlanRequest], Plan],
    request: PlanRequest,
    *,
    alone: Plan | None = None,
    before: float = math.inf,
) -> Plan:
    """Plan a motion that keeps ``ROOM`` away from the request's other arms, with ``plan``.

    If it has to wait for them, it begins with standing still. ``alone`` is the plan without them,
    if known: if it is straight and keeps off the places where they come to rest, it would be found
    again. A motion that ends later than ``before`` [s] need not be found.

    Raises:
        InCollision: No wait helps.
        PlanningError: As for a motion among obstacles, of which the others' links, where they come
            to rest, are some.
    """
    ends = [_standing(each, each.course.q[-1:]) for each in request.others]
    known = replace(request, others=(), scene=_with_arms(request.scene, ends))
    first = alone if alone is not None and _keeps_off(alone, request) else plan(known)
    if all(each.course.end <= 0.0 for each in request.others):
        return first
    held = request.scene.attached
    met = crossing(held, Course.along(first.trajectory, request.q_jaw), request.others)
    if met is None:
        return first
    wait = earliest_wait(first.trajectory, request, before - first.duration)
    around = _around(plan, request, met, before if wait is None else wait + first.duration)
    if around is not None:
        return around
    if wait is None:
        raise crosses(*met)
    return _waiting(first, wait, request.others)


def _keeps_off(plan: Plan, request: PlanRequest) -> bool:
    """Whether a plan is straight and keeps off the places where the others come to rest."""
    if not plan.report.straight or plan.report.departure:
        return False
    course = Course.along(plan.trajectory, request.q_jaw)
    room, held = ROOM + request.scene.margin, request.scene.attached
    for each in request.others:
        rest = Course(t=0.0, dt=1.0, q=each.course.q[-1:])
        pair = (bodies_of(held, each.name), course), (bodies_of(each.attached), rest)
        if first_meeting(*pair, each.T_base_other, since=0.0, room=room, early=0.0) is not None:
            return False
    return True


def earliest_wait(
    trajectory: Trajectory, request: PlanRequest, longest: float = math.inf
) -> float | None:
    """The shortest wait [s] after which a motion crosses no other arm; None if none helps.

    Waits longer than ``longest`` [s] are hardly tried.
    """
    held, last = request.scene.attached, max(e.course.end for e in request.others)
    met: tuple[str, float] | None = None  # whom the motion met last, and how long after it began

    def is_enough(wait: float) -> bool:
        nonlocal met
        course = Course.along(trajectory, request.q_jaw, t=wait)
        if met is not None and _still_meet(held, course, request.others, *met):
            return False
        found = crossing(held, course, request.others)
        is_later = found is not None and found[1].t > 0.0  # who is too near already may leave
        met = (found[0], found[1].t - wait) if found is not None and is_later else None
        return found is None

    end = min(last + 2.0 * WAIT, longest) + (COARSE - 1) * WAIT
    for long in np.arange(0.0, end, COARSE * WAIT):
        if is_enough(float(long)):
            shorter = float(long) - WAIT * np.arange(COARSE - 1, 0, -1)
            finer = (float(each) for each in shorter if each > 0.0)
            return next((each for each in finer if is_enough(each)), float(long))
    return None


def _still_meet(
    held: tuple[Attached, ...], course: Course, others: Sequence[OtherArm], name: str, after: float
) -> bool:
    """Quick check whether a course still meets another arm, ``after`` [s] from its beginning."""
    [other] = [each for each in others if each.name == name]
    at = np.array([course.t + after])
    mine, theirs = (Course(t=0.0, dt=1.0, q=each.at(at)) for each in (course, other.course))
    pair = (bodies_of(held, name), mine), (bodies_of(other.attached), theirs)
    return first_meeting(*pair, other.T_base_other, since=0.0, room=SURELY * ROOM) is not None


def crossing(
    held: tuple[Attached, ...], course: Course, others: Sequence[OtherArm], *, since: float = 0.0
) -> tuple[str, Meeting] | None:
    """The first arm that a course comes too near to from ``since`` [s] on, and where.

    ``held`` are the objects the arm holds. None if the course keeps off all.
    """
    for other in others:
        meeting = _meeting(held, course, other, since)
        if meeting is not None:
            return other.name, meeting
    return None


def _meeting(
    held: tuple[Attached, ...], course: Course, other: OtherArm, since: float
) -> Meeting | None:
    mine, theirs, T = (
        (bodies_of(held, other.name), course),
        (bodies_of(other.attached), other.course),
        other.T_base_other,
    )
    stands = other.course.end <= since
    room, early = (GUARDED, 0.0) if stands else (ROOM, EARLY)
    found = first_meeting(mine, theirs, T, since=since, room=room, early=early)
    if found is not None and found.t <= since:
        left = _leaving(mine, theirs, T, since, room, early)
        if left is None:
            return found
        since, found = left, None
    if stands or found is not None:
        return found
    room = 0.5 * (ROOM + GUARDED)
    return stops_meeting(mine, theirs, T, since=since, every=BRAKES, room=room, early=GUARDED_EARLY)


def _leaving(
    mine: Moving, theirs: Moving, T: SE3, since: float, room: float, early: float
) -> float | None:
    """The time from which two arms that are too near keep their room [s].

    None if they come nearer to each other before, or stay too near.
    """
    near = nearness(mine, theirs, T, at=since, room=room)
    if near is None or near <= PARTING:
        return None
    end = max(mine[1].end, theirs[1].end)
    if first_meeting(mine, theirs, T, since=since, room=near - PARTING, early=0.0) is not None:
        return None
    for t in np.arange(since + LEAVING, end + LEAVING, LEAVING):
        met = first_meeting(mine, theirs, T, since=float(t), room=room, early=early)
        if met is None:
            return float(t)
        if met.t > t + LEAVING:
            return None  # they had left each other, and meet again
    return None


def _around(
    plan: Callable[[PlanRequest], Plan], request: PlanRequest, met: tuple[str, Meeting], last: float
) -> Plan | None:
    """A motion around the others that need not wait and ends before ``last`` [s]; or None.

    The arm that would be met is an obstacle at the place of the meeting, too. One try: of 140
    searches in 200 tasks of two arms 8 found such a motion, and none of 50 more with the next
    meeting.
    """
    held, others = request.scene.attached, {each.name: each for each in request.others}
    q_others = {name: each.course.q[-1:] for name, each in others.items()}
    name, meeting = met
    q_met = others[name].course.at(np.array([meeting.t]))
    q_others[name] = np.concatenate((q_others[name], q_met))
    arms = [_standing(others[key], q) for key, q in q_others.items()]
    scene = _with_arms(request.scene, arms)
    # So short a budget must not end a comparison of routes, which would then depend on the machine.
    budget = min(request.time_budget, TRIED)
    brief = replace(request, others=(), time_budget=budget, route_effort=1, scene=scene)
    try:
        found = plan(brief)
    except PlanningError:
        return None
    if found.report.departure or found.duration >= last:
        return None
    course = Course.along(found.trajectory, request.q_jaw)
    if crossing(held, course, request.others) is not None:
        return None
    return replace(found, report=replace(found.report, waits_for=(*others,)))


def _waiting(plan: Plan, wait: float, others: Sequence[OtherArm]) -> Plan:
    names = tuple(each.name for each in others if each.course.end > 0.0)
    return replace(
        plan,
        trajectory=delayed(plan.trajectory, wait),
        report=replace(plan.report, waits=wait, waits_for=names),
    )


def delayed(trajectory: Trajectory, wait: float) -> Trajectory:
    """The same motion after standing still for ``wait`` [s], rounded to a sample."""
    return trajectory.with_rest(before=round(wait / trajectory.dt))


def _standing(other: OtherArm, q: Array) -> StandingArm:
    return StandingArm(
        name=other.name, T_base_arm=other.T_base_other, q=q, attached=other.attached, room=ROOM
    )


def _with_arms(scene: Scene, arms: Sequence[StandingArm]) -> Scene:
    return replace(scene, arms=(*scene.arms, *arms))
