"""State and commands of the Move tab, of one arm or of several that share a space, without viser.

A ``ViewModel`` has the target of one arm and its part of the plan, a ``MoveModel`` what all arms
have in common: one plan, one place on its timeline, one motion. The plan is dropped for all as soon
as an arm, a gripper, the speed limits, the surroundings or a target differ from those it was made
for. Nothing here waits: slow calls are futures that ``refresh`` collects. One thread owns them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from functools import partial
from typing import Any

import numpy as np

from so101_motion.arm.arm import START_TOLERANCE, Arm
from so101_motion.arm.cell import Cell
from so101_motion.arm.gripper import Gripper
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.errors import InCollision, Interrupted
from so101_motion.common.geometry import Array
from so101_motion.common.modes import HELD, Mode
from so101_motion.common.state import JointState
from so101_motion.common.units import to_rad
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import LeaveContactGoal
from so101_motion.planning.request import Plan
from so101_motion.rig.protocols import GripperLike

from .page import texts
from .page.causes import Causes, NextEvent, same_things, things_around
from .page.plan_view import (
    Between,
    CommonPlan,
    PathLine,
    PlanView,
    Playback,
    clearances,
    plan_view,
)
from .page.screen_state import Sentence, Tone
from .page.target_editor import TargetEditor
from .page.target_ik import Target, TargetSolver
from .page.tracking import MotionTracker, Tracking

SAME_POSE = to_rad(0.5)
"""Ghost and arm nearer than this are one picture, so the ghost is hidden [rad]; chosen."""

SAME_PICTURE = to_rad(0.005)
"""A joint that turned less than this is not drawn anew [rad]; chosen: 0.04 mm at full stretch."""

HINT_POINTS = 25  # points of the dashed line before there is a plan; chosen: it looks smooth

LOOKS = 80
"""Instants at which the clearance between two arms is computed; chosen: takes about 10 ms."""

_OF_ALL = (texts.ALREADY_THERE, texts.PRESS_PLAN)  # sentences that follow where all arms are

Submit = Callable[[Callable[[], Any]], Future[Any]]  # runs a slow call on another thread


class ViewModel(TargetEditor):
    """The target of one arm, and its part of the plan.

    Attributes:
        plan_view: The newest plan and what is drawn of it; None before the first.
        plan_is_current: Whether that plan can still be executed.
        is_planned_for: Whether a plan is being made.
        motion: Follows the plan; None at rest.
        playback: How far into the plan the ghost stands, or at its end; the same for all arms.
        replans: Whether the arm plans again while it moves, when the scene changes.
        refused: The newest target that no plan could end at, because something is there.
        ran: The newest plan that was executed and how it was followed; None before.
        dropped: Called with why the plan is dropped, also one that is being made.
    """

    def __init__(
        self,
        *,
        arm: Arm,
        gripper: GripperLike,
        load_solver: Callable[[Scene, tuple[Array, Array]], TargetSolver],
        submit: Submit,
        now: Callable[[], float],
    ) -> None:
        self.arm, self.gripper, self._submit = arm, gripper, submit
        self._load_solver = load_solver
        self._around = arm.scene, arm.range
        self._caps = self.caps  # of the plan that is shown or being made
        super().__init__(load_solver(*self._around), arm.state, now)
        self._loading: Future[TargetSolver] | None = None
        self._shown = arm.state
        self.plan_view: PlanView | None = None
        self.plan_is_current = self.is_planned_for = False
        self.motion: Motion | None = None
        self.refused: Target | None = None
        self._in_contact: tuple[object, bytes, bool] = (None, b"", False)  # where it was looked
        self.sweeps, self.replans, self.playback = True, False, Playback()
        self.tracker = MotionTracker()
        self.ran: tuple[PlanView, Tracking] | None = None
        self.dropped: Callable[[Sentence], None] = lambda _why: self.leave_plan()
        self.path = self._hint()

    # Commands

    def set_speed(self, speed: float) -> None:
        """Set the speed cap of the next plan [rad/s]."""
        self.arm.set_speed(speed)
        self._follow_caps()

    def set_acceleration(self, acceleration: float) -> None:
        """Set the acceleration cap of the next plan [rad/s^2]."""
        self.arm.set_acceleration(acceleration)
        self._follow_caps()

    def aim_as(self, plan: Plan) -> None:
        self.target = self._at_joints(plan.q_goal, self.target.frame)
        self.history.add((self.target, self.kind))

    def take_plan(self, plan: Plan, name: str) -> None:
        newest = self.arm.newest
        made_for = newest[0] if newest is not None and newest[1] is plan else None
        self.plan_view = plan_view(
            plan,
            self._solver,
            self.target.frame,
            scene=self.arm.scene if made_for is None else made_for.scene,
            q_jaw=self.state.q_jaw_ref if made_for is None else made_for.q_jaw,
            name=name,
        )
        self.plan_is_current, self.is_planned_for = True, False
        self.path = self.plan_view.path

    def leave_plan(self) -> None:
        self.plan_is_current = self.is_planned_for = False
        self.path = self._hint()

    def follow(self, motion: Motion) -> None:
        self.motion, self.tracker.began = motion, None

    def move_jaw(self, aperture: float) -> None:
        """Move the gripper at once: 0 closed, 1 open."""
        self.gripper.move(aperture, wait=False)
        if self.plan_is_current and self.motion is None:
            self._drop_plan(texts.JAW_MOVED)

    def set_force(self, force: float) -> None:
        """Set how hard a grip presses, as a share of what the servo can keep up."""
        if isinstance(self.gripper, Gripper):
            self.gripper.set_force(force)

    # What is shown

    @property
    def q_arm(self) -> Array:
        """The arm's reference, shape (5,), [rad], or its measured angles after hand guiding."""
        state = self.arm.state
        return state.q_ref if state.mode in HELD else np.clip(state.q, *self.arm.range)

    def distance_to_goal(self) -> float:
        """How far the arm is from the end of the newest plan [m]; 0 before the first."""
        if self.plan_view is None:
            return 0.0
        ends = (self.plan_view.plan.q_goal, self.state.q)
        goal, here = (self._solver.point(q, self.target.frame) for q in ends)
        return float(np.linalg.norm(here - goal))

    @property
    def problem(self) -> Sentence | None:
        blocked, problem = texts.blocked(self.state), self.target.problem
        if blocked is None and problem is not None and self.motion is None:
            return Sentence(f"{problem} Press nearest for one that works.", Tone.BAD)
        return blocked

    @property
    def q_ghost(self) -> Array | None:
        """Where the ghost stands, shape (5,), [rad]; None when it is hidden."""
        q = self.target.q
        if self.plan_view is not None and self.plan_is_current:
            q = self.plan_view.plan.trajectory.sample(self.playback.t).q
        return None if _apart(q, self.state.q) < SAME_POSE else q

    @property
    def sweep(self) -> Array | None:
        """Configurations along the path to be shown, shape (k, 5), [rad], or None."""
        is_shown = self.plan_is_current and self.sweeps
        return self.plan_view.sweep if self.plan_view is not None and is_shown else None

    @property
    def progress(self) -> float:
        """Share of the motion that is done, 0 to 1."""
        began = self.tracker.began
        if self.motion is None or self.plan_view is None or began is None:
            return 0.0
        return min((self.state.t - began) / max(self.plan_view.duration, 1e-9), 1.0)

    @property
    def caps(self) -> tuple[float, float]:
        """Speed [rad/s] and acceleration cap [rad/s^2] of the next plan."""
        return self.arm.speed, self.arm.acceleration

    @property
    def force(self) -> float | None:
        return self.gripper.force if isinstance(self.gripper, Gripper) else None

    @property
    def may_plan(self) -> bool:
        rests = self.motion is None and self.state.mode is Mode.HOLDING
        return rests and not self.is_planned_for and texts.blocked(self.state) is None

    @property
    def is_at_target(self) -> bool:
        return _apart(self.target.q, self.state.q_ref) <= START_TOLERANCE

    @property
    def can_back_out(self) -> bool:
        if not self.may_plan:
            return False
        place = np.append(self.state.q_ref, self.state.q_jaw_ref)
        if self._in_contact[:2] != (self._solver, place.tobytes()):
            touches = self._solver.is_in_contact(self.state.q_ref, self.state.q_jaw_ref)
            self._in_contact = self._solver, place.tobytes(), touches
        return self._in_contact[2]

    @property
    def can_execute(self) -> bool:
        return (
            self.plan_is_current
            and self.motion is None
            and self.state.mode is Mode.HOLDING
            and texts.blocked(self.state) is None
            and same_things(things_around(self.arm), (*self._around, *self._caps))
        )

    def refresh(self) -> bool:
        self.state = self.arm.state
        own = None if self.motion is None else self.plan_view
        events = (
            self._follow_surroundings(),
            self._follow_caps(),
            self._track("another motion" if own is None else own.name),
            self._notice_departure(),
        )
        if not any(events) and not _looks_different(self.state, self._shown):
            return False
        self._shown = self.state
        if not self.plan_is_current:
            self.path = self._hint()
        return True

    # Helpers

    def _aim(self, target: Target) -> None:
        self.target = target
        self._drop_plan(texts.ALREADY_THERE if self.is_at_target else texts.PRESS_PLAN)

    def _drop_plan(self, why: Sentence) -> None:
        if self.motion is None:
            self.dropped(why)
        else:
            self.leave_plan()

    def _follow_caps(self) -> bool:
        """Drop a plan that was made with other caps, whoever has set the new ones."""
        before, self._caps = self._caps, self.caps
        if before == self._caps:
            return False
        if self.plan_is_current or self.is_planned_for:
            self._drop_plan(texts.CAPS_CHANGED)
        return True

    def _hint(self) -> PathLine | None:
        start, goal = self.state.q_ref, self.target.q
        if self.target.problem is not None or _apart(goal, start) < SAME_POSE:
            return None
        steps = np.linspace(start, goal, HINT_POINTS)
        points = np.array([self._solver.point(q, self.target.frame) for q in steps])
        return PathLine(points=points, planned=False)

    def _follow_surroundings(self) -> bool:
        around = self.arm.scene, self.arm.range
        if self._loading is None and not same_things(around, self._around):
            self._around = around
            self._loading = self._submit(lambda: self._load_solver(*around))
            moves_on = self.replans and self.motion is not None
            if (self.plan_is_current or self.is_planned_for) and not moves_on:
                self._drop_plan(texts.SURROUNDINGS_CHANGED)
            return True
        if self._loading is None or not self._loading.done():
            return False
        loading, self._loading = self._loading, None
        error = loading.exception()
        if error is not None:
            self.dropped(texts.ended(error))
            return True
        self._solver = loading.result()
        self.target = self._again(self.target)
        return True

    def _track(self, name: str) -> bool:
        tracker, plan = self.tracker, self.plan_view
        ended = tracker.take(self.state, name)
        is_own = ended and plan is not None and tracker.newest_name == plan.name
        if is_own and plan is not None and tracker.newest is not None:
            self.ran = plan, tracker.newest
        return ended

    def _notice_departure(self) -> bool:
        if self.plan_view is None or not self.plan_is_current or self.motion is not None:
            return False
        if _apart(self.plan_view.plan.q_start, self.state.q_ref) <= START_TOLERANCE:
            return False
        self._drop_plan(texts.ARM_MOVED)
        return True


