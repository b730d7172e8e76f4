"""Everything the Move tab shows at one instant, as values."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from enum import Enum

from so101_motion.common.geometry import Array
from so101_motion.common.state import JointState
from so101_motion.planning.collision.collision import Clearance
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.request import Plan

from .target_ik import Direction, Target
from .tracking import Tracking


class Tone(Enum):
    """The kind of a sentence, which gives its colour."""

    PLAIN = "plain"
    GOOD = "good"
    WARM = "warm"
    BAD = "bad"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sentence:
    """The status sentence: what is going on, or what to do now."""

    text: str
    tone: Tone = Tone.PLAIN


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathLine:
    """The tool's path to the target.

    Attributes:
        points: Shape (k, 3), [m], in the base frame.
        planned: Whether it is a plan's, or only a preview before there is one.
    """

    points: Array
    planned: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanView:
    """A plan and what is drawn of it.

    Attributes:
        plan: The plan.
        path: The line of the frame that the target is for.
        sweep: Configurations along the path, both ends left out, shape (k, 5), [rad].
        closest: The closest approach of two bodies anywhere on the path.
        t_closest: When that is [s].
        scene: What was around the arm.
        q_jaw: Jaw angle [rad].
        name: What the page calls it, such as ``"Plan 3"``.
        made_at: When it was made.
    """

    plan: Plan
    path: PathLine
    sweep: Array
    closest: Clearance
    t_closest: float
    scene: Scene
    q_jaw: float
    name: str = "Plan"
    made_at: datetime = field(default_factory=datetime.now)

    @property
    def duration(self) -> float:
        """How long the plan takes [s]."""
        return self.plan.duration


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanScreen:
    """What the Move tab shows of a plan of one arm or several, and which buttons are enabled.

    Attributes:
        sentence: What to know or to do now.
        plan_is_current: Whether the newest plan can still be looked at and executed.
        can_plan: Whether Plan may be pressed.
        can_execute: Whether Execute may be pressed.
        preview_time: How far into the plan the ghosts stand [s].
        progress: Share of the motion that is done, 0 to 1.
        speed: Speed cap of the next plan [rad/s].
        acceleration: Acceleration cap of the next plan [rad/s^2].
        sweeps: Whether configurations along the path are shown when there is a plan.
    """

    sentence: Sentence
    plan_is_current: bool
    can_plan: bool
    can_execute: bool
    preview_time: float
    progress: float
    speed: float
    acceleration: float
    sweeps: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Screen(PlanScreen):
    """Everything that the Move tab shows of an arm.

    Attributes:
        state: The arm, as it is.
        target: The target.
        kind: How much of the gripper's direction is chosen, see ``target_editor.DIRECTIONS``.
        direction: Where it points at the target, or shall point.
        R_base_target: How the target is turned, shape (3, 3).
        q_ghost: Where the ghost stands, shape (5,), [rad]; None when it is hidden.
        path: The line to the target, or None.
        sweep: Configurations along the path to be shown, shape (k, 5), [rad], or None.
        plan: The newest plan and what there is to see of it, or None before the first.
        can_take_nearest: Whether the target cannot be had, so that one near it may be looked for.
        can_back_out: Whether the arm is in contact where it stands and may leave it.
        can_undo: Whether there was a target before.
        can_redo: Whether one was undone.
        holds: Whether the gripper holds something.
        force: How hard a grip presses, as a share of what the servo can keep up; None where that
            cannot be chosen.
        rate: How fast it is being played; None while it stands.
        tracking: How well the newest motion that ended was followed; None before.
        tracked: What that motion was: the name of its plan, or words for another one.
        range: The smallest and the largest joint angles, shapes (5,), [rad].
    """

    state: JointState
    target: Target
    kind: str
    direction: Direction
    R_base_target: Array
    q_ghost: Array | None
    path: PathLine | None
    sweep: Array | None
    plan: PlanView | None
    can_take_nearest: bool
    can_back_out: bool
    can_undo: bool
    can_redo: bool
    holds: bool
    force: float | None
    rate: float | None
    tracking: Tracking | None
    tracked: str
    range: tuple[Array, Array]

    @property
    def arms(self) -> dict[str, Screen]:
        """This one, as that of a single arm."""
        return {"": self}
