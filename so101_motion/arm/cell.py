"""Arms that share a space: where each stands, and what each is about to do.

*Every tick.* An arm that moves says how it would stop if it had to stop now: that is its course.
Before it takes its next setpoint it shows the course that would follow from there, which must keep
off the courses of all others; otherwise it brakes, on the course that it has shown before. So
whatever arms are told, and whoever of them is stopped, all can stop at once without meeting. The
registry has one lock, and a course is taken up under it.

*Plans.* An arm that begins a planned motion says all of it. Plans of the others go around it in
space and time (``planning/among.py``). Between planning and beginning the others have moved on, so
the proof is repeated when it begins; if need be it begins a little later.

An arm that rests is where it is wanted; one that a hand moves, where it was seen, and goes on as it
does for a moment. Nothing here knows how many arms there are.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

from so101_motion.arm.team_motion import TeamPlanning
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array
from so101_motion.common.modes import Mode
from so101_motion.planning.among import crosses, crossing, delayed
from so101_motion.planning.cell.together import TeamMember, TeamRequest
from so101_motion.planning.collision.apart import (
    EARLY,
    GUARDED,
    GUARDED_EARLY,
    ArmBodies,
    Meeting,
    bodies_of,
    first_meeting,
)
from so101_motion.planning.collision.course import Course, OtherArm, stop_along
from so101_motion.planning.collision.scene import Attached, Scene
from so101_motion.planning.goals import Goal, JointGoal

if TYPE_CHECKING:
    from so101_motion.arm.arm import Arm
    from so101_motion.arm.motion_handle import Motion
    from so101_motion.arm.planning_worker import PlanningWorker
    from so101_motion.common.clock import Clock
    from so101_motion.control.executor import Executor
    from so101_motion.planning.request import Plan
    from so101_motion.planning.timing.trajectory import Trajectory

ALL = "*"
"""The name that stands for all arms."""

LATER, LATEST = 0.1, 2.0
"""By how much a motion may begin later than it was planned [s], and at the most; chosen."""

PARTING, TENTH = 5e-4, 1e-4
"""Arms that are too near already may come so much nearer [m], because parts that slide along each
other do; distances are known to the second. Chosen."""

PUSHED = 0.7
"""Arms that are nearer than this share of what they have gained were moved by others; chosen, a
proof leaves three quarters of it."""

PROMPT = 0.5 * EARLY
"""So late at most a motion begins that was proven together with others' [s]: the proof allows for
twice as much."""

GOES_ON = 0.2
"""For how long an arm that a hand moves is taken to go on as it does [s]; chosen."""


class RigWithExecutor(Protocol):
    """An arm with the control loop that moves it, such as a ``Rig``."""

    arm: Arm
    executor: Executor
    clock: Clock
    planner: PlanningWorker


class Cell:
    """The arms of one process that share a space. Any thread may call any method."""

    def __init__(self) -> None:
        self.lock = threading.Lock()  # of all courses; held for moments, in control cycles too
        self.entry = threading.Lock()  # of all planned motions; held while one is proven
        self._places: Mapping[str, Place] = {}

    @property
    def places(self) -> Mapping[str, Place]:
        """The place of each arm, by its name."""
        return self._places

    def add(
        self,
        name: str,
        rig: RigWithExecutor,
        T_cell_base: SE3,
        *,
        ignores: Collection[str] = (),
    ) -> Place:
        """Let an arm keep off the others from now on, and them off it.

        Args:
            name: What messages call it.
            rig: The arm with what moves it; its clock shows the same time as those of the others.
            T_cell_base: Where its base stands.
            ignores: Names of arms that it does not keep off; ``ALL`` for all of them.

        Raises:
            ConfigError: There is an arm of that name already.
        """
        if name in self._places:
            raise ConfigError("name", name, "is there twice; each arm needs its own name")
        place = Place(self, name, rig, T_cell_base, frozenset(ignores))
        rig.executor.ask(lambda control: control.keep_off(place)).result()
        self._places = {**self._places, name: place}
        rig.arm.take_place(place)
        return place

    def remove(self, name: str, rig: RigWithExecutor) -> None:
        """Let an arm stand alone again; the others do not know it any more."""
        self._places = {key: each for key, each in self._places.items() if key != name}
        rig.arm.take_place(None)
        rig.executor.ask(lambda control: control.keep_off(None)).result()

    def plan_together(
        self, goals: Mapping[str, Goal], *, scenes: Mapping[str, Scene] | None = None
    ) -> dict[str, Plan]:
        """One motion for several arms, which they begin and end together; moves nothing.

        Args:
            goals: What is wanted of each, by its name. The other arms stay where they are.
            scenes: What is around arms, by their names; their own scenes if not given.

        Raises:
            ConfigError: There is no such arm.
            PlanningError: There is no such motion, and why.
        """
        self._refuse_unknown(goals)
        return self._start_plan(goals, scenes or {}).result()

    def start_together(
        self, goals: Mapping[str, Goal], *, scenes: Mapping[str, Scene] | None = None
    ) -> dict[str, Motion]:
        """Move several arms to goals in one motion, which they begin and end together.

        It is planned once all arms of the cell rest; what moves is superseded. Who stops one of
        them ends it for all. Arguments and errors as for ``plan_together``; the motions raise what
        is raised by planning.

        Returns:
            The motion of each arm of the cell, by its name.
        """
        self._refuse_unknown(goals)
        return self._start(partial(self._start_plan, goals, scenes or {}))

    def start_execute(self, plans: Mapping[str, Plan]) -> dict[str, Motion]:
        """Move all arms along plans of ``plan_together``; supersedes what is under way.

        Who stops one of them ends it for all.

        Args:
            plans: The plan of each arm of the cell, by its name.

        Returns:
            The motion of each arm. It raises ``MotionError`` if an arm is not where its plan
            begins, and ``InCollision`` if they would meet now because of what they hold or how wide
            their jaws are.

        Raises:
            ConfigError: These are not the arms of this cell.
        """
        self._refuse_unknown(plans)
        for name in self._places:
            if name not in plans:
                raise ConfigError("plans", list(plans), f'has none for "{name}"; plan again')
        return self._start(lambda: self._proven(plans))

    def _proven(self, plans: Mapping[str, Plan]) -> Future[dict[str, Plan]]:
        arms = list(self._places.values())
        courses = {
            name: place.along(plans[name].trajectory, 0.0) for name, place in self._places.items()
        }
        for k, place in enumerate(arms):
            others = [each.seen_from(place, courses[each.name]) for each in arms[k + 1 :]]
            met = crossing(place.bodies, courses[place.name], others)
            if met is not None:
                raise crosses(*met)
        proven: Future[dict[str, Plan]] = Future()
        proven.set_result(dict(plans))
        return proven

    def _start(self, plan: Callable[[], Future[dict[str, Plan]]]) -> dict[str, Motion]:
        planning = TeamPlanning(self._places, plan, self._expect)
        motions = {
            name: place.arm.start_planned(partial(planning.part, name))
            for name, place in self._places.items()
        }
        planning.watch(motions)
        return motions

    def _refuse_unknown(self, names: Iterable[str]) -> None:
        for name in names:
            if name not in self._places:
                known = ", ".join(sorted(self._places)) or "none"
                raise ConfigError("goals", name, f"is no arm of this cell; there are: {known}")

    def _start_plan(
        self, goals: Mapping[str, Goal], scenes: Mapping[str, Scene]
    ) -> Future[dict[str, Plan]]:
        team = []
        for name, place in self._places.items():
            goal = goals.get(name) or JointGoal(q=place.arm.state.q_ref)
            scene = scenes.get(name)
            if scene is None:
                scene = replace(place.arm.scene, attached=place.attached_to(place))
            request = replace(place.arm.request(goal), others=(), scene=scene)
            team.append(TeamMember(name=name, T_cell_base=place.T_cell_base, request=request))
        worker = next(iter(self._places.values())).worker
        return worker.plan_together(TeamRequest(team=tuple(team)))

    def _expect(self, plans: Mapping[str, Plan]) -> None:
        with self.entry:
            for name, plan in plans.items():
                self._places[name].expect(plan.trajectory)

    def stop(self) -> None:
        """Bring all arms to rest at once; returns when they are."""
        for stopped in [each.arm.start_stop() for each in self._places.values()]:
            stopped.result()


class Place:
    """What one arm knows of the others of its cell, and they of it. ``Cell.add`` makes it.

    Attributes:
        cell: Whose place it is.
        name: What messages call the arm.
        arm: The arm.
        T_cell_base: Where its base stands.
        worker: Who plans for it.
        against: What stood against the setpoint that was not admitted last, in words.
        held: What arms hold beside what their scenes say, by the arm's name, as this one knows it.
    """

    def __init__(
        self,
        cell: Cell,
        name: str,
        rig: RigWithExecutor,
        T_cell_base: SE3,
        ignores: frozenset[str] = frozenset(),
    ) -> None:
        self.name, self.arm, self.T_cell_base, self.against = name, rig.arm, T_cell_base, ""
        self.worker, self.held = rig.planner, dict[str, tuple[Attached, ...]]()
        self.cell, self._now, self._ignores = cell, rig.clock.now, ignores
        self._expected: Trajectory | None = None  # that was proven together with others'
        self._course: Course | None = None
        self._planned: Course | None = None
        self._gained: dict[str, float] = {}  # of arms that are too near, by name
        bodies_of()  # made before the control loop needs it

    @property
    def minded(self) -> frozenset[str]:
        """The names of the arms that it keeps off."""
        return frozenset(each.name for each in self._neighbours())

    # Planned motions

    def others(self) -> tuple[OtherArm, ...]:
        """The other arms as a plan that is made now has to know them."""
        now = self._now()
        return tuple(
            each.seen_from(self, each.plan_at(now).since(now)) for each in self._neighbours()
        )

    @contextmanager
    def entered(self, trajectory: Trajectory) -> Iterator[Trajectory]:
        """Say that a planned motion begins now; it is over when the block ends.

        Yields:
            The motion, possibly after a wait.

        Raises:
            InCollision: It crosses another arm's motion, also when it begins later.
        """
        with self.cell.entry:
            planned, expected, wait = self._planned, self._expected, 0.0
            self._expected = None
            if expected is not trajectory or planned is None or self._now() > planned.t + PROMPT:
                wait = self._wait_for(trajectory)
                self._planned = self.along(trajectory, self._now() + wait)
        try:
            yield delayed(trajectory, wait)
        finally:
            self._planned = None

    def expect(self, trajectory: Trajectory) -> None:
        """A motion begins at once that has been proven together with those of others."""
        self._planned, self._expected = self.along(trajectory, self._now()), trajectory

    def _wait_for(self, trajectory: Trajectory) -> float:
        met = None
        for wait in np.arange(0.0, LATEST, LATER):
            now = self._now()
            others = [each.seen_from(self, each.plan_at(now)) for each in self._neighbours()]
            met = crossing(
                self.bodies, self.along(trajectory, now + float(wait)), others, since=now
            )
            if met is None:
                return float(wait)
        assert met is not None
        raise crosses(*met)

    def along(self, trajectory: Trajectory, t: float) -> Course:
        """The course of a motion that begins at ``t`` [s]."""
        return Course.along(trajectory, self._q_jaw, t=t)

    def plan_at(self, now: float) -> Course:
        """All that the arm is known to do."""
        planned = self._planned
        return planned if planned is not None and now < planned.end else self.course_at(now)

    # Every tick

    def admits(self, q: Array, dt: float) -> bool:
        """Whether the arm may go on so that it could stop along ``q``; see ``Neighbours``."""
        now = self._now()
        course = self._stop(q, dt, now)
        with self.cell.lock:
            for other in self._neighbours():
                meeting = self._meeting(course, other, now)
                if meeting is not None:
                    self.against = f"the {meeting.first} close to {other.name}'s {meeting.second}"
                    return False
            self._course = course
        return True

    def commit(self, q: Array, dt: float) -> None:
        """The arm stops along ``q``, whatever is there; see ``Neighbours``."""
        with self.cell.lock:
            self._course = self._stop(q, dt, self._now())

    def course_at(self, now: float) -> Course:
        """How the arm would stop."""
        state, course = self.arm.state, self._course
        if state.mode in (Mode.GUIDING, Mode.LIMP):
            onward = np.array([state.q, state.q + GOES_ON * state.qd])
            return self._stop(*stop_along(onward, GOES_ON), now)
        if course is not None and (now < course.end or state.arm_moving):
            return course
        return Course.resting(state.q_ref, self._q_jaw)

    def seen_from(self, other: Place, course: Course) -> OtherArm:
        """This arm as another has to know it."""
        return OtherArm(
            name=self.name,
            T_base_other=other.T_cell_base.inverse @ self.T_cell_base,
            course=course,
            attached=other.attached_to(self),
        )

    def attached_to(self, place: Place) -> tuple[Attached, ...]:
        """What an arm holds as far as this one knows, itself included."""
        return (*place.arm.scene.attached, *self.held.get(place.name, ()))

    def _meeting(self, course: Course, other: Place, now: float) -> Meeting | None:
        """Where a course would come too near to another arm's.

        Arms that are too near already may part.
        """
        seen = other.seen_from(self, other.course_at(now))
        mine, theirs = (self.bodies, course), (bodies_of(seen.attached), seen.course)
        T = seen.T_base_other
        meeting = first_meeting(mine, theirs, T, since=now, room=GUARDED, early=GUARDED_EARLY)
        if meeting is None:
            return None
        room = self._kept(other.name, mine, theirs, T, now)
        if room is None:
            return meeting
        return first_meeting(mine, theirs, T, since=now, room=room, early=0.0)

    def _kept(
        self,
        name: str,
        mine: tuple[ArmBodies, Course],
        theirs: tuple[ArmBodies, Course],
        T: SE3,
        now: float,
    ) -> float | None:
        """What must stay free of what there is between two arms that are too near already [m].

        What they have gained they keep. None if they are not, or so near that nobody can tell.
        """
        at = np.array([now])
        here, there = ((each, Course(t=now, dt=1.0, q=c.at(at))) for each, c in (mine, theirs))
        nearest, nearer = GUARDED, first_meeting(here, there, T, since=now, room=GUARDED)
        if nearer is None:
            self._gained.pop(name, None)
            return None
        while nearer is not None and nearest > PARTING:
            nearest = min(nearer.distance, nearest - TENTH)
            nearer = first_meeting(here, there, T, since=now, room=nearest)
        if nearest <= PARTING:
            return None
        gained = self._gained.get(name, 0.0)
        if nearest < PUSHED * gained:
            gained = 0.0  # the other was moved towards this one
        self._gained[name] = max(gained, nearest - PARTING)
        return self._gained[name]

    @property
    def bodies(self) -> ArmBodies:
        """The arm's bodies, with what it holds."""
        return bodies_of(self.attached_to(self))

    @property
    def _q_jaw(self) -> float:
        """The wider of where the jaw is and where it is wanted [rad]."""
        state = self.arm.state
        return max(state.q_jaw, state.q_jaw_ref)

    def _stop(self, q: Array, dt: float, now: float) -> Course:
        return Course(t=now, dt=dt, q=np.column_stack([q, np.full(len(q), self._q_jaw)]))

    def _neighbours(self) -> list[Place]:
        if ALL in self._ignores:
            return []
        unminded = {self.name, *self._ignores}
        return [each for key, each in self.cell.places.items() if key not in unminded]
