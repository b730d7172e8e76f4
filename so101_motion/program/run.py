"""A rehearsed program run: one motion of the arm from its start to its end, pauses included.

What moves is what was rehearsed, plan for plan. Only where a jaw has gripped something, and so
stands elsewhere than was thought, the next leg is planned anew from how things are. If somebody
else moves the arm meanwhile, the run ends; it does not fight.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from itertools import count

import numpy as np

from so101_motion.arm import Arm
from so101_motion.clock import Clock
from so101_motion.errors import Interrupted, MotionError, So101Error
from so101_motion.geometry import Array
from so101_motion.motion import Motion
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.plan import Plan
from so101_motion.program.rehearsal import Rehearsal, stands_at, told
from so101_motion.program.waypoints import Program
from so101_motion.rig_like import GripperLike
from so101_motion.units import to_rad

_SAME_JAW = to_rad(5.0)
"""A jaw that stands nearer than this to what a leg was planned with is as planned [rad]; chosen:
3 mm between the tips, less than a plan keeps clear of things by."""

_ARRIVED = to_rad(2.0)
"""An arm that stands nearer than this to its waypoint has arrived [rad], for not every arm keeps to
the last digit where it was sent; beyond, somebody has moved it. Chosen."""

_SAME_APERTURE = 0.02
"""An aperture nearer than this needs no motion; chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Where:
    """How far a run is.

    Attributes:
        round: Which time through, from 0.
        index: The waypoint it is on its way to, or at, from 0.
        doing: ``"moving"``, ``"jaw"`` or ``"pausing"``.
    """

    round: int = 0
    index: int = 0
    doing: str = "moving"


class ProgramRun:
    """A program being run; ``start_program`` makes it.

    Attributes:
        program: What is run.
        future: Completes after the last round, or raises what ended it; its message then begins
            with the waypoint.
        where: How far it is.
        plan: What the arm is moving along, or moved along last; None before.
    """

    def __init__(
        self, arm: Arm, gripper: GripperLike | None, clock: Clock, rehearsal: Rehearsal
    ) -> None:
        self.program: Program = rehearsal.program
        self.future: Future[None] = Future()
        self.where = Where()
        self.plan: Plan | None = None
        self._arm, self._gripper, self._clock = arm, gripper, clock
        self._rehearsal = rehearsal
        self._motion = arm.start_series(self._steps())
        self._motion.future.add_done_callback(self._ended)

    def stop(self) -> None:
        """End it early; the arm slows to rest. As ``Arm.stop``, but returns at once."""
        self._motion.interrupt("stop")

    @property
    def share(self) -> float:
        """How much of it is done, 0 to 1; of an endless one, how much of this round."""
        where, n = self.where, len(self.program)
        if self.program.rounds is None:
            return where.index / n
        return (where.round * n + where.index) / (self.program.rounds * n)

    # The arm's thread

    def _steps(self) -> Iterator[Plan | Callable[[Motion], None]]:
        rehearsal, program = self._rehearsal, self.program
        q, q_jaw = rehearsal.q_start, rehearsal.q_jaw_start
        for lap in count() if program.rounds is None else range(program.rounds):
            for index, waypoint in enumerate(program.waypoints):
                self.where = Where(round=lap, index=index)
                again = lap > 0 and index == 0
                leg = self._checked(rehearsal.back if again else rehearsal.legs[index], q, q_jaw)
                if leg is not None:
                    self.plan = leg
                    yield leg
                yield partial(self._stay, index)
                q = waypoint.q
                if self._gripper is not None and waypoint.aperture is not None:
                    q_jaw = self._gripper.angle_of(waypoint.aperture)

    def _checked(self, leg: Plan | None, q: Array, q_jaw: float) -> Plan | None:
        """The leg as it was planned, or planned anew from where arm and jaw really are."""
        state = self._arm.state
        if float(np.max(np.abs(q - state.q_ref))) > _ARRIVED:
            raise MotionError("the arm has been moved meanwhile; plan the program again")
        as_planned = stands_at(q, state.q_ref) and abs(state.q_jaw_ref - q_jaw) <= _SAME_JAW
        if leg is None or as_planned:
            return leg
        return self._arm.plan(JointGoal(q=leg.q_goal))

    def _stay(self, index: int, motion: Motion) -> None:
        waypoint, gripper = self.program.waypoints[index], self._gripper
        if gripper is not None and waypoint.aperture is not None:
            self.where = Where(round=self.where.round, index=index, doing="jaw")
            set_jaw(gripper, waypoint.aperture, motion)
        if waypoint.pause > 0.0:
            self.where = Where(round=self.where.round, index=index, doing="pausing")
            motion.pause(self._clock, waypoint.pause)

    def _ended(self, done: Future[None]) -> None:
        error = done.exception()
        if error is None:
            self.where = Where(round=self.where.round, index=len(self.program))
            self.future.set_result(None)
        elif isinstance(error, So101Error) and not isinstance(error, Interrupted):
            self.future.set_exception(told(error, self.program.called(self.where.index)))
        else:
            self.future.set_exception(error)


def start_program(
    arm: Arm, gripper: GripperLike | None, clock: Clock, rehearsal: Rehearsal
) -> ProgramRun:
    """Run a program that was rehearsed; supersedes what is under way.

    ``ProgramRun.stop``, ``Arm.stop`` and a newer motion of the arm end it at any point, in a pause
    too, and the jaw stops with it.

    Args:
        arm: As it was rehearsed with; it must stand where the rehearsal begins.
        gripper: Likewise.
        clock: Whose time the pauses take.
        rehearsal: What is run.
    """
    return ProgramRun(arm, gripper, clock, rehearsal)


def set_jaw(gripper: GripperLike, aperture: float, motion: Motion) -> None:
    """Open or close the jaw while the arm stands; what it closes on is gripped.

    Raises:
        Interrupted: The motion of the arm was ended; the jaw has been told to stop.
    """
    here = gripper.aperture
    if abs(aperture - here) <= _SAME_APERTURE or (gripper.is_holding and aperture < here):
        return
    moving = gripper.start_grab(aperture) if aperture < here else gripper.start_move(aperture)
    try:
        motion.wait_for(moving.future)
    except BaseException:
        moving.interrupt("stop")
        raise
