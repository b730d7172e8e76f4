"""Plan a whole program before any of it moves.

A *leg* leads from one stop to the next, through the waypoints that are passed between them and with
the jaw as the stop before leaves it. The first leg starts where the arm is. Rounds and loops add
the legs back to where they begin, and legs on which the jaw is different the second time, so every
motion is planned. A leg that cannot be planned is refused here, with the name of its waypoint.

How a leg with passed waypoints is planned. The path to each of them is searched like any other,
around obstacles. All these paths in a row are one path, along which the planner makes one motion
that may be ``PASSING`` off it. If a corner cannot be rounded without contact, the arm stops there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from so101_motion.arm.arm import START_TOLERANCE, Arm
from so101_motion.common.errors import ConfigError, PlanningError
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal, PathGoal
from so101_motion.planning.request import Plan, Search
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.protocols import GripperLike
from so101_motion.tasks.program.loops import Visit, times_in_round
from so101_motion.tasks.program.program import Program

PASSING = to_rad(3.0)
"""How far any joint may be from a waypoint that is passed, and from the path between two [rad].
Chosen: of 2, 3, 5 and 8 degrees the smallest with which 45 random programs, at two pairs of caps,
were never slower than with stops; their tool was 5 mm off a waypoint at the median, 18 at most."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProgramLeg:
    """The planned path to one stop.

    Attributes:
        indices: Its waypoints: those that are passed, and last the one that is stopped at.
        plan: The motion; None if the arm is there already.
        at: When each of them is passed or reached, from the beginning of the motion [s].
    """

    indices: range
    plan: Plan | None
    at: tuple[float, ...]


class LegKey(NamedTuple):
    """The key of a leg of a program.

    Attributes:
        origin: Index of the stop that it begins at; None for where the arm was at the start.
        indices: Its waypoints.
        q_jaw: Angle of the jaw [rad].
    """

    origin: int | None
    indices: range
    q_jaw: float


class PlannedVisit(NamedTuple):
    """An arrival at a stop with the path to it.

    Attributes:
        visit: The arrival.
        leg: The path.
        times: How often it comes in a round: several times if a loop repeats it.
    """

    visit: Visit
    leg: ProgramLeg
    times: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rehearsal:
    """A planned program.

    Attributes:
        program: The program.
        legs: All paths, in order.
        visits: All arrivals, but only the first two of each loop and round; later ones are like the
            second.
        q_start: The arm's joint angles at the start, shape (5,), [rad].
        q_jaw_start: The jaw's angle at the start [rad].
        scene: The scene of the plans; None for the arm's own scene.
    """

    program: Program
    legs: Mapping[LegKey, ProgramLeg]
    visits: tuple[PlannedVisit, ...]
    q_start: Array
    q_jaw_start: float
    scene: Scene | None = None

    @property
    def first_round(self) -> tuple[PlannedVisit, ...]:
        """The arrivals of the first round, of loops the first two times only."""
        return tuple(each for each in self.visits if each.visit.round == 0)

    @property
    def plans(self) -> tuple[Plan, ...]:
        """The paths of the first round, one after the other, of loops the first two times only."""
        return tuple(each.leg.plan for each in self.first_round if each.leg.plan is not None)

    @property
    def duration(self) -> float:
        """How long the arm moves and pauses in the first round [s]; the jaw's time comes on top."""
        return sum(each.times * self._lasts(each.leg) for each in self.first_round)

    def _lasts(self, leg: ProgramLeg) -> float:
        moves = 0.0 if leg.plan is None else leg.plan.duration
        return moves + self.program.waypoints[leg.indices[-1]].pause


class LegPlanner(Protocol):
    """The interface for planning legs: an arm, or a planner without one."""

    @property
    def limits(self) -> MotionLimits:
        """The caps of its motions."""

    def plan(
        self,
        goal: JointGoal | PathGoal,
        *,
        limits: MotionLimits | None,
        q_start: Array | None,
        q_jaw: float | None,
    ) -> Plan:
        """Plan within ``limits`` from joint angles, shape (5,), with the jaw at an angle [rad]."""


class SceneArm:
    """Plans the legs of an arm in a given scene; None for the arm's own."""

    def __init__(self, arm: Arm, scene: Scene | None) -> None:
        self._arm, self._search = arm, Search(scene=scene)

    @property
    def limits(self) -> MotionLimits:
        """The caps of its motions."""
        return self._arm.limits

    def plan(
        self,
        goal: JointGoal | PathGoal,
        *,
        limits: MotionLimits | None,
        q_start: Array | None,
        q_jaw: float | None,
    ) -> Plan:
        """Plan within ``limits`` from joint angles, shape (5,), with the jaw at an angle [rad]."""
        arm, search = self._arm, self._search
        return arm.plan(goal, limits=limits, search=search, q_start=q_start, q_jaw=q_jaw)


