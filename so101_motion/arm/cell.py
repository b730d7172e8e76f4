"""Keep arms that share a space apart, plan for several of them, and move them together.

*Every tick.* An arm that moves publishes how it would stop if it had to stop now: its course.
Before it takes its next setpoint it computes the course that would follow from there. That one must
keep off the courses of all others; otherwise the arm brakes along the course that it published
before. So whichever arms are stopped, all can stop at once without meeting.

*Plans.* An arm that begins a planned motion publishes all of it. Plans of the others go around it
in space and time (``planning/among.py``). The others may have moved between planning and beginning,
so the check is repeated when the motion begins; if necessary it begins a little later.

An arm that rests counts as being at its setpoint. One that is moved by hand counts as being where
it was measured, and as going on with that velocity for a moment.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from so101_motion.arm.cell_member import LEAD, CellMember, RigWithExecutor, SharedSpace, Stand
from so101_motion.arm.motion_queue import wait_here
from so101_motion.arm.team_motion import TeamSeries, TeamStep, end_together, handover_steps
from so101_motion.common.errors import (
    ConfigError,
    Interrupted,
    MotionError,
    PlanningError,
    in_series,
)
from so101_motion.common.geometry import SE3, pose
from so101_motion.common.public import Complete
from so101_motion.planning.among import crosses, crossing
from so101_motion.planning.cell.team_requests import (
    Handover,
    HandoverRequest,
    TeamMember,
    TeamRequest,
)
from so101_motion.planning.goals import Goal, JointGoal

if TYPE_CHECKING:
    from so101_motion.arm.motion_handle import Motion
    from so101_motion.arm.planning_worker import PlanningWorker
    from so101_motion.common.clock import Clock
    from so101_motion.planning.collision.scene import Obstacle, Scene
    from so101_motion.planning.request import Plan
    from so101_motion.planning.timing.limits import MotionLimits


def with_item(scene: Scene, name: str, item: Obstacle | None, T_base_other: SE3) -> Scene:
    """An arm's scene with an item as another arm, at ``T_base_other``, has it; None: without it."""
    others = tuple(each for each in scene.obstacles if each.name != name)
    if item is None or any(each.name == name for each in scene.attached):
        return scene if len(others) == len(scene.obstacles) else replace(scene, obstacles=others)
    here = replace(item, T_base_obstacle=T_base_other @ item.T_base_obstacle)
    is_known = any(here.is_same(each) for each in scene.obstacles)
    return scene if is_known else replace(scene, obstacles=(*others, here))


