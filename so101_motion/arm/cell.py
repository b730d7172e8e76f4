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
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from so101_motion.arm.handover import HandoverRun
from so101_motion.arm.place import Place, RigWithExecutor, Stand
from so101_motion.arm.team_motion import TeamPlanning, TeamSeries, TeamStep, end_together
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3
from so101_motion.planning.among import crosses, crossing
from so101_motion.planning.cell.handover import Handover, HandoverRequest
from so101_motion.planning.cell.together import TeamMember, TeamRequest
from so101_motion.planning.goals import Goal, JointGoal

if TYPE_CHECKING:
    from so101_motion.arm.motion_handle import Motion
    from so101_motion.arm.planning_worker import PlanningWorker
    from so101_motion.planning.cell.grasps import Grasp
    from so101_motion.planning.collision.scene import Scene
    from so101_motion.planning.request import Plan
    from so101_motion.planning.timing.limits import MotionLimits


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
        return self.start_plan(goals, scenes=scenes).result()

    def start_plan(
        self,
        goals: Mapping[str, Goal],
        *,
        scenes: Mapping[str, Scene] | None = None,
        limits: Mapping[str, MotionLimits] | None = None,
        stands: Mapping[str, Stand] | None = None,
    ) -> Future[dict[str, Plan]]:
        """Like ``plan_together``, but returns at once; cancelling the future gives it up.

        Args:
            goals: As there.
            scenes: As there.
            limits: Caps of arms, by their names; their own if not given.
            stands: Where arms will stand, by their names; where they are if not given.
        """
        self._refuse_unknown(goals)
        team = self._team(goals, scenes or {}, limits or {}, stands or {})
        return self._worker.plan_for_team(TeamRequest(team=team))

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
        return self._start(partial(self.start_plan, goals, scenes=scenes))

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
        self._refuse_other_than_all(plans)
        return self._start(lambda: self.proven(plans))

    def plan_handover(
        self,
        giver: str,
        taker: str,
        thing: str,
        *,
        grasps: Iterable[Grasp] = (),
        scenes: Mapping[str, Scene] | None = None,
    ) -> Handover:
        """Plan to pass a thing from one hand to another; moves nothing.

        Args:
            giver: The arm that holds it.
            taker: The arm that takes it.
            thing: Its name among what is attached in the giver's scene.
            grasps: How it may be taken; found by the box around it if not given.
            scenes: What is around arms, by their names; their own scenes if not given.

        Raises:
            ConfigError: There is no such arm or thing.
            PlanningError: The arms cannot meet for it, and why.
        """
        self._refuse_unknown((giver, taker))
        return self._worker.plan_for_team(
            HandoverRequest(
                team=self._team({}, scenes or {}, {}, {}),
                giver=giver,
                taker=taker,
                thing=thing,
                grasps=tuple(grasps),
            )
        ).result()

    def start_handover(self, plan: Handover) -> dict[str, Motion]:
        """Pass a thing on as ``plan_handover`` has planned it; supersedes what is under way.

        The scenes of both arms change with it. Who stops one of the arms ends it for all; the thing
        is then in the hand of whoever held it, or of both.

        Returns:
            The motion of each arm of the cell. That of the taker raises ``MotionError`` if it has
            closed its jaw on nothing.
        """
        self._refuse_other_than_all(plan.approach)
        held = self._places[plan.giver].arm.scene.attached
        if plan.thing.name not in {each.name for each in held}:
            what = f"'{plan.thing.name}' is not in the hand of {plan.giver} any more; plan again"
            raise ConfigError("thing", plan.thing.name, what)
        run = HandoverRun(self._places, plan)
        planning = TeamPlanning(self._places, lambda: self.proven(plan.approach), self._expect)
        motions = {
            name: place.arm.start_series(run.steps(place, planning.part))
            for name, place in self._places.items()
        }
        end_together(motions)
        return motions

    def stands(self) -> dict[str, Stand]:
        """Where each arm stands now, by its name."""
        return {name: place.stand for name, place in self._places.items()}

    def start_series(self, steps: Iterator[TeamStep]) -> dict[str, Motion]:
        """Carry out several common motions, one after the other; supersedes what is under way.

        Each begins when all arms have done what the one before has for them. Who stops one of the
        arms ends it for all.

        Returns:
            The motion of each arm of the cell, from the first step to the last.
        """
        series = TeamSeries(self._places, steps, self._expect)
        motions = {
            name: place.arm.start_series(series.of(name)) for name, place in self._places.items()
        }
        end_together(motions)
        return motions

    def proven(self, plans: Mapping[str, Plan]) -> Future[dict[str, Plan]]:
        """Prove again that the arms keep apart on plans of ``plan_together``, as they are now.

        Raises:
            InCollision: They would meet, because of what they hold or how wide their jaws are.
        """
        arms = list(self._places.values())
        courses = {
            name: place.along(plans[name].trajectory, 0.0) for name, place in self._places.items()
        }
        for k, place in enumerate(arms):
            others = [each.seen_from(place, courses[each.name]) for each in arms[k + 1 :]]
            met = crossing(place.attached_to(place), courses[place.name], others)
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
        end_together(motions)
        return motions

    def _refuse_other_than_all(self, plans: Mapping[str, Plan]) -> None:
        self._refuse_unknown(plans)
        for name in self._places:
            if name not in plans:
                raise ConfigError("plans", list(plans), f'has none for "{name}"; plan again')

    def _refuse_unknown(self, names: Iterable[str]) -> None:
        for name in names:
            if name not in self._places:
                known = ", ".join(sorted(self._places)) or "none"
                raise ConfigError("goals", name, f"is no arm of this cell; there are: {known}")

    @property
    def _worker(self) -> PlanningWorker:
        return next(iter(self._places.values())).worker

    def _team(
        self,
        goals: Mapping[str, Goal],
        scenes: Mapping[str, Scene],
        limits: Mapping[str, MotionLimits],
        stands: Mapping[str, Stand],
    ) -> tuple[TeamMember, ...]:
        """All arms; those without a goal stay where they are."""
        team = []
        for name, place in self._places.items():
            stand = stands.get(name) or place.stand
            goal = goals.get(name) or JointGoal(q=stand.q)
            scene = scenes.get(name)
            if scene is None:
                scene = replace(place.arm.scene, attached=place.attached_to(place))
            asked = place.arm.request(
                goal, limits=limits.get(name), q_start=stand.q, q_jaw=stand.q_jaw
            )
            request = replace(asked, others=(), scene=scene)
            team.append(TeamMember(name=name, T_cell_base=place.T_cell_base, request=request))
        return tuple(team)

    def _expect(self, plans: Mapping[str, Plan]) -> None:
        with self.entry:
            for name, plan in plans.items():
                self._places[name].expect(plan.trajectory)

    def stop(self) -> None:
        """Bring all arms to rest at once; returns when they are."""
        for stopped in [each.arm.start_stop() for each in self._places.values()]:
            stopped.result()