class MoveModel:
    """What the arms on the Move tab have in common.

    Args:
        cell: Keeps several arms apart; None for a single one.
        arms: Target and picture of each arm; the name of a single one is empty.
        now: The time [s].

    Attributes:
        playback: How far into the plan the ghosts stand.
    """

    def __init__(
        self,
        cell: Cell | None,
        arms: Mapping[str, ViewModel],
        *,
        submit: Submit,
        now: Callable[[], float],
        welcome: str,
    ) -> None:
        self._cell, self.arms, self._submit, self._now = cell, dict(arms), submit, now
        self._sentence = Sentence(welcome)
        self.common_plan: CommonPlan | None = None
        self._planning: Future[CommonPlan] | None = None
        self._backs_out = False
        self._motions: dict[str, Motion] = {}
        self.playback = Playback()
        self._count = 0  # plans that were shown
        self._causes = Causes(arm.arm for arm in arms.values())
        self._had_alarms = False  # before the newest motion, which ended for them
        self._arrived: tuple[Sentence | None, tuple[Array, ...]] = (None, ())  # and where
        self._next = [NextEvent(arm.arm) for arm in arms.values()]
        for name, arm in self.arms.items():
            arm.dropped, arm.playback = partial(self._drop_plan, name), self.playback

    # Commands

    def plan(self) -> None:
        """Plan one motion that brings every arm to its target; the arms stay where they are."""
        if self.can_plan:
            self._plan({name: arm.target.goal for name, arm in self.arms.items()})

    def plan_back_out(self) -> None:
        """Plan slowly out of the contact in which a single arm stands; it stays where it is."""
        if all(arm.may_plan for arm in self.arms.values()):
            self._plan({"": LeaveContactGoal()}, backs_out=True)

    def show(self, plan: Plan) -> None:
        self.arms[""].aim_as(plan)
        self._take_plan({"": plan})

    def execute(self) -> None:
        if self.common_plan is None or not self.can_execute:
            return
        if self._cell is not None:
            self._follow(self._cell.move(self.common_plan.plans, wait=False))
            return
        one = self.arms[""]
        if one.replans and not self._backs_out:
            motion = one.arm.move(one.target.goal, replan=True, wait=False)
        else:
            motion = one.arm.move(self.common_plan.plans[""], wait=False)
        self._follow({"": motion})

    def set_speed(self, speed: float) -> None:
        for arm in self.arms.values():
            arm.set_speed(speed)

    def set_acceleration(self, acceleration: float) -> None:
        for arm in self.arms.values():
            arm.set_acceleration(acceleration)

    def show_sweep(self, shown: bool) -> None:
        for arm in self.arms.values():
            arm.sweeps = shown

    def report(self, error: BaseException) -> None:
        self._sentence = texts.ended(error)

    def tell(self, sentence: Sentence) -> None:
        self._sentence = sentence

    # What is shown

    @property
    def sentence(self) -> Sentence:
        for name, arm in self.arms.items():
            problem = arm.problem
            if problem is not None:
                return texts.named(name, problem)
            if arm.state.mode in (Mode.MOVING, Mode.STOPPING) and arm.motion is None:
                return texts.named(name, texts.IN_USE)
            is_plain = self._sentence.tone is Tone.PLAIN and not self.plan_is_current
            if is_plain and not name and arm.can_back_out:
                return texts.IN_CONTACT
        return self._sentence

    @property
    def plan_is_current(self) -> bool:
        return all(arm.plan_is_current for arm in self.arms.values())

    @property
    def can_plan(self) -> bool:
        ready = all(arm.may_plan and arm.target.problem is None for arm in self.arms.values())
        return ready and not all(arm.is_at_target for arm in self.arms.values())

    @property
    def can_execute(self) -> bool:
        return all(arm.can_execute for arm in self.arms.values())

    @property
    def progress(self) -> float:
        """Share of the motion that is done, 0 to 1."""
        return max(each.progress for each in self.arms.values())

    @property
    def caps(self) -> tuple[float, float]:
        """Speed [rad/s] and acceleration cap [rad/s^2] of the next plan, of the slowest arm."""
        speeds, accelerations = zip(*(each.caps for each in self.arms.values()), strict=True)
        return min(speeds), min(accelerations)

    @property
    def most(self) -> tuple[float, float]:
        """The highest caps [rad/s], [rad/s^2] that every arm takes."""
        ceilings = [each.arm.ceiling for each in self.arms.values()]
        return min(c.speed for c in ceilings), min(c.acceleration for c in ceilings)

    @property
    def sweeps(self) -> bool:
        return all(each.sweeps for each in self.arms.values())

    @property
    def _have_alarms(self) -> bool:
        return any(arm.arm.state.reading.alarms for arm in self.arms.values())

    @property
    def _have_left(self) -> bool:
        """Whether an arm no longer stands where it is said to have arrived."""
        said, places = self._arrived
        here = (arm.state.q for arm in self.arms.values())
        return said is self._sentence and any(
            _apart(q, place) > SAME_POSE for q, place in zip(here, places, strict=True)
        )

    def refresh(self) -> bool:
        news = [arm.refresh() for arm in self.arms.values()]
        gave_way = any(
            texts.blocked(arm.state) is not None
            and (arm.state.mode is not Mode.HOLDING or arm.state.reading.let_go)
            for arm in self.arms.values()
        )
        if gave_way and not self._motions:
            self._sentence = texts.HOLDS_AGAIN  # for later: where it arrived is no longer true
        changed = self._causes.have_changed()
        if self._had_alarms and not self._motions and not self._have_alarms:
            self._had_alarms, changed = False, True
        is_over = changed and self._sentence.tone is Tone.BAD
        is_of_now = self._sentence in _OF_ALL
        if (is_over or is_of_now or self._have_left) and not self._motions:
            here = all(arm.is_at_target for arm in self.arms.values())
            before = self._sentence
            self._sentence = texts.ALREADY_THERE if here else texts.PRESS_PLAN
            news.append(self._sentence is not before)
        stopped = any([each.look()[0] for each in self._next])
        if stopped and self._sentence is self._arrived[0]:  # as the bar says
            self._sentence = texts.STOPPED_THERE
            news.append(True)
        news += [self._collect_plan(), self._show_plan_under_way(), self._collect_motions()]
        return any((*news, self.playback.advance(self._now())))

    # Helpers

    def _plan(self, goals: dict[str, Any], *, backs_out: bool = False) -> None:
        def made() -> CommonPlan:
            if self._cell is None:
                return CommonPlan(plans={"": self.arms[""].arm.plan(goals[""])})
            plans = self._cell.plan_together(goals)
            return CommonPlan(plans=plans, clearances=_clearances(self._cell, plans))

        for arm in self.arms.values():
            arm.is_planned_for = True
        self._planning, self._backs_out = self._submit(made), backs_out
        self._sentence = texts.PLANNING

    def _take_plan(
        self, plans: Mapping[str, Plan], clearances: tuple[Between, ...] = (), name: str = ""
    ) -> None:
        self._count += 1
        name = name or f"Plan {self._count}"
        self.common_plan = CommonPlan(plans=plans, clearances=clearances, name=name)
        for each, arm in self.arms.items():
            arm.take_plan(plans[each], name)
        self.playback.load(self.common_plan.duration)
        self._sentence = texts.PLANNED if self._cell is None else texts.ALL_PLANNED

    def _drop_plan(self, name: str, why: Sentence) -> None:
        self._planning = None
        for arm in self.arms.values():
            arm.leave_plan()
        self._sentence = why if why in _OF_ALL else texts.named(name, why)

    def _follow(self, motions: Mapping[str, Motion]) -> None:
        self._motions, self._had_alarms = dict(motions), self._have_alarms
        for name, motion in motions.items():
            self.arms[name].follow(motion)
        self.playback.seek(np.inf)
        self._sentence = texts.MOVING

    def _collect_plan(self) -> bool:
        if self._planning is None or not self._planning.done():
            return False
        future, self._planning = self._planning, None
        for arm in self.arms.values():
            arm.is_planned_for = False
        error = future.exception()
        if error is not None:
            self._sentence = texts.ended(error)
            if isinstance(error, InCollision) and error.where == "goal":
                for name, arm in self.arms.items():
                    is_own = not name or str(error).startswith(f"{name}: ")
                    if is_own or error.first.startswith(f"{name}'s "):
                        arm.refused = arm.target
            return True
        made = future.result()
        if self._backs_out:
            self.arms[""].aim_as(made.plans[""])
        self._take_plan(made.plans, made.clearances)
        return True

    def _show_plan_under_way(self) -> bool:
        motion, shown = self._motions.get(""), self.common_plan
        if motion is None or shown is None or motion.plan in (None, shown.plans[""]):
            return False
        self._take_plan({"": motion.plan}, name=shown.name)
        self._follow({"": motion})
        return True

    def _collect_motions(self) -> bool:
        motions = self._motions
        if not motions or not all(each.future.done() for each in motions.values()):
            return False
        self._motions = {}
        for arm in self.arms.values():
            arm.motion = None
            arm.leave_plan()
        errors = [each.future.exception() for each in motions.values()]
        failed = [error for error in errors if error is not None]
        first = next((error for error in failed if not isinstance(error, Interrupted)), None)
        if first is not None or (failed and self._cell is None):
            self._sentence = texts.ended(first or failed[0])
        elif failed:
            self._sentence = texts.ALL_STOPPED
        else:
            off = max(arm.distance_to_goal() for arm in self.arms.values())
            self._sentence = texts.arrived(off)
            self._arrived = self._sentence, tuple(arm.state.q for arm in self.arms.values())
        return True


def _clearances(cell: Cell, plans: Mapping[str, Plan]) -> tuple[Between, ...]:
    members = cell.members
    times = np.linspace(0.0, max(each.duration for each in plans.values()), LOOKS)
    courses = {name: members[name].along(plan.trajectory, 0.0) for name, plan in plans.items()}
    return clearances(members, courses, times)


def _apart(q: Array, other: Array) -> float:
    off: list[float] = (q - other).tolist()  # in plain numbers: it is asked for every picture
    return max(map(abs, off))


def _looks_different(state: JointState, other: JointState) -> bool:
    if state is other:
        return False
    return (
        state.mode is not other.mode
        or state.arm_moving
        or state.fault != other.fault
        or state.reading.alarms != other.reading.alarms
        or state.reading.let_go != other.reading.let_go
        or state.reading.silent != other.reading.silent
        or state.reading.driven != other.reading.driven
        or _apart(state.q, other.q) > SAME_PICTURE
        or abs(state.q_jaw - other.q_jaw) > SAME_PICTURE
    )