class Cell(Complete):
    """The arms of one process that share a space. Any thread may call any method.

    In all methods ``scenes``, ``limits`` and ``stands`` say, by the arms' names, what is around
    them, their caps, and where they will start; by default their own, and where they are.
    """

    def __init__(self) -> None:
        self._space = SharedSpace()

    def __repr__(self) -> str:
        return f"<Cell of {in_series(self.members) or 'no arms'}>"

    @property
    def members(self) -> Mapping[str, CellMember]:
        """The arms, by name."""
        return self._space.members

    @property
    def clock(self) -> Clock:
        """The clock of one of its arms; all show the same time."""
        return self._one.clock

    def add(
        self, name: str, rig: RigWithExecutor, T_cell_base: SE3, *, ignores: Collection[str] = ()
    ) -> CellMember:
        """Add an arm: from now on it keeps off the others, and they keep off it.

        Args:
            name: What messages call it.
            rig: The arm and its executor; its clock shows the same time as those of the others.
            T_cell_base: Pose of its base.
            ignores: Names of arms that it does not keep off; ``ALL`` for all of them.

        Raises:
            ConfigError: There is an arm of that name already.
        """
        if name in self.members:
            raise ConfigError("name", name, "is used twice; each arm needs its own name")
        if not hasattr(rig, "executor"):
            raise ConfigError(
                "rig", rig, "must be what so101.open returns, of an arm on this computer"
            )
        for member in self.members.values():
            if member.arm is rig.arm:
                raise ConfigError("rig", rig, f'is in this cell already, as "{member.name}"')
        T_cell_base = pose("T_cell_base", T_cell_base, 100.0)  # as for obstacles
        member = CellMember(self._space, name, rig, T_cell_base, frozenset(ignores))
        rig.executor.ask(lambda control: control.keep_off(member)).result()
        self._space.members = {**self.members, name: member}
        rig.arm.set_cell_member(member)
        return member

    def remove(self, name: str, rig: RigWithExecutor) -> None:
        """Remove an arm: it and the others ignore each other from now on."""
        self._space.members = {key: each for key, each in self.members.items() if key != name}
        rig.arm.set_cell_member(None)
        rig.executor.ask(lambda control: control.keep_off(None)).result()

    def plan_together(
        self,
        goals: Mapping[str, Goal],
        *,
        scenes: Mapping[str, Scene] | None = None,
        limits: Mapping[str, MotionLimits] | None = None,
        stands: Mapping[str, Stand] | None = None,
    ) -> dict[str, Plan]:
        """Plan one motion that several arms begin and end together; moves nothing.

        ``goals`` has the goal of each arm that moves, by name. The other arms stay where they are.

        Raises:
            ConfigError: There is no such arm.
            PlanningError: There is no such motion; the error says why.
            Interrupted: The motion whose step called this was interrupted.
        """
        presents = self._presents()
        plans = wait_here(self.start_plan(goals, scenes=scenes, limits=limits, stands=stands))
        self._note(plans, presents)
        return plans

    def start_plan(
        self,
        goals: Mapping[str, Goal],
        *,
        scenes: Mapping[str, Scene] | None = None,
        limits: Mapping[str, MotionLimits] | None = None,
        stands: Mapping[str, Stand] | None = None,
    ) -> Future[dict[str, Plan]]:
        """Like ``plan_together``, but returns at once; cancelling the future ends the planning."""
        self._refuse_unknown(goals)
        team = self._team(goals, scenes or {}, limits or {}, stands or {})
        return self._worker.plan(TeamRequest(team=team))

    def start_together(
        self, goals: Mapping[str, Goal], *, scenes: Mapping[str, Scene] | None = None
    ) -> dict[str, Motion]:
        """Move several arms to goals in one motion, which they begin and end together.

        It is planned once all arms of the cell rest; motions under way are superseded. Stopping one
        arm ends the motion of all. Errors of the planning are raised by the motions of the cell's
        arms, which are returned by their names.
        """
        self._refuse_unknown(goals)
        plan = partial(self.start_plan, goals, scenes=scenes)
        return self.start_series(iter((TeamStep(plan, {}),)))

    def move(self, plans: Mapping[str, Plan], *, wait: bool = True) -> dict[str, Motion]:
        """Move all arms along plans of ``plan_together``; supersedes what is under way.

        ``plans`` has the plan of each arm of the cell, by its name. Stopping one arm ends the
        motion of all. With ``wait`` False the motions are returned at once. They raise
        ``MotionError`` if an arm is not where its plan begins, and ``PlanningError`` if a plan does
        not hold any more: arms would meet because of what they hold or how wide their jaws are, or
        what ``Arm.move`` looks at was set since.

        Raises:
            ConfigError: These are not the arms of this cell.
        """
        self._refuse_other_than_all(plans)
        motions = self.start_series(iter((TeamStep(partial(self.check_again, plans), {}),)))
        for motion in motions.values() if wait else ():
            with suppress(Interrupted):  # of others has the reason
                motion.result()
        for motion in motions.values() if wait else ():
            motion.result()
        return motions

    def plan_handover(
        self, giver: str, taker: str, thing: str, *, scenes: Mapping[str, Scene] | None = None
    ) -> Handover:
        """Plan to pass a thing from one hand to another; moves nothing.

        Args:
            giver: The arm that holds it.
            taker: The arm that takes it.
            thing: Its name among what is attached in the giver's scene.
            scenes: What is around arms.

        Raises:
            ConfigError: There is no such arm or thing.
            PlanningError: The arms cannot pass it on; the error says why.
        """
        self._refuse_unknown((giver, taker))
        presents, team = self._presents(), self._team({}, scenes or {}, {}, {})
        asked = HandoverRequest(team=team, giver=giver, taker=taker, thing=thing)
        plan = self._worker.plan(asked).result()
        self._note(plan.approach, presents)
        return plan

    def start_handover(self, plan: Handover) -> dict[str, Motion]:
        """Pass a thing on as ``plan_handover`` has planned it; supersedes what is under way.

        The scenes of both arms change with it. Stopping one arm ends the motion of all; the thing
        is then in the hand that held it, or in both. The taker's motion raises ``MotionError`` if
        it has closed its jaw on nothing.
        """
        self._refuse_other_than_all(plan.approach)
        held = self.members[plan.giver].arm.scene.attached
        if plan.thing.name not in {each.name for each in held}:
            what = f"'{plan.thing.name}' is not in the hand of {plan.giver} any more; plan again"
            raise ConfigError("thing", plan.thing.name, what)
        giver, taker = self.members[plan.giver], self.members[plan.taker]
        return self.start_series(handover_steps(giver, taker, plan, self.check_again))

    def stands(self) -> dict[str, Stand]:
        """The setpoint of each arm, by its name."""
        return {name: member.stand for name, member in self.members.items()}

    def start_series(self, steps: Iterator[TeamStep]) -> dict[str, Motion]:
        """Carry out several common motions, one after the other; supersedes what is under way.

        Each begins when all arms have finished their part of the one before. Stopping one arm ends
        the motion of all. Returns the motion of each arm of the cell, from the first step to the
        last.
        """
        series = TeamSeries(self.members, steps, self._expect)
        motions = {
            name: member.arm.start_series(series.of(name)) for name, member in self.members.items()
        }
        end_together(motions)
        return motions

    def check_again(self, plans: Mapping[str, Plan]) -> Future[dict[str, Plan]]:
        """Check ``plans`` of ``plan_together`` again, with the arms as they are now.

        Returns ``plans``, done already; raises as ``move`` does.
        """
        arms = list(self.members.values()) if plans else []  # none: nobody is to move
        for member in arms:
            try:
                member.arm.check_again(plans[member.name])
            except PlanningError as error:
                raise error.about(member.name) from None
        courses = {each.name: each.along(plans[each.name].trajectory, 0.0) for each in arms}
        for k, member in enumerate(arms):
            others = [each.seen_from(member, courses[each.name]) for each in arms[k + 1 :]]
            met = crossing(member.attached_to(member), courses[member.name], others)
            if met is not None:
                raise crosses(*met)
        checked: Future[dict[str, Plan]] = Future()
        checked.set_result(dict(plans))
        return checked

    def _presents(self) -> dict[str, tuple[Any, ...]]:
        return {name: member.arm.present() for name, member in self.members.items()}

    def _note(self, plans: Mapping[str, Plan], presents: Mapping[str, tuple[Any, ...]]) -> None:
        for name, plan in plans.items():
            self.members[name].arm.note(plan, presents[name])

    def _refuse_other_than_all(self, plans: Mapping[str, Plan]) -> None:
        self._refuse_unknown(plans)
        for name in self.members:
            if name not in plans:
                raise ConfigError("plans", list(plans), f'has none for "{name}"; plan again')

    def _refuse_unknown(self, names: Collection[str]) -> None:
        if not names:
            raise ConfigError("goals", names, f"name at least one of {in_series(self.members)}")
        for name in names:
            if name not in self.members:
                known = ", ".join(sorted(self.members)) or "none"
                raise ConfigError("goals", name, f"is no arm of this cell; there are: {known}")

    @property
    def _one(self) -> CellMember:
        for member in self.members.values():
            return member
        raise MotionError("the cell has no arms; add them first")

    @property
    def _worker(self) -> PlanningWorker:
        return self._one.worker

    def _team(
        self,
        goals: Mapping[str, Goal],
        scenes: Mapping[str, Scene],
        limits: Mapping[str, MotionLimits],
        stands: Mapping[str, Stand],
    ) -> tuple[TeamMember, ...]:
        team = []
        for name, member in self.members.items():
            stand = stands.get(name) or member.stand
            goal = goals[name] if name in goals else JointGoal(q=stand.q)
            scene = scenes.get(name)
            if scene is None:
                scene = replace(member.arm.scene, attached=member.attached_to(member))
            asked = member.arm.request(
                goal, limits=limits.get(name), q_start=stand.q, q_jaw=stand.q_jaw
            )
            request = replace(asked, others=(), scene=scene)
            team.append(TeamMember(name=name, T_cell_base=member.T_cell_base, request=request))
        return tuple(team)

    def _expect(self, plans: Mapping[str, Plan]) -> None:
        with self._space.entry:
            members = self.members
            if gone := sorted(plans.keys() - members.keys()):
                raise MotionError(
                    f"{', '.join(gone)} left the cell while the common motion was planned; ask for"
                    " it again"
                )
            begin = self.clock.now() + LEAD
            for name, plan in plans.items():
                members[name].expect(plan.trajectory, begin)

    def stop(self) -> None:
        """Bring all arms to rest at once; returns when they are."""
        for stopped in [each.arm.start_stop() for each in self.members.values()]:
            stopped.result()
