"""The requests to plan for several arms at once, and the plan of a handover.

The planning process gets these values and sends them back.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.collision.course import Course, OtherArm
from so101_motion.planning.collision.scene import Attached, as_seen_by
from so101_motion.planning.request import Plan, PlanRequest

T = TypeVar("T")


class TeamTask(Generic[T]):
    """A planning request of several motions, with the type of its plan."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TeamMember:
    """One of several arms that are planned together."""

    name: str  # its name in messages
    T_cell_base: SE3  # pose of its base in the cell
    request: PlanRequest  # its start and goal; its ``others`` are ignored

    @contextmanager
    def named(self) -> Iterator[None]:
        """Put its name in front of the planning errors of a block."""
        try:
            yield
        except PlanningError as error:
            raise error.about(self.name) from None

    def resting(self, q: Array) -> Course:
        """The arm at rest at ``q``, shape (5,), [rad]."""
        return Course.resting(q, self.request.q_jaw)

    def seen_from(self, other: TeamMember, course: Course) -> OtherArm:
        """This arm as another arm's request needs it."""
        return OtherArm(
            name=self.name,
            T_base_other=other.T_cell_base.inverse @ self.T_cell_base,
            course=course,
            attached=as_seen_by(other.name, self.request.scene.attached),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TeamRequest(TeamTask[dict[str, Plan]]):
    """Request for a common motion of several arms."""

    team: tuple[TeamMember, ...]  # the arms


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Handover:
    """A plan to pass an object on.

    Attributes:
        giver: The name of the arm that holds it.
        taker: The name of the arm that takes it.
        thing: The object in the giver's gripper.
        taken: The object in the taker's gripper.
        approach: The motion of each arm by its name, begun and ended together.
        take: The straight motion of the taker to the object.
        leave: The straight motion of the giver away from it.
        q_jaw_open: Angle of the taker's open jaw before it takes the object [rad].
        q_jaw_closed: Angle of the taker's jaw closed on the object [rad].
        q_jaw_free: Angle of the giver's open jaw while it leaves [rad].
    """

    giver: str
    taker: str
    thing: Attached
    taken: Attached
    approach: Mapping[str, Plan]
    take: Plan
    leave: Plan
    q_jaw_open: float
    q_jaw_closed: float
    q_jaw_free: float

    @property
    def duration(self) -> float:
        """How long the arms move [s], without the time for the jaws."""
        approach = max(each.duration for each in self.approach.values())
        return approach + self.take.duration + self.leave.duration


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandoverRequest(TeamTask[Handover]):
    """Request to pass an object from one arm to another."""

    # all arms of the cell from where they are; their goals are ignored
    team: tuple[TeamMember, ...]
    giver: str  # the name of the arm that holds the object
    taker: str  # the name of the arm that shall take it
    thing: str  # the object's name among those the giver holds
