"""Plan a whole program before any of it moves.

A *leg* leads from one stop to the next; arms that it does not name stand still. Rounds and loops
add the legs back to where they begin, and those on which a jaw is different the second time. The
path to each passed waypoint is searched like any other; all of them in a row are one path for one
motion, which may be ``PASSING`` off it. If a corner cannot be rounded, the arm stops there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from so101_motion.arm.arm import START_TOLERANCE
from so101_motion.arm.cell import Cell, with_item
from so101_motion.arm.cell_member import Stand
from so101_motion.common.errors import ConfigError, PlanningError, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import JointGoal, PathGoal
from so101_motion.planning.picking.pick_plan import PickPlan
from so101_motion.planning.request import Plan
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.picking import place_from
from so101_motion.tasks.program.loops import Visit, times_in_round
from so101_motion.tasks.program.program import Program, Step, Waypoint
from so101_motion.tasks.program.solo import Arms, Solo

PASSING = to_rad(3.0)
"""How far any joint may be from a waypoint that is passed, and from the path between two [rad].
Chosen: of 2, 3, 5 and 8 degrees the smallest with which 45 random programs, at two pairs of caps,
were never slower than with stops; their tool was 5 mm off a waypoint at the median, 18 at most."""

AHEAD = 1000  # samples in which the next waypoint is looked for first: all is quadratic


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leg:
    """The planned motion to one stop."""

    indices: range  # its steps: those that are passed, and last the one that is stopped at
    plans: Mapping[str, Plan]  # the motion of each arm, by its name; none if all are there already
    at: tuple[float, ...]  # when each step is passed or reached, from the beginning [s]
    stands: Mapping[str, Stand]  # where each arm is before it, by its name
    picks: dict[str, PickPlan] = field(default_factory=dict)  # what arms pick there

    @property
    def seconds(self) -> float:
        """How long arms move [s]."""
        return self.at[-1] + max((each.duration for each in self.picks.values()), default=0.0)

    @property
    def plan(self) -> Plan | None:
        """The motion of the first arm; None if there is none."""
        return next(iter(self.plans.values()), None)


class Arrival(NamedTuple):
    """An arrival at a stop."""

    visit: Visit
    leg: Leg
    times: int  # how often it comes in a round: several times if a loop repeats it


@dataclass(frozen=True, kw_only=True, eq=False)
class Rehearsal:
    """A planned program."""

    program: Program  # the program
    # all arrivals in order, but only the first two of each loop and round; later ones are like the
    # second
    arrivals: tuple[Arrival, ...]

    @cached_property
    def legs(self) -> tuple[Leg, ...]:
        """All different legs, in order."""
        return tuple(dict.fromkeys(each.leg for each in self.arrivals))

    @property
    def stands(self) -> Mapping[str, Stand]:
        return self.arrivals[0].leg.stands

    @cached_property
    def first_round(self) -> tuple[Arrival, ...]:
        """The arrivals of the first round, of loops the first two times only."""
        return tuple(each for each in self.arrivals if each.visit.round == 0)

    @cached_property
    def duration(self) -> float:
        """How long arms move and pause in the first round [s]; the jaws' time comes on top."""
        pauses = [max(w.pause for w in step.values()) for step in self.program.steps]
        return sum(
            times * (leg.seconds + pauses[leg.indices[-1]]) for _, leg, times in self.first_round
        )

    @cached_property
    def steps_of_round(self) -> int:
        """How many steps the first round has, those of loops as often as they come."""
        return sum(each.times * len(each.visit.indices) for each in self.first_round)

    def leg_of(self, visit: Visit) -> Leg:
        """The leg to a stop that the running program comes to."""
        return self._leg_by_visit[_early(visit)]

    @cached_property
    def _leg_by_visit(self) -> dict[object, Leg]:
        return {_early(each.visit): each.leg for each in self.arrivals}


def _early(visit: Visit) -> tuple[int, tuple[int, ...], int]:
    """The same for all arrivals that are alike."""
    return min(visit.round, 1), tuple(min(lap, 1) for lap in visit.laps), visit.indices[-1]


LegPlanner = Callable[..., dict[str, Plan]]
"""Plans legs: ``plan_together`` of arms, or of a planner without one."""


def rehearse(arms: Arms, program: Program) -> Rehearsal:
    """Plan all of a program; moves nothing.

    Args:
        arms: Their caps, ranges and scenes count, and the program begins where they are.
        program: The program.

    Raises:
        PlanningError: A step cannot be planned; the message names it.
        ConfigError: There is no step, an arm is not there, or the program moves a jaw that its arm
            does not have.
    """
    program.refuse_empty()
    for name in program.arms:
        if name not in arms.members:
            if isinstance(arms, Solo):
                reason = "are several; `so101 cell run` or `so101 view --cell` runs their program"
                raise ConfigError("arms", ", ".join(program.arms), reason)
            known = ", ".join(sorted(arms.members))
            raise ConfigError("program", name, f"is no arm here; name one of them: {known}")
        moves_jaw = any(name in step and step[name].aperture is not None for step in program.steps)
        if moves_jaw and arms.members[name].gripper is None:
            raise ConfigError("program", "jaw", "moves a jaw, but this arm has none")
        if name in program.picking and arms.members[name].picker is None:
            reason = "is picked only by an arm of this computer, or by run_program on its machine"
            raise ConfigError("program", "item", reason)
    stands = arms.stands()
    scenes, upright = dict[str, Scene](), dict[str, Array]()  # as picking leaves them
    legs: dict[object, Leg] = {}
    arrivals: list[Arrival] = []
    caps = {name: arms.members[name].arm.limits for name in program.arms}
    for visit in program.visits(most=2):
        index = visit.indices[-1]
        where = tuple((each.q.tobytes(), each.q_jaw) for each in stands.values())
        key = visit.indices, where, frozenset(scenes.items())
        if key not in legs:
            together = partial(arms.plan_together, scenes=scenes)
            legs[key] = plan_leg(together, program, visit.indices, stands, caps)
        times = times_in_round(visit.laps, program.loops_around(index))
        arrivals.append(Arrival(visit, legs[key], times))
        stands = _after(arms, program.steps[index], stands)
        for name, each in program.steps[index].items():
            try:
                _pick(arms, legs[key], name, each, stands, scenes, upright)
            except ConfigError as error:
                named = f"{program.called(index)}: {error.key}"
                raise ConfigError(named, error.value, error.reason) from None
            except So101Error as error:
                raise error.about(program.called(index)) from None
    return Rehearsal(program=program, arrivals=tuple(arrivals))


