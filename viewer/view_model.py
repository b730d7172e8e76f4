"""What the page's buttons do and what it shows, without the page.

The life of a target: aim (drag, type, pick a pose), plan, execute, arrived. A plan lives only as
long as the arm, the jaw, the speed and the target are those it was made for; whatever changes one
of them drops it, and with it the right to execute. Nothing here waits: planning and moving are
futures that ``refresh`` looks at.

One thread owns a ``ViewModel``.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

import numpy as np

from so101_motion.arm import START_TOLERANCE, Arm
from so101_motion.geometry import Array
from so101_motion.gripper import Gripper
from so101_motion.modes import Mode
from so101_motion.motion import Motion
from so101_motion.planning.plan import Plan
from so101_motion.state import JointState
from so101_motion.units import to_rad

from . import words
from .aim import Aim, Aimer
from .screen import Screen, Sentence, Tone, Way

SAME_POSE = to_rad(0.5)
"""Ghost and arm nearer than this are one picture, so the ghost is hidden [rad]; chosen."""

SAME_PICTURE = to_rad(0.005)
"""A joint that turned less than this is not drawn anew [rad]; chosen: 0.04 mm at full stretch."""

HINT_POINTS = 25
"""Points of the line that hints at the way before there is a plan; chosen, it looks smooth."""

_FIRST_OFFSETS = tuple(
    np.array([x, y, z])
    for z in (-0.10, 0.05)
    for x, y in ((-0.08, -0.16), (-0.08, 0.16), (0.05, 0.05), (-0.12, 0.0))
)
"""Where to look for a first target, seen from the tool [m]; chosen: aside, nearer and lower."""


class ViewModel:
    """The page's memory and its commands.

    Args:
        arm: What is shown and moved.
        gripper: The jaw.
        aimer: Inverse kinematics for the ghost.
        submit: Runs a call that takes a while elsewhere.
        welcome: The first sentence.
    """

    def __init__(
        self,
        *,
        arm: Arm,
        gripper: Gripper,
        aimer: Aimer,
        submit: Callable[[Callable[[], Plan]], Future[Plan]],
        welcome: str,
    ) -> None:
        self._arm, self._gripper, self._aimer, self._submit = arm, gripper, aimer, submit
        self._state = self._shown = arm.state
        self._sentence = Sentence(text=welcome)
        self._plan: Plan | None = None
        self._plan_is_current = False
        self._planning: Future[Plan] | None = None
        self._motion: Motion | None = None
        self._t_begin: float | None = None
        self._preview_time = 0.0
        self._aim = self._first_aim()
        self._way = self._hint()

    # Commands

    def aim_at(self, p_base: Array) -> None:
        """Take a new target point, shape (3,), [m]."""
        state = self._state
        self._take(self._aimer.at_point(p_base, q_seed=state.q_ref, q_jaw=state.q_jaw_ref))

    def aim_at_joints(self, q: Array) -> None:
        """Take joint angles as the target, shape (5,), [rad]."""
        self._take(self._aimer.at_joints(q, q_jaw=self._state.q_jaw_ref))

    def set_speed(self, speed: float) -> None:
        """Set the speed cap of the next plan [rad/s]."""
        self._arm.set_speed(speed)
        self._drop_plan(words.SPEED_CHANGED if self._plan_is_current else words.PRESS_PLAN)

    def plan(self) -> None:
        """Plan to the target; the arm stays where it is."""
        if self._can_plan():
            goal = self._aim.goal
            self._planning = self._submit(lambda: self._arm.plan(goal))
            self._sentence = words.PLANNING

    def show(self, plan: Plan) -> None:
        """Show a plan that was made elsewhere, as if it had been made here."""
        self._aim = self._aimer.at_joints(plan.q_goal, q_jaw=self._state.q_jaw_ref)
        self._take_plan(plan)

    def preview(self, t: float) -> None:
        """Show the ghost ``t`` seconds into the plan."""
        if self._plan is not None and self._plan_is_current:
            self._preview_time = min(max(t, 0.0), self._plan.trajectory.duration)

    def execute(self) -> None:
        """Move the arm along the plan that is shown."""
        if self._plan is not None and self._can_execute():
            self._motion = self._arm.start_execute(self._plan)
            self._t_begin = None
            self._preview_time = self._plan.trajectory.duration
            self._sentence = words.MOVING

    def move_jaw(self, aperture: float) -> None:
        """Move the gripper at once: 0 closed, 1 open."""
        self._gripper.start_move(aperture)
        if self._plan_is_current and self._motion is None:
            self._drop_plan(words.JAW_MOVED)

    def report(self, error: Exception) -> None:
        """Say that a command failed."""
        self._sentence = words.ended(error)

    # What time brings

    def refresh(self) -> bool:
        """Take note of what happened since the last call.

        Returns:
            Whether there is anything new to show.
        """
        self._state = self._arm.state
        if self._motion is not None and self._t_begin is None and self._state.arm_moving:
            self._t_begin = self._state.t
        events = (self._collect_plan(), self._collect_motion(), self._notice_departure())
        if not any(events) and not _looks_different(self._state, self._shown):
            return False
        self._shown = self._state
        if not self._plan_is_current:
            self._way = self._hint()
        return True

    def screen(self) -> Screen:
        """Everything to be shown now."""
        q_ghost = self._q_ghost()
        sentence = self._sentence
        if self._aim.problem is not None and self._motion is None:
            sentence = Sentence(text=self._aim.problem, tone=Tone.BAD)
        return Screen(
            state=self._state,
            aim=self._aim,
            q_ghost=None if _apart(q_ghost, self._state.q) < SAME_POSE else q_ghost,
            way=self._way,
            sentence=words.blocked(self._state) or sentence,
            plan=self._plan,
            plan_is_current=self._plan_is_current,
            can_plan=self._can_plan(),
            can_execute=self._can_execute(),
            preview_time=self._preview_time,
            progress=self._progress(),
            speed=self._arm.speed,
        )

    # How

    def _first_aim(self) -> Aim:
        """A target beside the arm, so that the first picture already shows a way to go."""
        state = self._state
        p_now = self._aimer.tool_point(state.q_ref)
        aims = (
            self._aimer.at_point(p_now + offset, q_seed=state.q_ref, q_jaw=state.q_jaw_ref)
            for offset in _FIRST_OFFSETS
        )
        here = self._aimer.at_joints(state.q_ref, q_jaw=state.q_jaw_ref)
        return next((aim for aim in aims if aim.problem is None), here)

    def _take(self, aim: Aim) -> None:
        self._aim = aim
        there = _apart(aim.q, self._state.q_ref) <= START_TOLERANCE
        self._drop_plan(words.ALREADY_THERE if there else words.PRESS_PLAN)

    def _drop_plan(self, sentence: Sentence) -> None:
        self._planning = None
        self._plan_is_current = False
        self._way = self._hint()
        if self._motion is None:
            self._sentence = sentence

    def _hint(self) -> Way | None:
        start, goal = self._state.q_ref, self._aim.q
        if self._aim.problem is not None or _apart(goal, start) < SAME_POSE:
            return None
        steps = np.linspace(start, goal, HINT_POINTS)
        return Way(points=np.array([self._aimer.tool_point(q) for q in steps]), planned=False)

    def _collect_plan(self) -> bool:
        if self._planning is None or not self._planning.done():
            return False
        future, self._planning = self._planning, None
        error = future.exception()
        if error is not None:
            self._sentence = words.ended(error)
            return True
        self._take_plan(future.result())
        return True

    def _take_plan(self, plan: Plan) -> None:
        self._plan, self._plan_is_current = plan, True
        self._way = Way(points=plan.tool_path, planned=True)
        self._preview_time = plan.trajectory.duration
        self._sentence = words.PLANNED

    def _collect_motion(self) -> bool:
        if self._motion is None or not self._motion.future.done():
            return False
        motion, self._motion = self._motion, None
        self._plan_is_current = False
        error = motion.future.exception()
        if error is not None:
            self._sentence = words.ended(error)
        elif self._plan is not None:
            p_goal = self._aimer.tool_point(self._plan.q_goal)
            off = self._aimer.tool_point(self._state.q) - p_goal
            self._sentence = words.arrived(float(np.linalg.norm(off)))
        return True

    def _notice_departure(self) -> bool:
        """Drop a plan whose start the arm has left, whoever moved it."""
        if self._plan is None or not self._plan_is_current or self._motion is not None:
            return False
        if _apart(self._plan.q_start, self._state.q_ref) <= START_TOLERANCE:
            return False
        self._drop_plan(words.ARM_MOVED)
        return True

    def _q_ghost(self) -> Array:
        if self._plan is not None and self._plan_is_current:
            return self._plan.trajectory.sample(self._preview_time).q
        return self._aim.q

    def _can_plan(self) -> bool:
        return (
            self._aim.problem is None
            and self._planning is None
            and self._motion is None
            and self._state.mode is Mode.HOLDING
            and _apart(self._aim.q, self._state.q_ref) > START_TOLERANCE
        )

    def _can_execute(self) -> bool:
        return self._plan_is_current and self._motion is None and self._state.mode is Mode.HOLDING

    def _progress(self) -> float:
        if self._motion is None or self._plan is None or self._t_begin is None:
            return 0.0
        elapsed = self._state.t - self._t_begin
        return min(elapsed / max(self._plan.trajectory.duration, 1e-9), 1.0)


def _apart(q: Array, other: Array) -> float:
    return float(np.max(np.abs(q - other)))


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
