"""Keep one arm of a cell away from the others, in every control cycle and when it plans.

``cell.py`` explains how arms keep apart.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from so101_motion.common.errors import MotionError
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.modes import Mode
from so101_motion.planning.among import crosses, crossing, delayed
from so101_motion.planning.collision.apart import EARLY, GUARDED, Moving, first_meeting
from so101_motion.planning.collision.arm_bodies import ArmBodies, bodies_of
from so101_motion.planning.collision.course import Course, NearArms, OtherArm, stop_along
from so101_motion.planning.collision.following_apart import Beside, close, following_apart
from so101_motion.planning.collision.scene import Attached, as_seen_by

if TYPE_CHECKING:
    from so101_motion.arm.arm import Arm
    from so101_motion.arm.gripper import Gripper
    from so101_motion.arm.picking import Picker
    from so101_motion.arm.planning_worker import PlanningWorker
    from so101_motion.common.clock import Clock
    from so101_motion.control.executor import Executor
    from so101_motion.planning.timing.trajectory import Trajectory

_log = logging.getLogger(__name__)

ALL = "*"
"""The name that stands for all arms."""

LATER, LATEST = 0.1, 2.0
"""Steps by which the begin of a planned motion is delayed, and the longest delay [s]; chosen."""

PROMPT = 0.5 * EARLY
"""A motion that was checked together with others' must begin within this time [s]; the check allows
for twice as much."""

LEAD = 0.05
"""A common motion begins so long after its plan is there [s]. Chosen: by then all arms wait for the
same moment. With 10 ms, arms of a busy computer came up to 127 ms late in eight of ten handovers;
with 50 ms those of three came at most 1 ms late (simulated, beside four programs on two cores). It
also has to be longer than an arm at rest is looked at, which takes up to 6 ms."""

GOES_ON = 0.2
"""An arm that is moved by hand is taken to keep its velocity for so long [s]; chosen."""

TOUCHING = 0.5 * GUARDED
"""Arms that are nearer than this count as touching each other [m]. Chosen: a wall that a hand feels
keeps them further apart."""


FAR = 1.5
"""Arms whose bases are farther apart do not meet [m], if none has a tool or holds something: each
reaches 0.45 m."""


class RigWithExecutor(Protocol):
    """An arm with the control loop that moves it, such as a ``Rig``."""

    arm: Arm
    executor: Executor
    clock: Clock
    planner: PlanningWorker
    gripper: Gripper

    @property
    def picker(self) -> Picker: ...


class Stand(NamedTuple):
    """Where an arm is: its joints, shape (5,), and its jaw [rad]."""

    q: Array
    q_jaw: float


class SharedSpace:
    """What the arms of a cell have in common.

    Attributes:
        lock: Of all courses; held for moments, in control cycles too.
        entry: Of all planned motions; held while one is checked.
        members: The arms, by name.
    """

    def __init__(self) -> None:
        self.lock, self.entry = threading.Lock(), threading.Lock()
        self.members: Mapping[str, CellMember] = {}


class CellMember:
    """One arm in a cell: what it knows of the others, and they of it. ``Cell.add`` makes it.

    Attributes:
        name: What messages call the arm.
        arm: The arm.
        T_cell_base: Pose of its base.
        gripper: Its jaw.
        clock: The arm's clock.
        worker: Plans for it.
        against: Why the last setpoint that was refused was refused, for messages.
        held: What arms hold beside what their scenes say, by the arm's name, as this one knows it.
    """

    def __init__(
        self,
        space: SharedSpace,
        name: str,
        rig: RigWithExecutor,
        T_cell_base: SE3,
        ignores: frozenset[str] = frozenset(),
    ) -> None:
        self.name, self.arm, self.T_cell_base, self.against = name, rig.arm, T_cell_base, ""
        self.gripper, self.clock, self.worker = rig.gripper, rig.clock, rig.planner
        self.held = dict[str, tuple[Attached, ...]]()
        self._space, self._now, self._ignores = space, rig.clock.now, ignores
        self._executor, self.picker = rig.executor, rig.picker
        self._expected: Trajectory | None = None  # one that was checked together with others'
        self._course: Course | None = None
        self._planned: Course | None = None
        self._beside: dict[str, Beside] = {}  # by name of the other arm
        # The members of the cell, and those of them that are minded.
        self._known: tuple[Mapping[str, CellMember], list[CellMember]] = ({}, [])
        bodies_of()  # made before the control loop needs it

    def __repr__(self) -> str:
        return f"<CellMember {self.name}: {self.arm!r}>"

    @property
    def minded(self) -> frozenset[str]:
        return frozenset(each.name for each in self._neighbours())

    # Planned motions

    @property
    def stand(self) -> Stand:
        state = self.arm.state
        return Stand(state.q_ref, state.q_jaw_ref)

    def others(self) -> tuple[OtherArm, ...]:
        """The other arms, for a plan that is made now."""
        now = self._now()
        return tuple(
            each.seen_from(self, each.plan_at(now).since(now)) for each in self._neighbours()
        )

    @contextmanager
    def entered(
        self, trajectory: Trajectory, pause_until: Callable[[float], None]
    ) -> Iterator[Trajectory]:
        """Publish that a planned motion begins now, and yield it; it is over when the block ends.

        ``pause_until`` waits for the time [s] of a common motion. What is yielded may wait first.

        Raises:
            InCollision: It crosses another arm's motion, even if it begins later.
            MotionError: It is part of a common motion for which this arm was ready too late, and
                would meet another arm now.
        """
        planned = self._planned if self._expected is trajectory else None  # of a common motion
        try:
            if planned is not None:
                pause_until(planned.t)
            with self._space.entry:
                with self._space.lock:
                    self._beside.clear()  # a plan begins where the arm rests, and only leads away
                late = math.inf if planned is None else self._now() - planned.t
                self._expected = None
                wait, other = 0.0, ""
                if late > PROMPT:  # the check of before does not hold for it
                    wait, other = self._wait_for(trajectory, late)
                    self._planned = self.along(trajectory, self._now() + wait)
            if wait:
                _log.info("%s waits %.1f s more before it moves, for %s", self.name, wait, other)
            yield delayed(trajectory, wait)
        finally:
            self._planned = self._expected = None

    def expect(self, trajectory: Trajectory, begin: float) -> None:
        """Publish a motion that begins at ``begin`` [s] and was checked with those of others."""
        self._planned, self._expected = self.along(trajectory, begin), trajectory
        self._executor.await_motion(begin + PROMPT)

    def _wait_for(self, trajectory: Trajectory, late: float) -> tuple[float, str]:
        """How long a motion must still wait [s], and for which arm; nobody if it need not.

        It is ``late`` [s] for a common one, without end if it is not part of one.
        """
        met, now = None, 0.0
        for wait in np.arange(0.0, LATEST, LATER):
            now = self._now()
            others = [each.seen_from(self, each.plan_at(now)) for each in self._neighbours()]
            course = self.along(trajectory, now + float(wait))
            before, met = met, crossing(self.attached_to(self), course, others, since=now)
            if met is None:
                return float(wait), "" if before is None else before[0]
        assert met is not None
        if math.isinf(late):
            raise crosses(*met, since=now)
        raise MotionError(
            f"its part of the common motion was ready {late:.2f} s too late, and would meet"
            " another arm now; check how busy the computer is, then plan again"
        )

    def along(self, trajectory: Trajectory, t: float) -> Course:
        """The course of a motion that begins at ``t`` [s]."""
        return Course.along(trajectory, self._q_jaw, t=t)

    def plan_at(self, now: float) -> Course:
        """The course of its planned motion, or of its stop if there is none."""
        planned = self._planned
        if planned is None or now >= planned.end:
            return self.course_at(now)
        has_ended = self._expected is not None and now > planned.t + PROMPT  # before it began
        return self.course_at(now) if has_ended else planned

    @property
    def can_meet(self) -> bool:
        """See ``Neighbours``; an arm that cannot may be late, because no other relies on it."""
        here, others = self.T_cell_base.p, self._neighbours()
        if any(each.attached_to(each) for each in (self, *others)):
            return bool(others)
        return any(math.dist(here, each.T_cell_base.p) < FAR for each in others)

    # Every tick

    def near(self) -> list[NearArms]:
        """What of other arms was near at the last call of ``admits``; see ``Neighbours``."""
        known = [(other.name, self._beside.get(other.name)) for other in self._neighbours()]
        return [each.near(name) for name, each in known if each is not None and each.count]

    def near_at(self, q: Array) -> list[NearArms]:
        """What of other arms is near now, for an arm that rests at ``q``; see ``Neighbours``."""
        now = self._now()
        course = self._stop(q[None], 1.0, now)
        with self._space.lock:
            for other in self._neighbours():
                self._memory_of(other).look(*self._pair(course, other, other.course_at(now)), now)
        return self.near()

    def admits(self, q: Array, dt: float) -> bool:
        """Whether the arm may go on so that it could stop along ``q``; see ``Neighbours``."""
        now = self._now()
        course = self._stop(q, dt, now)
        with self._space.lock:
            for other in self._neighbours():
                pair = self._pair(course, other, other.course_at(now))
                meeting = following_apart(*pair, since=now, beside=self._memory_of(other))
                if meeting is not None:
                    self.against = close(meeting.first, other.name, meeting.second)
                    return False
            self._course = course
        return True

    def _memory_of(self, other: CellMember) -> Beside:
        if other.name not in self._beside:
            self._beside[other.name] = Beside()
        return self._beside[other.name]

    def _pair(
        self, course: Course, other: CellMember, others: Course
    ) -> tuple[Moving, Moving, SE3]:
        """Both arms' bodies and courses, and the other's base in this one's frame."""
        attached = self.attached_to(other)
        return (
            (bodies_of(self.attached_to(self), other.name), course),
            (bodies_of(as_seen_by(self.name, attached)), others),
            _T_from_to(self.T_cell_base, other.T_cell_base),
        )

    def touching(self) -> str:
        """What is nearer than ``TOUCHING`` to another arm now, such as ``"the jaw close to left"``.

        From the measured joints of both; empty if nothing is. Any thread may call it.
        """
        here = Course.resting(self.arm.state.q, self._q_jaw)
        for other in self._neighbours():
            there = Course.resting(other.arm.state.q, other._q_jaw)
            pair = self._pair(here, other, there)
            met = first_meeting(*pair, since=0.0, room=TOUCHING, early=0.0)
            if met is not None:
                return close(met.first, other.name, met.second)
        return ""

    def commit(self, q: Array, dt: float) -> None:
        """Publish that the arm stops along ``q``, whatever is there; see ``Neighbours``."""
        with self._space.lock:
            self._course = self._stop(q, dt, self._now())

    def course_at(self, now: float) -> Course:
        """How the arm would stop now."""
        state, course = self.arm.state, self._course
        if state.mode in (Mode.GUIDING, Mode.LIMP):
            onward = np.array([state.q, state.q + GOES_ON * state.qd])
            return self._stop(*stop_along(onward, GOES_ON), now)
        if course is not None and (now < course.end or state.arm_moving):
            return course
        return Course.resting(state.q_ref, self._q_jaw)

    def seen_from(self, other: CellMember, course: Course) -> OtherArm:
        """This arm as seen by another one."""
        return OtherArm(
            name=self.name,
            T_base_other=_T_from_to(other.T_cell_base, self.T_cell_base),
            course=course,
            attached=as_seen_by(other.name, other.attached_to(self)),
        )

    def attached_to(self, member: CellMember) -> tuple[Attached, ...]:
        """What an arm holds as far as this one knows, itself included."""
        return (*member.arm.scene.attached, *self.held.get(member.name, ()))

    @property
    def bodies(self) -> ArmBodies:
        return bodies_of(self.attached_to(self))

    @property
    def _q_jaw(self) -> float:
        """The wider of the jaw's measured angle and its setpoint [rad]."""
        state = self.arm.state
        return max(state.q_jaw, state.q_jaw_ref)

    def _stop(self, q: Array, dt: float, now: float) -> Course:
        return Course.through(q, self._q_jaw, t=now, dt=dt)

    def _neighbours(self) -> list[CellMember]:
        members, (known, minded) = self._space.members, self._known
        if known is not members:
            unminded = {*members} if ALL in self._ignores else {self.name, *self._ignores}
            minded = [each for key, each in members.items() if key not in unminded]
            self._known = members, minded
        return minded


@lru_cache(maxsize=64)
def _T_from_to(T_cell_a: SE3, T_cell_b: SE3) -> SE3:
    """Pose of the second base in the first; cached because every control cycle needs it."""
    return T_cell_a.inverse @ T_cell_b
