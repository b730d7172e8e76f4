"""What the planner is asked and what it answers, as plain values that cross a process boundary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from so101_motion.errors import ConfigError
from so101_motion.geometry import Array, frozen_array
from so101_motion.planning.collision import FLOOR_Z
from so101_motion.planning.goals import Goal
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.trajectory import Trajectory


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanRequest:
    """Everything a plan depends on.

    Attributes:
        q_start: Where the arm stands, shape (5,), [rad]; may be outside the limits.
        goal: What is wanted.
        limits: Speed, acceleration and jerk caps of the five joints, and of the tool.
        q_jaw: Jaw angle during the motion [rad].
        floor_z: Height of the table in the base frame [m], or None for no table.
        dt: Time between the samples of the motion [s].
        seed: Of the random choices when a way around something is searched.
        time_budget: When to give up searching [s].
    """

    q_start: Array
    goal: Goal
    limits: MotionLimits
    q_jaw: float = 0.0
    floor_z: float | None = FLOOR_Z
    dt: float = 0.01
    seed: int = 0
    time_budget: float = 5.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "q_start", frozen_array(self.q_start, (5,)))
        if not np.all(np.isfinite(self.q_start)):
            raise ConfigError("q_start", self.q_start, "must be five finite joint angles [rad]")
        if not math.isfinite(self.q_jaw):
            raise ConfigError("q_jaw", self.q_jaw, "must be a finite angle [rad]")
        if self.floor_z is not None and not math.isfinite(self.floor_z):
            raise ConfigError("floor_z", self.floor_z, "must be a finite height [m], or None")
        for key in ("dt", "time_budget"):
            if not 0.0 < getattr(self, key) < math.inf:
                raise ConfigError(key, getattr(self, key), "must be positive and finite [s]")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanReport:
    """How a plan came about.

    Attributes:
        stages_ms: Wall time of each stage that ran, and ``"total"`` [ms].
        branch: The IK branch of the goal, for pose goals.
        straight: Whether the motion is one straight line in joint space.
        departure: Whether the start had to be left slowly first, see ``departure.py``.
        load: Largest share of a velocity, acceleration or jerk limit that is used.
        clearance: How close bodies are at the goal [m].
        closest: The two bodies that are.
    """

    stages_ms: Mapping[str, float]
    branch: str | None
    straight: bool
    departure: bool
    load: float
    clearance: float
    closest: tuple[str, str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """A motion, verified, and what it was made from.

    Attributes:
        q_start: Where it starts, shape (5,), [rad].
        q_goal: Where it ends, shape (5,), [rad].
        trajectory: The motion.
        path: The joint waypoints it follows, shape (m, 5), [rad].
        tool_path: Points of the tool's way in the base frame, shape (k, 3), [m].
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
