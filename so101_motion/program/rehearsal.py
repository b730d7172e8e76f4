"""A whole program planned before any of it moves.

A *leg* leads to one waypoint from the one before, with the jaw as that one leaves it. The first leg
starts where the arm stands; a program that is gone through more than once has one more, from the
last waypoint back to the first, so from the second round on nothing is left to chance. What cannot
be planned is refused here, by the name of its waypoint.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from so101_motion.arm import START_TOLERANCE, Arm
from so101_motion.errors import ConfigError, PlanningError, So101Error
from so101_motion.geometry import Array
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.plan import Plan
from so101_motion.program.waypoints import Program
from so101_motion.rig_like import GripperLike

E = TypeVar("E", bound=So101Error)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rehearsal:
    """A program, planned.

    Attributes:
        program: What was planned.
        legs: The way to each waypoint, the first from where the arm stood; None where the arm
            stands there already and only the jaw has something to do.
        back: The way from the last waypoint to the first, for further rounds; else None.
        q_start: Where the arm stood, shape (5,), [rad].
        q_jaw_start: Where the jaw stood [rad].
    """

    program: Program
    legs: tuple[Plan | None, ...]
    back: Plan | None
    q_start: Array
    q_jaw_start: float

    @property
    def plans(self) -> tuple[Plan, ...]:
        """The ways of one round, one after the other."""
        return tuple(leg for leg in self.legs if leg is not None)

    @property
    def duration(self) -> float:
        """How long the arm moves and pauses in the first round [s]; the jaw's time comes on top."""
        pauses = sum(waypoint.pause for waypoint in self.program.waypoints)
        return sum(plan.duration for plan in self.plans) + pauses


def rehearse(arm: Arm, gripper: GripperLike | None, program: Program) -> Rehearsal:
    """Plan all of a program; moves nothing.

    Args:
        arm: Whose caps, range and scene count, and where it begins.
        gripper: The arm's jaw; None for an arm without one.
        program: What is to be done.

    Raises:
        PlanningError: A waypoint cannot be gone to, and which.
        ConfigError: There is no waypoint, or a jaw is asked for that is not there.
    """
    if not program.waypoints:
        raise ConfigError("program", "empty", "has no waypoint; record one first")
    if gripper is None and any(each.aperture is not None for each in program.waypoints):
        raise ConfigError("program", "jaw", "moves a jaw, but this arm has none")
    state = arm.state
    q, q_jaw = state.q_ref, state.q_jaw_ref
    legs: list[Plan | None] = []
    for index, waypoint in enumerate(program.waypoints):
        legs.append(_leg(arm, program, index, q, q_jaw))
        q, q_jaw = waypoint.q, jaw_after(gripper, waypoint.aperture, q_jaw)
    back = None if program.rounds == 1 else _leg(arm, program, 0, q, q_jaw)
    return Rehearsal(
        program=program,
        legs=tuple(legs),
        back=back,
        q_start=state.q_ref,
        q_jaw_start=state.q_jaw_ref,
    )


def jaw_after(gripper: GripperLike | None, aperture: float | None, q_jaw: float) -> float:
    """Where the jaw is [rad] after a waypoint, coming with ``q_jaw``."""
    if gripper is None or aperture is None:
        return q_jaw
    return gripper.angle_of(aperture)


def stands_at(q: Array, other: Array) -> bool:
    """Whether two postures are one: what begins at the one may begin at the other."""
    return float(np.max(np.abs(q - other))) <= START_TOLERANCE


def told(error: E, about: str) -> E:
    """The same error, saying first what it is about."""
    copied = copy.copy(error)
    copied.args = (f"{about}: {error}",)
    return copied


def _leg(arm: Arm, program: Program, index: int, q_start: Array, q_jaw: float) -> Plan | None:
    goal = JointGoal(q=program.waypoints[index].q)
    if stands_at(q_start, goal.q):
        return None
    try:
        return arm.plan(goal, q_start=q_start, q_jaw=q_jaw)
    except PlanningError as error:
        raise told(error, program.called(index)) from None
