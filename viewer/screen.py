"""Everything the page shows at one instant, as values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from so101_motion.geometry import Array
from so101_motion.planning.plan import Plan
from so101_motion.state import JointState

from .aim import Aim


class Tone(Enum):
    """How a sentence is meant."""

    PLAIN = "plain"
    GOOD = "good"
    BAD = "bad"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sentence:
    """What to know or to do now."""

    text: str
    tone: Tone = Tone.PLAIN


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Way:
    """The line of the tool to the target.

    Attributes:
        points: Shape (k, 3), [m], in the base frame.
        planned: Whether it is a plan's, or only a hint at one.
    """

    points: Array
    planned: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Screen:
    """The picture, the words and which buttons can be pressed.

    Attributes:
        state: The arm, as it is.
        aim: The target.
        q_ghost: Where the ghost stands, shape (5,), [rad]; None when it is hidden.
        way: The line to the target, or None.
        sentence: What to know or to do now.
        plan: The newest plan, or None before the first.
        plan_is_current: Whether that plan can still be looked at and executed.
        can_plan: Whether Plan may be pressed.
        can_execute: Whether Execute may be pressed.
        preview_time: How far into the plan the ghost stands [s].
        progress: Share of the motion that is done, 0 to 1.
        speed: Speed cap of the next plan [rad/s].
    """

    state: JointState
    aim: Aim
    q_ghost: Array | None
    way: Way | None
    sentence: Sentence
    plan: Plan | None
    plan_is_current: bool
    can_plan: bool
    can_execute: bool
    preview_time: float
    progress: float
    speed: float
