"""Sentences, and what is drawn of a plan, as values."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from enum import Enum

from so101_motion.common.geometry import Array
from so101_motion.planning.collision.collision import Clearance
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.request import Plan


class Tone(Enum):
    """The kind of a sentence, which gives its colour."""

    PLAIN = "plain"
    GOOD = "good"
    WARM = "warm"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class Sentence:
    """The status sentence: what is going on, or what to do now."""

    text: str
    tone: Tone = Tone.PLAIN


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathLine:
    """The tool's path to the target, or a guess of it: shape (k, 3), [m], in the base frame."""

    points: Array
    planned: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanView:
    """A plan and what is drawn of it.

    Attributes:
        path: The line of the frame that the target is for.
        sweep: Configurations along the path, both ends left out, shape (k, 5), [rad].
        closest: The closest approach of two bodies anywhere on the path, at ``t_closest`` [s].
        scene: What was around the arm.
        q_jaw: Jaw angle [rad].
        name: What the page calls it, such as ``"Plan 3"``.
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
        return self.plan.duration