def rehearse(
    arm: Arm, gripper: GripperLike | None, program: Program, *, scene: Scene | None = None
) -> Rehearsal:
    """Plan all of a program; moves nothing.

    Args:
        arm: The arm; its caps, range and scene count, and the program begins where it is.
        gripper: The arm's jaw; None for an arm without one.
        program: The program.
        scene: What is around the arm; the arm's own scene if not given.

    Raises:
        PlanningError: A waypoint cannot be reached; the message names it.
        ConfigError: There is no waypoint, or the program moves a jaw that the arm does not have.
    """
    if not program.waypoints:
        raise ConfigError("program", "empty", "has no waypoint; record one first")
    if gripper is None and any(each.aperture is not None for each in program.waypoints):
        raise ConfigError("program", "jaw", "moves a jaw, but this arm has none")
    state, planner = arm.state, SceneArm(arm, scene)
    q_jaw = state.q_jaw_ref
    legs: dict[LegKey, ProgramLeg] = {}
    visits: list[PlannedVisit] = []
    for visit in program.visits(most=2):
        key = LegKey(visit.origin, visit.indices, q_jaw)
        stop = program.waypoints[visit.indices[-1]]
        if key not in legs:
            q = state.q_ref if visit.origin is None else program.waypoints[visit.origin].q
            legs[key] = plan_leg(planner, program, visit.indices, q, q_jaw)
        times = times_in_round(visit.laps, program.loops_around(visit.indices[-1]))
        visits.append(PlannedVisit(visit, legs[key], times))
        q_jaw = jaw_after(gripper, stop.aperture, q_jaw)
    return Rehearsal(
        program=program,
        legs=legs,
        visits=tuple(visits),
        q_start=state.q_ref,
        q_jaw_start=state.q_jaw_ref,
        scene=scene,
    )


def plan_leg(
    arm: LegPlanner, program: Program, indices: range, q_start: Array, q_jaw: float
) -> ProgramLeg:
    """Plan the path to a stop through the waypoints before it.

    Args:
        arm: Plans; its caps, range and scene count.
        program: The program with the waypoints.
        indices: The waypoints to pass, and the one to stop at.
        q_start: Joint angles at the start, shape (5,), [rad].
        q_jaw: Angle of the jaw [rad].

    Raises:
        PlanningError: A waypoint cannot be reached; the message names it.
    """
    corners, numbers, plan = [q_start], [], None
    share = min(program.waypoints[index].speed for index in indices)
    limits = arm.limits.eased(share)
    for index in indices:
        q = program.waypoints[index].q
        if not stands_at(corners[-1], q):
            goal: JointGoal | PathGoal = JointGoal(q=q)
            plan = _planned(arm, program, index, goal, corners[-1], q_jaw, limits)
            corners += [*plan.path[1:]]
        numbers.append(len(corners) - 1)
    if plan is None:
        return ProgramLeg(indices=indices, plan=None, at=(0.0,) * len(indices))
    if len({0, *numbers}) > 2:  # more than one of them is elsewhere
        goal = PathGoal(waypoints=np.array(corners[1:]), tolerance=PASSING)
        plan = _planned(arm, program, indices[-1], goal, q_start, q_jaw, limits)
    at = _passed_at(plan, [corners[number] for number in numbers[:-1]])
    return ProgramLeg(indices=indices, plan=plan, at=(*at, plan.duration))


def jaw_after(gripper: GripperLike | None, aperture: float | None, q_jaw: float) -> float:
    """The jaw's angle [rad] after a waypoint, starting from ``q_jaw``."""
    if gripper is None or aperture is None:
        return q_jaw
    return gripper.angle_of(aperture)


def stands_at(q: Array, other: Array) -> bool:
    """Whether two configurations are equal enough for a motion to begin at either."""
    return float(np.max(np.abs(q - other))) <= START_TOLERANCE


def _planned(
    arm: LegPlanner,
    program: Program,
    index: int,
    goal: JointGoal | PathGoal,
    q_start: Array,
    q_jaw: float,
    limits: MotionLimits,
) -> Plan:
    try:
        return arm.plan(goal, q_start=q_start, q_jaw=q_jaw, limits=limits)
    except PlanningError as error:
        raise error.about(program.called(index)) from None


def _passed_at(plan: Plan, passed: list[Array]) -> list[float]:
    """The times at which a motion is nearest to each waypoint it passes [s].

    A path may come by the same place again, so each is looked for only until it is left behind.
    """
    q, dt = plan.trajectory.q, plan.trajectory.dt
    step = float(np.abs(np.diff(q, axis=0)).max(initial=0.0))
    times, begin = [], 0
    for waypoint in passed:
        off = np.abs(q[begin:] - waypoint).max(axis=1)
        near = np.flatnonzero(off <= max(PASSING + step, float(off.min())))
        left = near[0] + np.argmax(np.append(off[near[0] :] > off[near[0]], True))
        begin += int(near[0] + np.argmin(off[near[0] : left + 1]))
        times.append(min(begin * dt, plan.duration))
    return times
