"""Carry a motion out while its scene and its goal may change: check it again, plan it again.

The arm always plays a trajectory that ends at rest. With each new scene what is left of it is
checked. If that is not free any more, its end is replaced at once by a stop, which begins as late
as ``STOPS`` allow; and a new plan is asked for that begins in the state in which the arm will be in
``LEAD`` ticks. A plan that is there in time takes the place of the rest; after one that is late,
the next gets more time; when none comes, the arm comes to rest, and it is planned from there.

What has moved from one scene to the next will go on: for a while, the places where it will be
within ``FORESIGHT`` are obstacles, too. A new goal is a new motion, which goes on from what the one
before was playing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from so101_motion.arm.motion_handle import Motion
from so101_motion.arm.protocols import ArmExecutor
from so101_motion.common.clock import Clock
from so101_motion.common.errors import SUPERSEDED, PlanningError
from so101_motion.common.geometry import SE3, Array
from so101_motion.control.joint_group import Channel
from so101_motion.control.motion_source import PlannedMotion
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.scene import MARGIN_TOLERANCE, Obstacle, Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.request import Plan, Search
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint, Trajectory

LEAD, LONGEST_LEAD = 3, 24
"""Ticks from the last before asking for a plan to its first setpoint; twice as many after one that
was late. Chosen: a plan takes 5 to 20 ms, and a new scene is to be answered within 50 ms."""

STOPS = ((4 * LEAD, False), (LEAD, False), (LEAD, True), (1, True))
"""In how many ticks a motion that is not free begins to stop, and whether as hard as the arm can
instead of within its caps: the first that is free. When none is, each joint stops by itself, which
takes a seventh less time. Chosen: while it stops within its caps, a plan can still take over.
"""

PATIENCE = 15.0
"""How long an arm that has come to rest waits for a scene in which it can reach its goal [s]."""

FORESIGHT, _GHOSTS = 0.3, 3
"""How far ahead [s] and at how many instants things are expected where they move to. Chosen: by
then the arm has answered to a new scene, and come to rest."""

TOUCHING = 0.99  # share of its margin that a stop may use up; chosen: all but contact

STILL = 0.5  # time without motion after which a thing is taken to rest [s]
BRIEF = 0.3  # longest search for another plan to the goal [s]; chosen: things have moved on by then

_LOOK = 1.0  # how long to wait when nothing is expected [s]


class _Planning(NamedTuple):
    """A plan that is being made, to take over at sample ``at`` of what is played."""

    plan: Future[Plan]
    seen: tuple[Trajectory, int]
    at: int
    search: Search


@dataclass(slots=True, kw_only=True)
class ReplannedMotion:
    """A motion to one goal; ``run`` occupies a thread until it is over.

    Attributes:
        model: The arm.
        executor: Moves it.
        clock: The executor's clock.
        search: Returns the options of a search, with the scene now: the same ones for the same.
        plan: Starts to plan with them; from rest, or from the beginning of a stop.
        limits: Returns the caps of the motion.
        check_path: Raises for a path that leaves the arm's range.
    """

    model: RobotModel
    executor: ArmExecutor
    clock: Clock
    search: Callable[[], Search]
    plan: Callable[[Search, Trajectory | None], Future[Plan]]
    limits: Callable[[], MotionLimits]
    check_path: Callable[[Array], None]
    _reaches: bool = False  # what is played ends at the goal
    _known: bool = False  # there was a plan to this goal
    _lead: int = LEAD
    _checked: Search | None = None  # what is played was checked in its scene
    _failed: Search | None = None  # there is no plan in its scene
    _given: Search | None = None  # what ``search`` returned last
    _since: float = -math.inf  # when it was first returned [s]
    _foreseen: Search | None = None  # the same, and where things will be
    _looked: float = 0.0  # the tick whose sample was seen as the last [s]
    _collision: CollisionModel | None = None  # for the scene in which was checked
    _planning: _Planning | None = None
    _joining: tuple[Future[bool], bool] | None = None  # and whether the goal was reached without

    def run(self, motion: Motion) -> None:
        """Move to the goal; returns on arrival.

        Raises:
            PlanningError: There is no plan, or none was found until the arm's patience ended.
            Interrupted: The motion was interrupted, or another one goes on from it.
        """
        try:
            with self.clock.attend():
                self._carry_out(motion)
        except BaseException:
            if (playing := motion.playing) is not None:  # no newer motion goes on from it
                wait([self.executor.interrupt(playing.future, SUPERSEDED)])
            raise
        finally:
            self._give_up_plan()

    def _carry_out(self, motion: Motion) -> None:
        if (before := motion.playing) is not None and not before.future.done():
            with motion.begin():
                self._have(motion, before)
        while True:
            playing = motion.playing
            if playing is not None and not playing.future.done():
                motion.wait_until(self.clock, self._look(motion, playing))
            elif playing is None or not self._reaches:
                self._begin(motion)
            else:
                break
        playing.future.result()

    def _begin(self, motion: Motion) -> None:
        """Plan from rest, and begin to move."""
        self._give_up_plan()
        patient_until = self.clock.now() + PATIENCE
        while True:
            try:
                plan = motion.wait_for(self.plan(self._brief(self._search()), None))
                self.check_path(plan.trajectory.q)
                break
            except PlanningError:
                if not self._known or self.clock.now() >= patient_until:
                    raise
            motion.wait_until(self.clock, patient_until)
        self._known = self._reaches = True
        self._checked, self._joining, self._lead, motion.plan = None, None, LEAD, plan
        with motion.begin():
            self._have(motion, self.executor.play(PlannedMotion(plan.trajectory)))

    def _have(self, motion: Motion, playing: PlannedMotion) -> None:
        motion.playing, motion.halt = playing, partial(self.executor.interrupt, playing.future)
        playing.future.add_done_callback(lambda _over: motion.wake())

    def _look(self, motion: Motion, playing: PlannedMotion) -> float:
        """Check, plan or splice while the arm moves; returns when to look again [s]."""
        if self._joining is None or self._note_outcome():
            search, self._looked, seen = self._search(), self.executor.state.t, playing.played
            if self._checked is not search:
                seen = self._check(motion, playing, search)
            if not self._reaches:
                self._go_on(motion, playing, seen, search)
        if self._planning is not None:
            return self.clock.now() + self.executor.dt
        if self._foreseen is not self._given:
            return self._since + STILL
        return self.clock.now() + _LOOK

    def _brief(self, search: Search) -> Search:
        brief = min(search.time_budget, BRIEF) if self._known else search.time_budget
        return replace(search, time_budget=brief)

    def _search(self) -> Search:
        search, now, before = self.search(), self.clock.now(), self._given
        is_still = now >= self._since + STILL
        if search is not before:
            passed, self._since = max(now - self._since, self.executor.dt), now
            self._given = self._foreseen = search
            if before is not None and before.scene and search.scene and not is_still:
                scene = foreseen(before.scene, search.scene, passed)
                if scene is not search.scene:
                    self._foreseen = replace(search, scene=scene)
        elif is_still:
            self._foreseen = search
        assert self._foreseen is not None
        return self._foreseen

    def _check(
        self, motion: Motion, playing: PlannedMotion, search: Search
    ) -> tuple[Trajectory, int]:
        """Stop the arm if the rest of its motion is blocked; returns what is played then."""
        seen = trajectory, k = playing.played
        self._checked, self._collision = search, CollisionModel(self.model, search.scene)
        last = len(trajectory) - 1
        if k >= last or self._is_free(self._after_contact(motion, trajectory.since(k))):
            return seen
        for ticks, is_hard in STOPS:
            at, dt = min(k + ticks, last), trajectory.dt
            limits = self.executor.stop_limits(Channel.ARM) if is_hard else self.limits()
            stop = online.stop_on_path(trajectory, at * dt, limits, dt)
            if self._is_calm(stop) and self._is_free(trajectory.since(k).then(at - k, stop)):
                break
        else:
            stop = self._soonest(trajectory.sample(at * dt), stop)
        self._give_up_plan()
        return self._join(motion, playing, seen, at, stop, reaches=False)

    def _soonest(self, now: Setpoint, on_path: Trajectory) -> Trajectory:
        """The stop of each joint by itself; ``on_path`` if only that avoids what is there now."""
        assert self._given is not None
        stop = online.stop(
            now.q, now.qd, now.qdd, self.executor.stop_limits(Channel.ARM), on_path.dt
        )
        there = CollisionModel(self.model, self._given.scene)
        blocked = there.first_blocked(stop.q, self.executor.state.q_jaw_ref, tolerance=TOUCHING)
        return stop if blocked is None else on_path

    def _after_contact(self, motion: Motion, left: Trajectory) -> Trajectory:
        """What is left of a motion from where it has led the arm out of contact, if it does."""
        assert self._collision is not None
        if motion.plan is None or not motion.plan.report.departure:
            return left
        touches = self._collision.touching(left.q, self.executor.state.q_jaw_ref)
        return left.since(min(int(np.argmin(touches)), len(left) - 1))

    def _go_on(
        self,
        motion: Motion,
        playing: PlannedMotion,
        seen: tuple[Trajectory, int],
        search: Search,
    ) -> None:
        """Ask for a plan to the goal, or splice in the one that is finished."""
        planning = self._planning
        if planning is None:
            if self._failed is not search:
                self._ask(motion, seen, search)
        elif planning.plan.done():
            self._planning = None
            self._take(motion, playing, planning, search)
            motion.wake()
        elif seen[0] is planning.seen[0] and seen[1] >= planning.at:
            self._give_up_plan()
            self._lead = min(2 * self._lead, LONGEST_LEAD)
            motion.wake()

    def _ask(self, motion: Motion, seen: tuple[Trajectory, int], search: Search) -> None:
        trajectory, k = seen
        dt = trajectory.dt
        passed = self.clock.now() - self._looked  # the check took time, too
        at = k + int(passed / dt) + self._lead
        if at >= len(trajectory) - 1:
            return  # it is at rest by then
        now = trajectory.sample(at * dt)
        lead = online.stop(now.q, now.qd, now.qdd, self.limits(), dt)
        rests_free = self._is_free(lead.since(len(lead) - 1))  # the rest of it may be cut off
        if not (rests_free and self._is_calm(lead)):
            hard = self.executor.stop_limits(Channel.ARM)
            lead = online.stop_on_path(trajectory, at * dt, hard, dt)
        self._planning = _Planning(self.plan(self._brief(search), lead), seen, at, search)
        self._planning.plan.add_done_callback(lambda _made: motion.wake())

    def _take(
        self, motion: Motion, playing: PlannedMotion, planning: _Planning, search: Search
    ) -> None:
        """Splice a finished plan into what is played, if it is still free."""
        try:
            plan = planning.plan.result()
            self.check_path(plan.trajectory.q)
        except PlanningError:
            if not self._known:
                raise
            self._failed = planning.search
            return
        self._known, self._lead = True, LEAD
        if search is planning.search or self._is_free(plan.trajectory):
            self._join(motion, playing, planning.seen, planning.at, plan.trajectory, reaches=True)
            motion.plan = plan

    def _join(
        self,
        motion: Motion,
        playing: PlannedMotion,
        seen: tuple[Trajectory, int],
        at: int,
        rest: Trajectory,
        *,
        reaches: bool,
    ) -> tuple[Trajectory, int]:
        whole, taken = playing.splice(seen, at, rest)
        self._joining, self._reaches = (taken, self._reaches), reaches
        taken.add_done_callback(lambda _told: motion.wake())
        return whole, 0

    def _note_outcome(self) -> bool:
        assert self._joining is not None
        taken, before = self._joining
        if not taken.done():
            return False
        self._joining = None
        if not taken.result():  # too late: look at all again
            self._reaches, self._checked = before, None
            self._give_up_plan()
        return True

    def _give_up_plan(self) -> None:
        if self._planning is not None:
            self._planning.plan.cancel()
            self._planning = None

    def _is_calm(self, stop: Trajectory) -> bool:
        """Whether no joint is faster in it than its cap, or than it was.

        Within the caps an arm that brakes hard could end that only slowly, and would turn back.
        """
        most = np.maximum(np.abs(stop.qd[0]), 1.001 * self.limits().velocity)
        return bool((np.abs(stop.qd) <= most).all())

    def _is_free(self, trajectory: Trajectory) -> bool:
        """Whether a motion is proven free in the newest scene."""
        assert self._collision is not None
        q_jaw = self.executor.state.q_jaw_ref
        return (
            self._collision.first_blocked(trajectory.q, q_jaw, tolerance=MARGIN_TOLERANCE) is None
        )


def foreseen(before: Scene, now: Scene, passed: float) -> Scene:
    """``now``, with the places where things will be that have moved in ``passed`` [s]."""
    was = {each.name: each.T_base_obstacle.p for each in before.obstacles}
    ghosts = list[Obstacle]()
    for each in now.obstacles:
        T = each.T_base_obstacle
        velocity = (T.p - was.get(each.name, T.p)) / passed
        if velocity.any():
            for k in range(1, _GHOSTS + 1):
                ahead = FORESIGHT * k / _GHOSTS
                T_then = SE3(T.R, T.p + ahead * velocity)
                name = f"{each.name} in {ahead:.1f} s"
                ghosts.append(replace(each, name=name, T_base_obstacle=T_then))
    return replace(now, obstacles=(*now.obstacles, *ghosts)) if ghosts else now
