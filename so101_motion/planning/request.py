"""The planner's request and its plan, as plain values that can be pickled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from so101_motion.common.attributes import ABOVE_ZERO, checked_kind, checked_number
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array, Brief, angle, freeze, joint_angles, pose
from so101_motion.common.public import Public
from so101_motion.common.units import to_deg, to_mm
from so101_motion.planning.collision.course import OtherArm
from so101_motion.planning.collision.scene import Scene, checked_scene
from so101_motion.planning.goals import Goal
from so101_motion.planning.timing.limits import MotionLimits, checked_limits
from so101_motion.planning.timing.torque import Payload, Strength
from so101_motion.planning.timing.trajectory import Trajectory

ROUTE_EFFORT = 16  # routes compared; chosen: a third of the gain of hundreds, in 50 ms
HURRIED_EFFORT = 3  # the same where there is little time, at most. Chosen: some milliseconds
MOST_ROUTES = 10_000  # most routes that may be compared


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Search(Brief):
    """Options of a planning request besides its goal and caps.

    Attributes:
        scene: Obstacles and held objects; None for those that the arm knows.
        frames: Further frames fixed to the tool that the goal may name: ``T_tool_frame`` by name.
        seed: Seed of the random choices in a search for a path.
        time_budget: Longest search [s].
        route_effort: How many routes are compared where the straight one is blocked.
    """

    scene: Scene | None = None
    frames: Mapping[str, SE3] = field(default_factory=dict)
    seed: int = 0
    time_budget: float = 5.0
    route_effort: int = ROUTE_EFFORT

    def __post_init__(self) -> None:
        frames = {name: pose(name, given, 2.0) for name, given in self.frames.items()}
        object.__setattr__(self, "frames", frames)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PlanRequest(Brief):
    """Everything a plan depends on.

    Attributes:
        q_start: Present joint angles, shape (5,), [rad]; may be outside the joint limits.
        goal: The goal.
        limits: Speed, acceleration and jerk caps of the five joints, and of the tool.
        q_jaw: Jaw angle during the motion [rad].
        scene: The obstacles around the arm and the objects it holds.
        others: Other arms that share the space, with their courses.
        lead: For an arm that moves: how it would come to rest at ``q_start``. The plan begins in
            the first state of it. Not among other arms.
        payload: The gripper's payload without the objects attached in the scene.
        strength: Torque limits of the servos; None not to check torques.
        frames: Further frames fixed to the tool that the goal may name: ``T_tool_frame`` by name.
        lower: Smallest joint angles of this particular arm, shape (5,), [rad]; None for the
            model's. The narrower limit counts.
        upper: Largest joint angles, likewise.
        dt: Time between the samples of the motion [s].
        seed: Seed of the random choices in a search for a path.
        time_budget: Longest search [s].
        route_effort: How many routes are compared where the straight one is blocked.
    """

    q_start: Array
    goal: Goal
    limits: MotionLimits
    q_jaw: float = 0.0
    scene: Scene = field(default_factory=Scene)
    others: tuple[OtherArm, ...] = ()
    lead: Trajectory | None = None
    payload: Payload | None = None
    strength: Strength | None = None
    frames: Mapping[str, SE3] = field(default_factory=dict)
    lower: Array | None = None
    upper: Array | None = None
    dt: float = 0.01
    seed: int = 0
    time_budget: float = 5.0
    route_effort: int = ROUTE_EFFORT

    def __post_init__(self) -> None:
        object.__setattr__(self, "q_start", joint_angles("q_start", self.q_start))
        angle("q_jaw", self.q_jaw)
        for key in ("lower", "upper"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, joint_angles(key, getattr(self, key)))
        for key in ("dt", "time_budget"):
            checked_number(key, getattr(self, key), lower=ABOVE_ZERO, unit="s")
        if not isinstance(self.seed, (int, np.integer)) or self.seed < 0:
            raise ConfigError("seed", self.seed, "must be a whole number, 0 or more")
        effort = self.route_effort
        if not isinstance(effort, (int, np.integer)) or not 1 <= effort <= MOST_ROUTES:
            raise ConfigError("route_effort", effort, f"must be a whole number, 1 to {MOST_ROUTES}")
        checked_kind("goal", self.goal, Goal, "a goal, as so101.point(x, y, z) or JointGoal(q=...)")
        if checked_limits(self.limits, 5) is None:
            raise ConfigError("limits", None, "are needed; MotionLimits.uniform(...) makes them")
        checked_scene(self.scene)


class PathDeviation(NamedTuple):
    """Largest deviation of the tool from a prescribed path.

    Attributes:
        position: Its distance from the path [m].
        angle: Deviation of its orientation, as far as the goal's metric counts it [rad].
    """

    position: float
    angle: float

    def __repr__(self) -> str:
        return f"{to_mm(self.position):.2f} mm, {to_deg(self.angle):.2f} deg"


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class PlanReport(Brief):
    """Figures on how a plan was made.

    Attributes:
        stages_ms: Wall time of each stage that ran, and ``"total"`` [ms].
        straight: Whether the motion is one straight line in joint space.
        departure: Whether the start had to be left slowly first, see ``start_recovery.py``.
        blind: Whether how deep it was in contact is not known: the way out may lead deeper.
        effort: Largest share of a servo's torque limit that is used; 0 if not checked.
        short_of_drive: Why it is slower than its caps, if its servos lack drive; else empty.
        waits: How long the arm waits for others before it moves [s]; part of the motion.
        waits_for: The names of the arms it waits for, or goes around.
        clearance: Distance of the closest bodies at the goal [m].
        closest: The names of these two bodies.
        path_deviation: Deviation from a line or path of the tool; None without one.
        routes: How many routes were compared; 0 if a straight or prescribed one was taken.
        out_of_time: Whether the time budget ended that, so that the motion may be another next
            time.
    """

    stages_ms: Mapping[str, float] = field(repr=False)
    straight: bool
    departure: bool
    clearance: float
    closest: tuple[str, str]
    path_deviation: PathDeviation | None = None
    effort: float = 0.0
    short_of_drive: str = ""
    waits: float = 0.0
    waits_for: tuple[str, ...] = ()
    blind: bool = False
    routes: int = 0
    out_of_time: bool = False

    @property
    def for_others(self) -> str:
        """What the arm does for others, in words: it waits or goes around; empty if nothing."""
        names = " and ".join(self.waits_for)
        if self.waits:
            return f"waits {self.waits:.2f} s for {names}"
        return names and f"goes around {names}"


@dataclass(frozen=True, slots=True, weakref_slot=True, kw_only=True, eq=False, repr=False)
class Plan(Public):
    """A verified motion with its path, limits and report.

    Attributes:
        q_start: Joint angles at its start, shape (5,), [rad].
        q_goal: Joint angles at its end, shape (5,), [rad].
        trajectory: The motion.
        path: Joint waypoints, shape (m, 5), [rad]; the lines between them are free. The motion
            follows them, or takes cuts where these are free as well.
        tool_path: Points of the tool's path in the base frame, shape (k, 3), [m].
        limits: The caps it keeps.
        report: Figures on how it was made.
    """

    q_start: Array
    q_goal: Array
    trajectory: Trajectory
    path: Array
    tool_path: Array
    limits: MotionLimits
    report: PlanReport

    def __post_init__(self) -> None:
        freeze(self, q_start=(5,), q_goal=(5,), path=(-1, 5), tool_path=(-1, 3))

    @property
    def duration(self) -> float:
        """How long the motion takes [s]."""
        return self.trajectory.duration

    def __str__(self) -> str:
        from so101_motion.planning.plan_summary import in_words

        return in_words(self)

    def __repr__(self) -> str:
        return f"<Plan of {self.duration:.2f} s; print it for more>"

    def _repr_html_(self) -> str:  # IPython's name
        from so101_motion.planning.plan_summary import as_html

        return as_html(self)
