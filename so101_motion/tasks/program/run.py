"""Run a rehearsed program: one motion of the arm from its start to its end, pauses included.

The rehearsed plans are played as they are. Only if a jaw has gripped something, so that it is not
where the plan assumed, the next leg is planned again from the present state. If something else
moves the arm meanwhile, the run ends.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from so101_motion.arm.arm import Arm
from so101_motion.arm.gripper import move_jaw
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.clock import Clock
from so101_motion.common.errors import Interrupted, MotionError, PlanningError, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad
from so101_motion.planning.request import Plan
from so101_motion.rig.protocols import GripperLike
from so101_motion.tasks.program.program import Program
from so101_motion.tasks.program.rehearsal import (
    LegKey,
    ProgramLeg,
    Rehearsal,
    SceneArm,
    jaw_after,
    plan_leg,
    stands_at,
)

SAME_JAW = to_rad(5.0)
"""A jaw nearer than this to the angle that a leg was planned with counts as planned [rad]; chosen:
3 mm between the tips, less than the clearance of plans."""

ARRIVED = to_rad(2.0)
"""An arm nearer than this to its waypoint has arrived [rad], because not every arm stops exactly
there; farther away, something has moved it. Chosen."""

_LEAST = 0.01
"""Shortest time of a step that does not move the arm [s]: an endless row of those would block other
threads. Chosen: a control cycle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Where:
    """The progress of a run.

    Attributes:
        round: The round, counted from 0.
        laps: The repetition of each loop around the next stop, from 0, the outer loop first.
        index: The waypoint it is on its way to, or at, from 0.
        doing: ``"moving"``, ``"jaw"`` or ``"pausing"``.
    """

    round: int = 0
    laps: tuple[int, ...] = ()
    index: int = 0
    doing: str = "moving"


