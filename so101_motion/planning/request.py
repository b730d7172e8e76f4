"""The planner's request and its plan, as plain values that can be pickled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array, frozen_array
from so101_motion.planning.collision.course import OtherArm
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import Goal
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Payload, Strength
from so101_motion.planning.timing.trajectory import Trajectory


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Search:
    """Options of one plan beside its goal and its caps.

    Attributes:
        scene: What is around and in the hand; None for what the arm knows.
        frames: Further frames fixed to the tool that the goal may name: ``T_tool_frame`` by name.
        seed: Of the random choices when a path around something is searched.
        time_budget: When to give up searching [s].
    """

    scene: Scene | None = None
    frames: Mapping[str, SE3] = field(default_factory=dict)
    seed: int = 0
    time_budget: float = 5.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanRequest:
    """Everything a plan depends on.

    Attributes:
        q_start: Where the arm stands, shape (5,), [rad]; may be outside the joint limits.
        goal: What is wanted.
        limits: Speed, acceleration and jerk caps of the five joints, and of the tool.
        q_jaw: Jaw angle during the motion [rad].
        scene: What is around the arm and in its hand.
        others: Other arms that share the space, and what they are about to do.
        payload: What the gripper carries beside what is attached in the scene.
        strength: What the servos can bear; None not to look at torques.
        frames: Further frames fixed to the tool that the goal may name: ``T_tool_frame`` by name.
        lower: Smallest joint angles of this very arm, shape (5,), [rad]; None for the model's. The
            narrower of the two counts.
        upper: Largest joint angles, likewise.
        dt: Time between the samples of the motion [s].
        seed: Of the random choices when a path around something is searched.
        time_budget: When to give up searching [s].
    """

    q_start: Array
    goal: Goal
    limits: MotionLimits
    q_jaw: float = 0.0
    scene: Scene = field(default_factory=Scene)
    others: tuple[OtherArm, ...] = ()
    payload: Payload | None = None
    strength: Strength | None = None
    frames: Mapping[str, SE3] = field(default_factory=dict)
    lower: Array | None = None
    upper: Array | None = None
    dt: float = 0.01
    seed: int = 0
    time_budget: float = 5.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "q_start", frozen_array(self.q_start, (5,)))
        if not np.all(np.isfinite(self.q_start)):
            raise ConfigError("q_start", self.q_start, "must be five finite joint angles [rad]")
        if not math.isfinite(self.q_jaw):
            raise ConfigError("q_jaw", self.q_jaw, "must be a finite angle [rad]")
        for key in ("lower", "upper"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, frozen_array(getattr(self, key), (5,)))
        for key in ("dt", "time_budget"):
            if not 0.0 < getattr(self, key) < math.inf:
                raise ConfigError(key, getattr(self, key), "must be positive and finite [s]")
        if not isinstance(self.seed, (int, np.integer)) or self.seed < 0:
            raise ConfigError("seed", self.seed, "must be a whole number, 0 or more")
        if not isinstance(self.goal, Goal):
            raise TypeError(f"a goal is one of planning.goals, not a {type(self.goal).__name__}")


class PathDeviation(NamedTuple):
    """How far the tool leaves a path that was prescribed, at the most.

    Attributes:
        position: Its distance from the path [m].
        angle: How far it is turned off, as far as the goal's metric counts it [rad].
    """

    position: float
    angle: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanReport:
    """Figures on how a plan was made.

    Attributes:
        stages_ms: Wall time of each stage that ran, and ``"total"`` [ms].
        branch: The IK branch of the goal, for pose goals.
        straight: Whether the motion is one straight line in joint space.
        departure: Whether the start had to be left slowly first, see ``start_recovery.py``.
        load: Largest share of a velocity, acceleration or jerk limit that is used.
        effort: Largest share of what a servo may have to exert; 0 when that was not looked at.
        waits: How long the arm waits for others before it moves [s]; part of the motion.
        waits_for: The names of the arms it waits for, or goes around.
        clearance: How close bodies are at the goal [m].
        closest: The two bodies that are.
        path_deviation: For a line or path of the tool what five joints make of it, else None.
    """

    stages_ms: Mapping[str, float]
    branch: str | None
    straight: bool
    departure: bool
    load: float
    clearance: float
    closest: tuple[str, str]
    path_deviation: PathDeviation | None = None
    effort: float = 0.0
    waits: float = 0.0
    waits_for: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """A verified motion, and what it was made from.

    Attributes:
        q_start: Where it starts, shape (5,), [rad].
        q_goal: Where it ends, shape (5,), [rad].
        trajectory: The motion.
        path: The joint waypoints it follows, shape (m, 5), [rad].
        tool_path: Points of the tool's path in the base frame, shape (k, 3), [m].
        limits: The caps it keeps.
        report: How it came about.
    """

    q_start: Array
    q_goal: Array
    trajectory: Trajectory
    path: Array
    tool_path: Array
    limits: MotionLimits
    report: PlanReport

    def __post_init__(self) -> None:
        for name, shape in (
            ("q_start", (5,)),
            ("q_goal", (5,)),
            ("path", (-1, 5)),
            ("tool_path", (-1, 3)),
        ):
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape))

    @property
    def duration(self) -> float:
        """How long the motion takes [s]."""
        return self.trajectory.duration
