"""Plan a program of several arms as a whole, and run it.

Each step is one motion of all arms, planned from where the step before ends; arms that it does not
name stand still. Rounds and loops are planned twice, because later times are like the second. The
planned motions are played as they are. Only if a jaw has gripped something, so that it is not where
the plan assumed, the step is planned again when all arms are there.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from so101_motion.arm.cell import Cell
from so101_motion.arm.cell_member import Stand
from so101_motion.arm.gripper import move_jaw
from so101_motion.arm.team_motion import TeamStep
from so101_motion.common.errors import Interrupted, MotionError, PlanningError, So101Error
from so101_motion.planning.goals import Goal, JointGoal
from so101_motion.tasks.program.cell_program import CellProgram
from so101_motion.tasks.program.loops import Visit, times_in_round
from so101_motion.tasks.program.run import ARRIVED, SAME_JAW, Where

if TYPE_CHECKING:
    from so101_motion.arm.motion_handle import Motion
    from so101_motion.planning.request import Plan
    from so101_motion.planning.timing.limits import MotionLimits
    from so101_motion.tasks.program.program import Waypoint


class PlannedStep(NamedTuple):
    """An arrival at a step.

    Attributes:
        visit: The arrival.
        times: How often it comes in a round: several times if a loop repeats it.
        plans: The plan of each arm, by its name.
        stands: Where each arm is before the step, by its name.
    """

    visit: Visit
    times: int
    plans: Mapping[str, Plan]
    stands: Mapping[str, Stand]

    @property
    def step_index(self) -> int:
        """Which step it is."""
        return self.visit.indices[-1]

    @property
    def duration(self) -> float:
        """How long its motion takes [s]."""
        return max(each.duration for each in self.plans.values())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellRehearsal:
    """A planned program of several arms.

    Attributes:
        program: The program.
        steps: All arrivals in order, but only the first two of each loop and round; later ones are
            like the second.
    """

    program: CellProgram
    steps: tuple[PlannedStep, ...]

    @property
    def first_round(self) -> tuple[PlannedStep, ...]:
        """The arrivals of the first round, of loops the first two times only."""
        return tuple(each for each in self.steps if each.visit.round == 0)

    @property
    def duration(self) -> float:
        """How long the motions of the first round take [s]."""
        return sum(each.times * each.duration for each in self.first_round)


def rehearse_cell(cell: Cell, program: CellProgram) -> CellRehearsal:
    """Plan all of a program of several arms; moves nothing.

    Raises:
        PlanningError: A step cannot be planned; the message names it.
        ConfigError: An arm of the program is not in the cell.
    """
    stands: Mapping[str, Stand] = cell.stands()
    known: dict[object, dict[str, Plan]] = {}
    steps: list[PlannedStep] = []
    for visit in program.visits(most=2):
        index = visit.indices[-1]
        key = index, tuple((each.q.tobytes(), each.q_jaw) for each in stands.values())
        if key not in known:
            known[key] = _planned(cell, program, index, stands)
        times = times_in_round(visit.laps, program.loops_around(index))
        steps.append(PlannedStep(visit, times, known[key], stands))
        stands = _after(cell, program.steps[index], stands)
    return CellRehearsal(program=program, steps=tuple(steps))


def _planned(
    cell: Cell, program: CellProgram, index: int, stands: Mapping[str, Stand]
) -> dict[str, Plan]:
    goals, limits = _asked(cell, program.steps[index])
    try:
        return cell.start_plan(goals, limits=limits, stands=stands).result()
    except PlanningError as error:
        raise error.about(program.called(index)) from None


def _asked(
    cell: Cell, step: Mapping[str, Waypoint]
) -> tuple[dict[str, Goal], dict[str, MotionLimits]]:
    goals: dict[str, Goal] = {name: JointGoal(q=each.q) for name, each in step.items()}
    members = cell.members
    eased = {
        name: members[name].arm.limits.eased(each.speed)
        for name, each in step.items()
        if name in members
    }
    return goals, eased


def _after(
    cell: Cell, step: Mapping[str, Waypoint], stands: Mapping[str, Stand]
) -> dict[str, Stand]:
    """Where the arms are after a step."""
    after = dict(stands)
    for name, waypoint in step.items():
        q_jaw = stands[name].q_jaw
        if waypoint.aperture is not None:
            q_jaw = cell.members[name].gripper.angle_of(waypoint.aperture)
        after[name] = Stand(waypoint.q, q_jaw)
    return after


class CellProgramRun:
    """A running program of several arms; made by ``start_cell_program``.

    Attributes:
        program: The program that runs.
        future: Completes after the last round, or raises what ended it; the message then begins
            with the step.
        where: The progress of the run.
    """

    def __init__(self, cell: Cell, rehearsal: CellRehearsal) -> None:
        self.program = rehearsal.program
        self.future: Future[None] = Future()
        self.where = Where()
        self._cell, self._rehearsal, self._lock = cell, rehearsal, threading.Lock()
        self._motions = cell.start_series(self._steps())
        self._left = len(self._motions)
        for motion in self._motions.values():
            motion.future.add_done_callback(self._ended)

    def stop(self) -> None:
        """End the run early; all arms slow to rest. Returns at once."""
        for motion in self._motions.values():
            motion.interrupt("stop")

    def _steps(self) -> Iterator[TeamStep]:
        planned = {_early(each.visit): each for each in self._rehearsal.steps}
        for visit in self.program.visits():
            index = visit.indices[-1]
            stays = self.program.steps[index].items()
            then = {name: partial(self._stay, name, each) for name, each in stays}
            where = Where(round=visit.round, laps=visit.laps, index=index)
            yield TeamStep(partial(self._ready, where, planned[_early(visit)]), then)

    def _ready(self, where: Where, planned: PlannedStep) -> Future[dict[str, Plan]]:
        """Check that all arms are where the next step begins; returns its plans."""
        self.where = where
        cell, as_planned = self._cell, True
        for name, member in cell.members.items():
            state, stand = member.arm.state, planned.stands[name]
            if float(np.max(np.abs(stand.q - state.q_ref))) > ARRIVED:
                raise MotionError(f"{name} has been moved meanwhile; plan the program again")
            as_planned = as_planned and abs(state.q_jaw_ref - stand.q_jaw) <= SAME_JAW
        if as_planned:
            return cell.check_again(planned.plans)
        goals, limits = _asked(cell, self.program.steps[where.index])
        return cell.start_plan(goals, limits=limits)

    def _stay(self, name: str, waypoint: Waypoint, motion: Motion) -> None:
        member = self._cell.members[name]
        if waypoint.aperture is not None:
            move_jaw(member.gripper, waypoint.aperture, motion)
        if waypoint.pause > 0.0:
            motion.pause(member.clock, waypoint.pause)

    def _ended(self, _: Future[None]) -> None:
        with self._lock:
            self._left -= 1
            if self._left > 0:
                return
        errors = [each.future.exception() for each in self._motions.values()]
        problems = [each for each in errors if each is not None]
        if not problems:
            self.where = Where(round=self.where.round, index=len(self.program.steps))
            self.future.set_result(None)
            return
        cause = next((e for e in problems if not isinstance(e, Interrupted)), problems[0])
        if isinstance(cause, So101Error) and not isinstance(cause, Interrupted):
            cause = cause.about(self.program.called(self.where.index))
        self.future.set_exception(cause)


def _early(visit: Visit) -> tuple[int, tuple[int, ...], int]:
    """The planned arrival that is like this one."""
    return min(visit.round, 1), tuple(min(lap, 1) for lap in visit.laps), visit.indices[-1]


def start_cell_program(cell: Cell, rehearsal: CellRehearsal) -> CellProgramRun:
    """Run a rehearsed program of several arms; supersedes what is under way.

    Stopping one arm ends it for all, at any point, in a pause too.

    Args:
        cell: The cell that it was rehearsed with; its arms must be where the rehearsal begins.
        rehearsal: The planned program.
    """
    return CellProgramRun(cell, rehearsal)
