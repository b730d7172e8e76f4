"""State and commands of the Move tab, without viser.

A target is chosen, planned, executed and reached. A plan is dropped as soon as the arm, the
gripper, the speed limits, the surroundings or the target differ from those it was made for.
Nothing here waits: slow calls are futures that ``refresh`` collects. One thread owns a
``ViewModel``.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import numpy as np

from so101_motion.arm.arm import START_TOLERANCE, Arm
from so101_motion.arm.gripper import Gripper
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.state import JointState
from so101_motion.common.units import to_rad
from so101_motion.planning.goals import LeaveContactGoal
from so101_motion.planning.request import Plan
from so101_motion.rig.protocols import GripperLike

from .page import texts
from .page.plan_view import PathLine, PlanView, Playback, plan_view
from .page.screen_state import Sentence, Tone
from .page.target_editor import TargetEditor
from .page.target_ik import Surroundings, Target, TargetSolver
from .page.tracking import MotionTracker, Tracking

SAME_POSE = to_rad(0.5)
"""Ghost and arm nearer than this are one picture, so the ghost is hidden [rad]; chosen."""

SAME_PICTURE = to_rad(0.005)
"""A joint that turned less than this is not drawn anew [rad]; chosen: 0.04 mm at full stretch."""

HINT_POINTS = 25
"""Points of the dashed line before there is a plan; chosen: it looks smooth."""


class ViewModel(TargetEditor):
    """State and commands of the Move tab.

    Attributes:
        plan_view: The newest plan and what is drawn of it; None before the first.
        plan_is_current: Whether that plan can still be executed.
        replans: Whether ``execute`` plans again while the arm moves, when the scene changes.
        drops: How often a plan was dropped because something has changed.
        ran: The newest plan that was executed and how it was followed; None before.
    """

    def __init__(
        self,
        *,
        arm: Arm,
        gripper: GripperLike,
        load_solver: Callable[[Surroundings], TargetSolver],
        submit: Callable[[Callable[[], Any]], Future[Any]],
        now: Callable[[], float],
        welcome: str,
    ) -> None:
        self.arm, self.gripper, self._submit, self._now = arm, gripper, submit, now
        self._load_solver = load_solver
        self._around = Surroundings(arm.scene, arm.range)
        self._caps = (arm.speed, arm.acceleration)  # of the plan that is shown or being made
        super().__init__(load_solver(self._around), arm.state, now)
        self._loading: Future[TargetSolver] | None = None
        self._shown = arm.state
        self._sentence = Sentence(welcome)
        self.plan_view: PlanView | None = None
        self.plan_is_current = False
        self._planning: Future[Plan] | None = None
        self._motion: Motion | None = None
        self._backs_out = False
        self._in_contact: tuple[object, bytes, bool] = (None, b"", False)  # where it was looked
        self.sweeps, self.replans = True, False
        self._playback = Playback()
        self.tracker = MotionTracker()
        self._count = 0  # plans that were shown
        self.drops = 0
        self.ran: tuple[PlanView, Tracking] | None = None
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

    def plan(self) -> None:
        if self.can_plan:
            goal = self._target.goal
            self._planning = self._submit(lambda: self.arm.plan(goal))
            self._backs_out, self._sentence = False, texts.PLANNING

    def plan_back_out(self) -> None:
        """Plan slowly out of the contact in which the arm stands; it stays where it is."""
        if self._may_plan():
            self._planning = self._submit(lambda: self.arm.plan(LeaveContactGoal()))
            self._backs_out, self._sentence = True, texts.PLANNING

    def show(self, plan: Plan) -> None:
        self._target = self._at_joints(plan.q_goal, self._target.frame)
        self.history.add((self._target, self._kind))
        self.take_plan(plan)

    def take_plan(self, plan: Plan, name: str = "") -> None:
        """Show a plan to the target that is set, under a name or its number."""
        newest, self._count = self.arm.newest, self._count + 1
        made_for = newest[0] if newest is not None and newest[1] is plan else None
        view = plan_view(
            plan,
            self._solver,
            self._target.frame,
            scene=self.arm.scene if made_for is None else made_for.scene,
            q_jaw=self.state.q_jaw_ref if made_for is None else made_for.q_jaw,
            name=name or f"Plan {self._count}",
        )
        self.plan_view, self.plan_is_current = view, True
        self.path = view.path
        self._playback.load(plan.duration)
        self._sentence = texts.PLANNED

    def drop_plan(self, sentence: Sentence) -> None:
        """Forget the plan, also one that is being made, and say why."""
        self.drops += 1
        self._planning = None
        self.plan_is_current = False
        self.path = self._hint()
        if self._motion is None:
            self._sentence = sentence

    def preview(self, t: float) -> None:
        if self.plan_is_current:
            self._playback.seek(t)

    def play(self, rate: float) -> None:
        if self.plan_is_current:
            self._playback.play(rate)

    def show_sweep(self, shown: bool) -> None:
        self.sweeps = shown

    def set_replan(self, replans: bool) -> None:
        """Let the next motion be planned again while it moves, or not."""
        self.replans = replans

    def execute(self) -> None:
        """Move the arm along the plan that is shown, or with such plans to the target."""
        if self.plan_view is None or not self.can_execute:
            return
        if self.replans and not self._backs_out:
            self.follow(self.arm.move(self._target.goal, replan=True, wait=False))
        else:
            self.follow(self.arm.move(self.plan_view.plan, wait=False))

    def follow(self, motion: Motion) -> None:
        if self.plan_view is not None:
            self._motion = motion
            self.tracker.began = None
            self._playback.seek(self.plan_view.plan.duration)
            self._sentence = texts.MOVING

    def move_jaw(self, aperture: float) -> None:
        """Move the gripper at once: 0 closed, 1 open."""
        self.gripper.move(aperture, wait=False)
        if self.plan_is_current and self._motion is None:
            self.drop_plan(texts.JAW_MOVED)

    def set_force(self, force: float) -> None:
        """Set how hard a grip presses, as a share of what the servo can keep up."""
        if isinstance(self.gripper, Gripper):
            self.gripper.set_force(force)

    def report(self, error: BaseException) -> None:
        self._sentence = texts.ended(error)

    def tell(self, sentence: Sentence) -> None:
        self._sentence = sentence

    @property
    def q_arm(self) -> Array:
        """The arm's reference, shape (5,), [rad], or its measured angles after hand guiding."""
        state = self.arm.state
        return state.q_ref if state.mode is Mode.HOLDING else np.clip(state.q, *self.arm.range)

    def distance_to_goal(self) -> float:
        """How far the arm is from the end of the newest plan [m]; 0 before the first."""
        if self.plan_view is None:
            return 0.0
        goal, here = (
            self._solver.point(q, self._target.frame)
            for q in (self.plan_view.plan.q_goal, self.state.q)
        )
        return float(np.linalg.norm(here - goal))

    # Updates

    def refresh(self) -> bool:
        """Take in changes since the last call; return whether there is anything new to show."""
        self.state = self.arm.state
        if self._motion is None and texts.blocked(self.state) is not None:
            self._sentence = texts.HOLDS_AGAIN  # for later: where it arrived is no longer true
        own = None if self._motion is None else self.plan_view
        events = (
            self._follow_surroundings(),
            self._follow_caps(),
            self._track("another motion" if own is None else own.name),
            self._collect_plan(),
            self._show_plan_under_way(),
            self._collect_motion(),
            self._notice_departure(),
            self._playback.advance(self._now()),
        )
        if not any(events) and not _looks_different(self.state, self._shown):
            return False
        self._shown = self.state
        if not self.plan_is_current:
            self.path = self._hint()
        return True

    # What is shown

    @property
    def arms(self) -> dict[str, ViewModel]:
        return {"": self}

    @property
    def sentence(self) -> Sentence:
        sentence = self._sentence
        if self._target.problem is not None and self._motion is None:
            sentence = Sentence(self._target.problem, Tone.BAD)
        return texts.blocked(self.state) or sentence

    @property
    def q_ghost(self) -> Array | None:
        """Where the ghost stands, shape (5,), [rad]; None when it is hidden."""
        q = self._target.q
        if self.plan_view is not None and self.plan_is_current:
            q = self.plan_view.plan.trajectory.sample(self._playback.t).q
        return None if _apart(q, self.state.q) < SAME_POSE else q

    @property
    def sweep(self) -> Array | None:
        """Configurations along the path to be shown, shape (k, 5), [rad], or None."""
        has_plan = self.plan_view is not None and self.plan_is_current and self.sweeps
        return self.plan_view.sweep if self.plan_view is not None and has_plan else None

    @property
    def preview_time(self) -> float:
        """How far into the plan the ghost stands [s]."""
        return self._playback.t

    @property
    def progress(self) -> float:
        """Share of the motion that is done, 0 to 1."""
        began = self.tracker.began
        if self._motion is None or self.plan_view is None or began is None:
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
    def can_plan(self) -> bool:
        return (
            self._may_plan()
            and self._target.problem is None
            and _apart(self._target.q, self.state.q_ref) > START_TOLERANCE
        )

    @property
    def can_back_out(self) -> bool:
        if not self._may_plan():
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
            and self._motion is None
            and self.state.mode is Mode.HOLDING
            and Surroundings(self.arm.scene, self.arm.range).same_as(self._around)
            and self.caps == self._caps
        )

    # Helpers

    def _aim(self, target: Target) -> None:
        self._target = target
        there = _apart(target.q, self.state.q_ref) <= START_TOLERANCE
        self.drop_plan(texts.ALREADY_THERE if there else texts.PRESS_PLAN)

    def _follow_caps(self) -> bool:
        """Drop a plan that was made with other caps, whoever has set the new ones."""
        caps = self.caps
        if caps == self._caps:
            return False
        self._caps = caps
        if self.plan_is_current or self._planning is not None:
            self.drop_plan(texts.CAPS_CHANGED)
        return True

    def _hint(self) -> PathLine | None:
        start, goal = self.state.q_ref, self._target.q
        if self._target.problem is not None or _apart(goal, start) < SAME_POSE:
            return None
        steps = np.linspace(start, goal, HINT_POINTS)
        points = np.array([self._solver.point(q, self._target.frame) for q in steps])
        return PathLine(points=points, planned=False)

    def _follow_surroundings(self) -> bool:
        """Use a changed scene or joint range, on a worker thread."""
        around = Surroundings(self.arm.scene, self.arm.range)
        if self._loading is None and not around.same_as(self._around):
            self._around = around
            self._loading = self._submit(lambda: self._load_solver(around))
            moves_on = self.replans and self._motion is not None
            if (self.plan_is_current or self._planning is not None) and not moves_on:
                self.drop_plan(texts.SURROUNDINGS_CHANGED)
            return True
        if self._loading is None or not self._loading.done():
            return False
        loading, self._loading = self._loading, None
        error = loading.exception()
        if error is not None:
            self.report(error)
            return True
        self._solver = loading.result()
        self._target = self._again(self._target)
        return True

    def _track(self, name: str) -> bool:
        tracker, plan = self.tracker, self.plan_view
        ended = tracker.take(self.state, name)
        is_own = ended and plan is not None and tracker.newest_name == plan.name
        if is_own and plan is not None and tracker.newest is not None:
            self.ran = plan, tracker.newest
        return ended

    def _collect_plan(self) -> bool:
        if self._planning is None or not self._planning.done():
            return False
        future, self._planning = self._planning, None
        error = future.exception()
        if error is not None:
            self._sentence = texts.ended(error)
        elif self._backs_out:
            self.show(future.result())
        else:
            self.take_plan(future.result())
        return True

    def _show_plan_under_way(self) -> bool:
        """Show the plan that the arm follows, if that is another one than before."""
        motion, shown = self._motion, self.plan_view
        if motion is None or shown is None or motion.plan in (None, shown.plan):
            return False
        self.take_plan(motion.plan, shown.name)
        self.follow(motion)
        return True

    def _collect_motion(self) -> bool:
        if self._motion is None or not self._motion.future.done():
            return False
        motion, self._motion = self._motion, None
        self.plan_is_current = False
        error = motion.future.exception()
        if error is not None:
            self._sentence = texts.ended(error)
        else:
            self._sentence = texts.arrived(self.distance_to_goal())
        return True

    def _notice_departure(self) -> bool:
        """Drop a plan whose start the arm has left."""
        if self.plan_view is None or not self.plan_is_current or self._motion is not None:
            return False
        if _apart(self.plan_view.plan.q_start, self.state.q_ref) <= START_TOLERANCE:
            return False
        self.drop_plan(texts.ARM_MOVED)
        return True

    def _may_plan(self) -> bool:
        return self._planning is None and self._motion is None and self.state.mode is Mode.HOLDING


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
        or _apart(state.q, other.q) > SAME_PICTURE
        or abs(state.q_jaw - other.q_jaw) > SAME_PICTURE
    )
