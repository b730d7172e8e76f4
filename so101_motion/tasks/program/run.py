"""Run a rehearsed program: one motion of each arm from its start to its end, pauses included.

Plans are played as they are. If a jaw has gripped something, the next leg is planned again.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from threading import Lock

import numpy as np

from so101_motion.arm.gripper import move_jaw
from so101_motion.arm.motion_handle import Motion, Step
from so101_motion.arm.picking import PickRun
from so101_motion.arm.team_motion import TeamStep
from so101_motion.common.attributes import checked_number
from so101_motion.common.errors import Interrupted, MotionError, PlanningError, So101Error
from so101_motion.common.units import to_rad
from so101_motion.planning.request import Plan
from so101_motion.planning.timing.torque import slowed
from so101_motion.tasks.picking import place_from
from so101_motion.tasks.program.loops import Visit
from so101_motion.tasks.program.program import ARM, SLOWEST, Program, Waypoint
from so101_motion.tasks.program.rehearsal import Leg, Rehearsal, plan_leg, stands_at
from so101_motion.tasks.program.solo import Arms

SAME_JAW = to_rad(5.0)
"""A jaw nearer than this to the angle that a leg was planned with counts as planned [rad]; chosen:
3 mm between the tips, less than the clearance of plans."""

ARRIVED = to_rad(2.0)
"""An arm nearer than this to its waypoint has arrived [rad], because not every arm stops exactly
there; farther away, something has moved it. Chosen."""

_LEAST = 0.01  # [s] of a step without motion, or an endless row of those blocks other threads


@dataclass(frozen=True, slots=True, kw_only=True)
class Where:
    """The progress of a run."""

    round: int = 0  # the round, counted from 0
    laps: tuple[int, ...] = ()  # repetition of each loop around the next stop, the outer one first
    index: int = 0  # the step that is gone to, or done, from 0
    doing: str = "moving"  # ``"moving"``, ``"picking"``, ``"jaw"`` or ``"pausing"``


class ProgramRun:
    """A running program; supersedes what is under way.

    ``stop``, a stop of an arm and a newer motion of one end it for all at any point, in a pause and
    while it is being planned too, and the jaws stop with it.

    ``planned`` plans it, with ``rehearse``, on the thread of an arm once the arms rest. ``future``
    completes after the last round, or raises what ended it; the message begins with the step.
    ``motions`` are the run as a motion of each arm, to wait for or to interrupt. ``speed`` is a
    share of the planned speed, up to 1; a change takes effect at the next stop.
    """

    def __init__(
        self,
        arms: Arms,
        program: Program,
        planned: Callable[[], Rehearsal],
        *,
        speed: float = 1.0,
    ) -> None:
        program.refuse_empty()
        self.speed = speed
        self.program = program
        self.rehearsal: Rehearsal | None = None
        self.future: Future[None] = Future()
        self.leg: Leg | None = None
        self._where = Where()
        self._began: float | None = None  # when the leg under way began
        self._done = 0  # steps that were passed or reached before it, in all rounds
        self._error: So101Error | None = None  # says itself which step it is about
        self._picks = dict[str, PickRun]()  # the last of each arm
        self._departed = False  # whether things are elsewhere than rehearsed
        self._arms, self._planned = arms, planned
        self._now = arms.clock.now
        self.motions = arms.start_series(self._steps())
        self._left, self._lock = len(self.motions), Lock()
        for motion in self.motions.values():
            motion.future.add_done_callback(self._ended)

    def stop(self) -> None:
        """End the run early; all arms slow to rest. Returns at once."""
        for motion in self.motions.values():
            motion.interrupt("stop")

    @property
    def where(self) -> Where:
        where, leg, began = self._where, self.leg, self._began
        if leg is None or began is None or where.doing != "moving":
            return where
        passed = bisect_right(leg.at[:-1], self._now() - began)
        return replace(where, index=leg.indices[passed])

    @property
    def share(self) -> float:
        """How much of the run is done, 0 to 1; for an endless one, how much of this round."""
        rehearsal, rounds, leg = self.rehearsal, self.program.rounds, self.leg
        if rehearsal is None:
            return 0.0
        passed = 0
        if leg is not None and self._began is not None:
            passed = max(self.where.index - leg.indices[0], 0)
        done = (self._done + passed) / rehearsal.steps_of_round
        return done % 1.0 if rounds is None else done / rounds

    # The arms' threads

    def _steps(self) -> Iterator[TeamStep]:
        for visit in self.program.visits():
            step = self.program.steps[visit.indices[-1]]
            then = {name: self._does(name, each) for name, each in step.items()}
            yield TeamStep(partial(self._ready, visit), then)

    def _ready(self, visit: Visit) -> Future[dict[str, Plan]]:
        """The plans of the next leg; called when all arms rest and are done with the last."""
        self._finish_leg()
        self._where = Where(round=visit.round, laps=visit.laps, index=visit.indices[0])
        try:
            if self.rehearsal is None:
                self.rehearsal = self._planned()
        except So101Error as error:
            self._error = error
            raise
        if self.program.picking and max((visit.round, *visit.laps)) > 1:
            self._departed = True  # rehearsed only twice
        leg = _slowed(self._checked(self.rehearsal.leg_of(visit)), self.speed)
        plans = self._arms.check_again(leg.plans)
        self.leg, self._began = leg, self._now()
        return plans

    def _finish_leg(self) -> None:
        if self.leg is not None and self._began is not None:
            self._began, self._done = None, self._done + len(self.leg.indices)

    def _checked(self, leg: Leg) -> Leg:
        """The planned leg, or a new plan if an arm or a jaw is elsewhere."""
        as_planned = not self._departed
        for name, stand in self._arms.stands().items():
            planned = leg.stands[name]
            if not self._departed and float(np.max(np.abs(planned.q - stand.q))) > ARRIVED:
                arm = "the arm" if name == ARM else name
                raise MotionError(f"{arm} has been moved meanwhile; plan the program again")
            same_jaw = abs(stand.q_jaw - planned.q_jaw) <= SAME_JAW
            as_planned = as_planned and same_jaw and stands_at(planned.q, stand.q)
        if as_planned or (not leg.plans and not self._departed):
            return leg
        caps = {name: self._arms.members[name].arm.limits for name in self.program.arms}
        pickers = {name: self._arms.members[name].picker for name in self.program.picking}
        scenes = {name: each.around() for name, each in pickers.items() if each is not None}
        together = partial(self._arms.plan_together, scenes=scenes)
        try:
            anew = plan_leg(together, self.program, leg.indices, self._arms.stands(), caps)
            return replace(anew, picks=leg.picks)
        except PlanningError as error:
            self._error = error
            raise

    def _does(self, name: str, waypoint: Waypoint) -> Iterator[Step]:
        """What an arm does when it has arrived."""
        picker, leg = self._arms.members[name].picker, self.leg
        assert leg is not None
        if waypoint.item is not None and picker is not None:
            self._where = replace(self._where, index=leg.indices[-1], doing="picking")
            planned = None if self._departed else leg.picks.get(name)
            place = place_from(waypoint.place, picker.around())
            run = PickRun(picker, waypoint.item, place, planned=planned)
            self._picks[name], run.share = run, self.speed
            run.watch(self.motions[name])
            yield from run.steps()
            self._departed |= run.plan is not planned
        yield partial(self._stay, name, waypoint)

    def _stay(self, name: str, waypoint: Waypoint, motion: Motion) -> None:
        member, leg = self._arms.members[name], self.leg
        assert leg is not None
        index = leg.indices[-1]
        if member.gripper is not None and waypoint.aperture is not None:
            self._where = replace(self._where, index=index, doing="jaw")
            move_jaw(member.gripper, waypoint.aperture, motion)
        pause = max(waypoint.pause, 0.0 if leg.plans else _LEAST)
        if pause > 0.0:
            self._where = replace(self._where, index=index, doing="pausing")
            motion.pause_until(member.clock, member.clock.now() + pause)

    def _problem(self, name: str) -> BaseException | None:
        """What ended the motion of an arm early; in the words of its picking, if that did."""
        error, pick = self.motions[name].future.exception(), self._picks.get(name)
        is_its = pick is not None and (pick.is_lost or self._where.doing == "picking")
        return pick.told(error) if pick and is_its and isinstance(error, So101Error) else error

    def _ended(self, _: Future[None]) -> None:
        with self._lock:
            self._left -= 1
            if self._left > 0:
                return
        ended = {name: self._problem(name) for name in self.motions}
        problems = [(name, error) for name, error in ended.items() if error is not None]
        if not problems:
            self._finish_leg()
            self._where = Where(round=self._where.round, index=len(self.program))
            self.future.set_result(None)
            return
        self._where, self._began = self.where, None
        name, cause = next((p for p in problems if not isinstance(p[1], Interrupted)), problems[0])
        named = isinstance(cause, Interrupted) or cause is self._error
        if isinstance(cause, So101Error) and not named:
            whose = f", {name}" * (len(ended) > 1)
            cause = cause.about(f"{self.program.called(self._where.index)}{whose}")
        self.future.set_exception(cause)


def _slowed(leg: Leg, share: float) -> Leg:
    """The leg at this share of its speed; the arms pass the same points together."""
    checked_number("speed", share, lower=SLOWEST, upper=1.0, unit="of the planned speed")
    if share == 1.0:
        return leg

    def eased(plans: Mapping[str, Plan]) -> dict[str, Plan]:
        return {
            name: replace(plan, trajectory=slowed(plan.trajectory, 1.0 / share))
            for name, plan in plans.items()
        }

    picks = {name: replace(each, plans=eased(each.plans)) for name, each in leg.picks.items()}
    at = tuple(t / share for t in leg.at)
    return replace(leg, plans=eased(leg.plans), picks=picks, at=at)


def start_program(arms: Arms, rehearsal: Rehearsal, *, speed: float = 1.0) -> ProgramRun:
    """Run a rehearsed program on its arms, which must be where the rehearsal begins.

    ``speed`` is a share of the planned speed, ``SLOWEST`` to 1.
    """
    return ProgramRun(arms, rehearsal.program, lambda: rehearsal, speed=speed)
