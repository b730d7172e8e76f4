"""Run a rehearsed program: one motion of the arm from its start to its end, pauses included.

What moves is what was rehearsed, plan for plan. Only where a jaw has gripped something, and so
stands elsewhere than was thought, the next leg is planned anew from how things are. If somebody
else moves the arm meanwhile, the run ends; it does not fight.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from itertools import count

import numpy as np

from so101_motion.arm.arm import Arm
from so101_motion.arm.gripper import set_jaw
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.clock import Clock
from so101_motion.common.errors import Interrupted, MotionError, PlanningError, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad
from so101_motion.planning.request import Plan
from so101_motion.rig.protocols import GripperLike
from so101_motion.tasks.program.program import Program
from so101_motion.tasks.program.rehearsal import (
    ProgramLeg,
    Rehearsal,
    error_about,
    jaw_after,
    plan_leg,
    stands_at,
)

SAME_JAW = to_rad(5.0)
"""A jaw that stands nearer than this to what a leg was planned with is as planned [rad]; chosen:
3 mm between the tips, less than a plan keeps clear of things by."""

ARRIVED = to_rad(2.0)
"""An arm that stands nearer than this to its waypoint has arrived [rad], for not every arm keeps to
the last digit where it was sent; beyond, somebody has moved it. Chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Where:
    """The progress of a run.

    Attributes:
        round: Which time through, from 0.
        index: The waypoint it is on its way to, or at, from 0.
        doing: ``"moving"``, ``"jaw"`` or ``"pausing"``.
    """

    round: int = 0
    index: int = 0
    doing: str = "moving"


class ProgramRun:
    """A running program; made by ``start_program``.

    Attributes:
        program: What is run.
        future: Completes after the last round, or raises what ended it; its message then begins
            with the waypoint.
        plan: What the arm is moving along, or moved along last; None before.
    """

    def __init__(
        self, arm: Arm, gripper: GripperLike | None, clock: Clock, rehearsal: Rehearsal
    ) -> None:
        self.program: Program = rehearsal.program
        self.future: Future[None] = Future()
        self.plan: Plan | None = None
        self._where = Where()
        self._under_way: tuple[ProgramLeg, float] | None = None  # and when it began
        self._error: PlanningError | None = None  # says itself which waypoint it is about
        self._arm, self._gripper, self._clock = arm, gripper, clock
        self._rehearsal = rehearsal
        self._motion = arm.start_series(self._steps())
        self._motion.future.add_done_callback(self._ended)

    def stop(self) -> None:
        """End the run early; the arm slows to rest. Like ``Arm.stop``, but returns at once."""
        self._motion.interrupt("stop")

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
        """How much of the run is done, 0 to 1; of an endless one, how much of this round."""
        where, n = self.where, len(self.program)
        if self.program.rounds is None:
            return where.index / n
        return (where.round * n + where.index) / (self.program.rounds * n)

    # The arm's thread

    def _steps(self) -> Iterator[Plan | Callable[[Motion], None]]:
        rehearsal, program = self._rehearsal, self.program
        q, q_jaw = rehearsal.q_start, rehearsal.q_jaw_start
        for lap in count() if program.rounds is None else range(program.rounds):
            first = rehearsal.legs[0] if lap == 0 else rehearsal.back
            for rehearsed in filter(None, (first, *rehearsal.legs[1:])):
                self._under_way = None
                self._where = Where(round=lap, index=rehearsed.indices[0])
                leg = self._checked(rehearsed, q, q_jaw)
                if leg.plan is not None:
                    self.plan = leg.plan
                    self._under_way = leg, self._clock.now()
                    yield leg.plan
                stop = leg.indices[-1]
                yield partial(self._stay, stop)
                q = program.waypoints[stop].q
                q_jaw = jaw_after(self._gripper, program.waypoints[stop].aperture, q_jaw)

    def _checked(self, leg: ProgramLeg, q: Array, q_jaw: float) -> ProgramLeg:
        """The planned leg, or a new plan if arm and jaw are elsewhere."""
        state = self._arm.state
        if float(np.max(np.abs(q - state.q_ref))) > ARRIVED:
            raise MotionError("the arm has been moved meanwhile; plan the program again")
        as_planned = stands_at(q, state.q_ref) and abs(state.q_jaw_ref - q_jaw) <= SAME_JAW
        if leg.plan is None or as_planned:
            return leg
        try:
            return plan_leg(self._arm, self.program, leg.indices, state.q_ref, state.q_jaw_ref)
        except PlanningError as error:
            self._error = error
            raise

    def _stay(self, index: int, motion: Motion) -> None:
        waypoint, gripper = self.program.waypoints[index], self._gripper
        if gripper is not None and waypoint.aperture is not None:
            self._where = Where(round=self._where.round, index=index, doing="jaw")
            set_jaw(gripper, waypoint.aperture, motion)
        if waypoint.pause > 0.0:
            self._where = Where(round=self._where.round, index=index, doing="pausing")
            motion.pause(self._clock, waypoint.pause)

    def _ended(self, done: Future[None]) -> None:
        error = done.exception()
        self._where, self._under_way = self.where, None
        if error is None:
            self._where = Where(round=self._where.round, index=len(self.program))
            self.future.set_result(None)
        elif error is self._error or isinstance(error, Interrupted):
            self.future.set_exception(error)
        elif isinstance(error, So101Error):
            self.future.set_exception(error_about(error, self.program.called(self.where.index)))
        else:
            self.future.set_exception(error)


def start_program(
    arm: Arm, gripper: GripperLike | None, clock: Clock, rehearsal: Rehearsal
) -> ProgramRun:
    """Run a rehearsed program; supersedes what is under way.

    ``ProgramRun.stop``, ``Arm.stop`` and a newer motion of the arm end it at any point, in a pause
    too, and the jaw stops with it.

    Args:
        arm: As it was rehearsed with; it must stand where the rehearsal begins.
        gripper: Likewise.
        clock: Whose time the pauses take.
        rehearsal: What is run.
    """
    return ProgramRun(arm, gripper, clock, rehearsal)