def plan_leg(
    planner: LegPlanner,
    program: Program,
    indices: range,
    stands: Mapping[str, Stand],
    caps: Mapping[str, MotionLimits],
) -> Leg:
    """Plan the motion to the last of ``indices`` through the waypoints before it.

    The arms stand where ``stands`` has them. ``PlanningError`` names the step that cannot be
    reached.
    """
    here, limits = dict(stands), dict[str, MotionLimits]()
    for name in program.steps[indices[-1]]:
        share = min(program.steps[index][name].speed for index in indices)
        limits[name] = caps[name].eased(share)
    (name, *_), corners, numbers = limits, list[Array](), list[int]()  # of one that passes
    plans: dict[str, Plan] = {}
    for index in indices:
        goals = {name: each.q for name, each in program.steps[index].items()}
        if not all(stands_at(here[name].q, q) for name, q in goals.items()):
            wanted = {name: JointGoal(q=q) for name, q in goals.items()}
            plans = _planned(planner, program, index, wanted, limits, here)
            here |= {name: Stand(q, here[name].q_jaw) for name, q in goals.items()}
            corners += [*plans[name].path[1:]]
        numbers.append(len(corners))
    if not plans:
        return Leg(indices=indices, plans={}, at=(0.0,) * len(indices), stands=stands)
    if len({0, *numbers}) > 2:  # more than one of them is elsewhere
        goal = PathGoal(waypoints=np.array(corners), tolerance=PASSING)
        plans = _planned(planner, program, indices[-1], {name: goal}, limits, stands)
    corners = [stands[name].q, *corners]
    at = _passed_at(plans[name], [corners[number] for number in numbers[:-1]])
    ends = max(each.duration for each in plans.values())
    return Leg(indices=indices, plans=plans, at=(*at, ends), stands=stands)


def _pick(
    arms: Arms,
    leg: Leg,
    name: str,
    waypoint: Waypoint,
    stands: dict[str, Stand],
    scenes: dict[str, Scene],
    upright: dict[str, Array],
) -> None:
    """Plan what an arm picks after a leg, unless that is done; bring the item there."""
    picker, item = arms.members[name].picker, waypoint.item
    if item is None or picker is None:
        return
    scene, plan = scenes.get(name) or picker.around(), leg.picks.get(name)
    if plan is None:
        place, R = place_from(waypoint.place, scene), upright.get(item)
        plan = picker.plan(item, place, stand=stands[name], scene=scene, upright=R)
        leg.picks[name] = plan
    stands[name], upright[item] = Stand(*plan.at(plan.duration)), plan.R_base_item
    scenes[name] = plan.applied(scene, "end")
    put = next((each for each in scenes[name].items if each.name == item), None)
    members = arms.members if isinstance(arms, Cell) else {}
    for other in members.keys() - {name}:
        T = members[other].T_cell_base.inverse @ members[name].T_cell_base
        scenes[other] = with_item(scenes.get(other) or members[other].arm.scene, item, put, T)


def stands_at(q: Array, other: Array) -> bool:
    """Whether two configurations are equal enough for a motion to begin at either."""
    return float(np.max(np.abs(q - other))) <= START_TOLERANCE


def _after(arms: Arms, step: Step, stands: Mapping[str, Stand]) -> dict[str, Stand]:
    after = dict(stands)
    for name, each in step.items():
        gripper, q_jaw = arms.members[name].gripper, stands[name].q_jaw
        if gripper is not None and each.aperture is not None:
            q_jaw = gripper.angle_of(each.aperture)
        after[name] = Stand(each.q, q_jaw)
    return after


def _planned(
    planner: LegPlanner,
    program: Program,
    index: int,
    goals: Mapping[str, JointGoal | PathGoal],
    limits: Mapping[str, MotionLimits],
    stands: Mapping[str, Stand],
) -> dict[str, Plan]:
    try:
        return planner(goals, limits=limits, stands=stands)
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
        for ahead in (AHEAD, len(q)):
            off = np.abs(q[begin : begin + ahead] - waypoint).max(axis=1)
            near = np.flatnonzero(off <= max(PASSING + step, float(off.min())))
            from_here = off[near[0] :]
            # A path that turns back may drift a little before it comes nearer.
            left = np.argmax(np.append(from_here > np.minimum.accumulate(from_here) + step, True))
            if off[near[0]] <= PASSING + step and left < len(from_here):
                break
        begin += int(near[0] + np.argmin(from_here[: left + 1]))
        times.append(min(begin * dt, plan.duration))
    return times