class ProgramRun:
    """A running program; made by ``start_program`` and ``run_once_planned``.

    Attributes:
        program: The program that runs.
        rehearsal: Its plans; None while they are being made.
        future: Completes after the last round, or raises what ended it; the message then begins
            with the waypoint.
        plan: The plan under way, or the last one; None before the first.
        motion: The run as a motion of the arm, to wait for or to interrupt.
    """

    def __init__(
        self,
        arm: Arm,
        gripper: GripperLike | None,
        clock: Clock,
        program: Program,
        planned: Callable[[Motion], Rehearsal],
    ) -> None:
        self.program = program
        self.rehearsal: Rehearsal | None = None
        self.future: Future[None] = Future()
        self.plan: Plan | None = None
        self._where = Where()
        self._under_way: tuple[ProgramLeg, float] | None = None  # and when it began
        self._done = 0  # waypoints that were passed or reached, in all rounds
        self._error: So101Error | None = None  # says itself which waypoint it is about
        self._arm, self._gripper, self._clock = arm, gripper, clock
        self._planned = planned
        self.motion = arm.start_series(self._steps())
        self.motion.future.add_done_callback(self._ended)

    def stop(self) -> None:
        """End the run early; the arm slows to rest. Like ``Arm.stop``, but returns at once."""
        self.motion.interrupt("stop")

    @property
    def where(self) -> Where:
        """The progress of the run."""
        where, under_way = self._where, self._under_way
        if under_way is None or where.doing != "moving":
            return where
        leg, began = under_way
        passed = bisect_right(leg.at[:-1], self._clock.now() - began)
        return replace(where, index=leg.indices[passed])

    @property
    def share(self) -> float:
        """How much of the run is done, 0 to 1; for an endless one, how much of this round."""
        rehearsal, rounds, where = self.rehearsal, self.program.rounds, self.where
        if rehearsal is None:
            return 0.0
        all_of_it = sum(each.times * len(each.visit.indices) for each in rehearsal.first_round)
        under_way = self._under_way
        passed = 0 if under_way is None else max(where.index - under_way[0].indices[0], 0)
        done = (self._done + passed) / all_of_it
        return done % 1.0 if rounds is None else done / rounds

    # The arm's thread

    def _steps(self) -> Iterator[Plan | Callable[[Motion], None]]:
        yield self._prepare
        rehearsal, waypoints = self.rehearsal, self.program.waypoints
        assert rehearsal is not None
        q, q_jaw = rehearsal.q_start, rehearsal.q_jaw_start
        for visit in self.program.visits():
            self._under_way = None
            self._where = Where(round=visit.round, laps=visit.laps, index=visit.indices[0])
            rehearsed = rehearsal.legs[LegKey(visit.origin, visit.indices, q_jaw)]
            leg = self._checked(rehearsed, q, q_jaw)
            if leg.plan is not None:
                self.plan = leg.plan
                self._under_way = leg, self._clock.now()
                yield leg.plan
            stop = waypoints[leg.indices[-1]]
            least = _LEAST if leg.plan is None else 0.0
            yield partial(self._stay, leg.indices[-1], max(stop.pause, least))
            self._under_way = None
            self._done += len(leg.indices)
            q, q_jaw = stop.q, jaw_after(self._gripper, stop.aperture, q_jaw)

    def _prepare(self, motion: Motion) -> None:
        try:
            self.rehearsal = self._planned(motion)
        except So101Error as error:
            self._error = error
            raise

    def _checked(self, leg: ProgramLeg, q: Array, q_jaw: float) -> ProgramLeg:
        """The planned leg, or a new plan if arm and jaw are elsewhere."""
        state = self._arm.state
        if float(np.max(np.abs(q - state.q_ref))) > ARRIVED:
            raise MotionError("the arm has been moved meanwhile; plan the program again")
        as_planned = stands_at(q, state.q_ref) and abs(state.q_jaw_ref - q_jaw) <= SAME_JAW
        if leg.plan is None or as_planned:
            return leg
        try:
            scene = None if self.rehearsal is None else self.rehearsal.scene
            planner = SceneArm(self._arm, scene)
            return plan_leg(planner, self.program, leg.indices, state.q_ref, state.q_jaw_ref)
        except PlanningError as error:
            self._error = error
            raise

    def _stay(self, index: int, pause: float, motion: Motion) -> None:
        waypoint, gripper = self.program.waypoints[index], self._gripper
        if gripper is not None and waypoint.aperture is not None:
            self._where = replace(self._where, index=index, doing="jaw")
            move_jaw(gripper, waypoint.aperture, motion)
        if pause > 0.0:
            self._where = replace(self._where, index=index, doing="pausing")
            motion.pause(self._clock, pause)

    def _ended(self, done: Future[None]) -> None:
        error = done.exception()
        self._where, self._under_way = self.where, None
        if error is None:
            self._where = Where(round=self._where.round, index=len(self.program))
            self.future.set_result(None)
        elif error is self._error or isinstance(error, Interrupted):
            self.future.set_exception(error)
        elif isinstance(error, So101Error):
            self.future.set_exception(error.about(self.program.called(self.where.index)))
        else:
            self.future.set_exception(error)


def start_program(
    arm: Arm, gripper: GripperLike | None, clock: Clock, rehearsal: Rehearsal
) -> ProgramRun:
    """Run a rehearsed program; supersedes what is under way.

    ``ProgramRun.stop``, ``Arm.stop`` and a newer motion of the arm end it at any point, in a pause
    too, and the jaw stops with it.

    Args:
        arm: The arm that it was rehearsed with; it must be where the rehearsal begins.
        gripper: Its jaw; None for an arm without one.
        clock: The clock that times the pauses.
        rehearsal: The planned program.
    """
    return ProgramRun(arm, gripper, clock, rehearsal.program, lambda _: rehearsal)


def run_once_planned(
    arm: Arm,
    gripper: GripperLike | None,
    clock: Clock,
    program: Program,
    planned: Callable[[Motion], Rehearsal],
) -> ProgramRun:
    """Plan a program as a whole once the arm rests, then run it; supersedes what is under way.

    It can be ended while it is being planned as well.

    Args:
        arm: The arm.
        gripper: Its jaw; None for an arm without one.
        clock: The clock that times the pauses.
        program: The program.
        planned: Plans it, with ``rehearse``; called on the arm's thread with the motion.
    """
    return ProgramRun(arm, gripper, clock, program, planned)
