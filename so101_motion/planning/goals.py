"""Goals that the planner accepts, as plain values."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.attributes import ABOVE_ZERO, checked_kind, checked_number
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import (
    FARTHEST,
    SE3,
    Array,
    Brief,
    in_metres,
    in_radians,
    joint_angles,
    point,
    pose,
)

FARTHEST_LINE = 5.0
"""Lines that end farther from the base are refused [m]: 30 m take 20 s to search; chosen. Other
goals: ``FARTHEST``. For nearer ones out of reach, the error names the nearest reachable point."""


def _check(goal: Any, most: float, *tolerances: str) -> None:
    """Check a goal: the matrix of a pose becomes an ``SE3``, the name of a metric the metric.

    The first of ``tolerances`` is a length, the second an angle.
    """
    object.__setattr__(goal, "T_base_tool", pose("T_base_tool", goal.T_base_tool, most))
    if tolerances:
        object.__setattr__(goal, "metric", as_metric(goal.metric))
        _check_tolerances(goal, *tolerances)


def _check_tolerances(goal: Any, length: str, angle: str) -> None:
    given = [checked_number(key, getattr(goal, key), lower=ABOVE_ZERO) for key in (length, angle)]
    if given[0] > 1.0 or given[1] > math.pi:  # cheap, for goals are made in inner loops
        in_metres(length, np.array(given[0]), 1.0)
        in_radians(angle, np.array(given[1]), math.pi)


class GoalMetric(Enum):
    """How much of a target pose is asked for. Five joints cannot reach every orientation.

    Attributes:
        POSITION_ONLY: The point; the arm takes the configuration nearest to its present one and
            keeps its roll.
        POSITION_AND_APPROACH: The point and the direction of the tool's z axis; roll is free.
        FULL_POSE: Everything; if five joints cannot reach it, the error names the nearest pose.
    """

    POSITION_ONLY = "position_only"
    POSITION_AND_APPROACH = "position_and_approach"
    FULL_POSE = "full_pose"


def as_metric(given: GoalMetric | str) -> GoalMetric:
    """The metric itself, or the one of that name.

    Raises:
        ConfigError: There is none of that name.
    """
    try:
        return GoalMetric(given)
    except ValueError:
        names = ", ".join(metric.value for metric in GoalMetric)
        raise ConfigError("metric", given, f"must be one of {names}") from None


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class PoseCloud(Brief):
    """Tolerances around a pose: every pose within them is as good as the pose itself.

    All are tolerances of ``T_goal_reached``, the same to either side. With orientation tolerances
    1, 1, 2 and pi, the largest possible, the orientation does not count.

    Attributes:
        x: Along the goal's x axis [m].
        y: Along its y axis [m].
        z: Along its z axis [m].
        o_x: How far the x component of the reached z axis, a unit vector, may be from 0.
        o_y: The same for its y component.
        o_z: How far its z component may be from 1.
        theta: How far the reached pose may be turned about that axis [rad].
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    o_x: float = 0.0
    o_y: float = 0.0
    o_z: float = 0.0
    theta: float = 0.0

    def __post_init__(self) -> None:
        for key in ("x", "y", "z", "o_x", "o_y", "o_z", "theta"):
            checked_number(key, getattr(self, key), lower=0.0)

    @property
    def metric(self) -> GoalMetric:
        """How much of the pose counts: parts with the largest tolerance do not."""
        if self.theta < math.pi:
            return GoalMetric.FULL_POSE
        if self.o_x < 1.0 or self.o_y < 1.0 or self.o_z < 2.0:
            return GoalMetric.POSITION_AND_APPROACH
        return GoalMetric.POSITION_ONLY


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PoseGoal(Brief):
    """Bring a frame of the gripper to a pose, along any free path.

    Attributes:
        T_base_tool: Goal pose of ``frame`` in the base frame.
        metric: How much of the pose counts.
        frame: ``"tool"``, ``"jaw_tip"``, or a frame of the arm's tool, such as ``"tcp"``.
        position_tolerance: Largest position error that counts as arrived [m].
        approach_tolerance: Largest angle between wanted and reached approach axis [rad]; for
            ``FULL_POSE`` the largest rotation error.
        cloud: Tolerances that replace ``metric`` and both tolerances above; None to use those.
    """

    T_base_tool: SE3
    metric: GoalMetric = GoalMetric.POSITION_ONLY
    frame: str = "tool"
    position_tolerance: float = 1e-4
    approach_tolerance: float = math.radians(1.0)
    cloud: PoseCloud | None = None

    def __post_init__(self) -> None:
        _check(self, FARTHEST, "position_tolerance", "approach_tolerance")

    @classmethod
    def at_point(cls, p_base: ArrayLike, *, frame: str = "tool") -> PoseGoal:
        """Bring ``frame`` to a point, shape (3,), [m] in the base frame, in any orientation."""
        return cls(T_base_tool=SE3.from_translation(point("goal", p_base)), frame=frame)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class JointGoal(Brief):
    """Bring the joints to given angles, along any free path.

    Attributes:
        q: The angles, shape (5,), [rad].
    """

    q: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", joint_angles("q", self.q))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PathGoal(Brief):
    """Follow given joint waypoints without stopping at each.

    Attributes:
        waypoints: Shape (n, 5), n >= 1, [rad], not including the start.
        tolerance: How far, per joint, the motion may cut a corner [rad].
    """

    waypoints: Array
    tolerance: float = math.radians(2.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "waypoints", joint_angles("waypoints", self.waypoints, (-1, 5)))
        checked_number("tolerance", self.tolerance, lower=0.0, upper=math.pi, unit="rad")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class LineGoal(Brief):
    """Move the tool point along a straight line to a pose.

    Attributes:
        T_base_tool: The end of the line.
        metric: How much of the pose counts along the path and at the end. The orientation, as far
            as it counts, turns steadily from the start's to the goal's.
        frame: ``"tool"``, ``"jaw_tip"``, or a frame of the arm's tool, such as ``"tcp"``.
        tolerance: How far the tool point may leave the line [m].
        orientation_tolerance: Largest deviation of the orientation anywhere on the line [rad]: of
            the approach axis, or for ``FULL_POSE`` of the whole orientation. It is kept as small as
            five joints can; the plan's report has the rest.
    """

    T_base_tool: SE3
    metric: GoalMetric = GoalMetric.POSITION_ONLY
    frame: str = "tool"
    tolerance: float = 1e-4
    orientation_tolerance: float = math.radians(5.0)

    def __post_init__(self) -> None:
        _check(self, FARTHEST_LINE, "tolerance", "orientation_tolerance")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class LineTo(Brief):
    """A straight segment of a tool path.

    Attributes:
        T_base_tool: Where it ends.
    """

    T_base_tool: SE3

    def __post_init__(self) -> None:
        _check(self, FARTHEST)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ArcTo(Brief):
    """A circular segment of a tool path, to a pose.

    Attributes:
        T_base_tool: Its end.
        p_via: A point it passes in between, shape (3,), [m].
    """

    T_base_tool: SE3
    p_via: Array

    def __post_init__(self) -> None:
        _check(self, FARTHEST)
        object.__setattr__(self, "p_via", point("p_via", self.p_via))


_SEGMENTS = "LineTo and ArcTo, at least one"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ToolPathGoal(Brief):
    """Move the tool point along lines and arcs, without a stop at rounded corners.

    Attributes:
        segments: The lines and arcs, each from the end of the one before.
        blend: Distance from each corner within which it is rounded [m], at most half a segment. 0
            for sharp corners, at which the arm stops.
        metric: As for :class:`LineGoal`.
        frame: ``"tool"``, ``"jaw_tip"``, or a frame of the arm's tool, such as ``"tcp"``.
        tolerance: How far the tool point may leave the rounded path [m].
        orientation_tolerance: As for :class:`LineGoal`.
    """

    segments: tuple[LineTo | ArcTo, ...]
    blend: float = 0.0
    metric: GoalMetric = GoalMetric.POSITION_ONLY
    frame: str = "tool"
    tolerance: float = 1e-4
    orientation_tolerance: float = math.radians(5.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "metric", as_metric(self.metric))
        segments = tuple(checked_kind("segments", self.segments, list | tuple, _SEGMENTS))
        for each in segments or [None]:
            checked_kind("segments", each, LineTo | ArcTo, _SEGMENTS)
        object.__setattr__(self, "segments", segments)
        in_metres("blend", np.array(checked_number("blend", self.blend, lower=0.0)), 1.0)
        _check_tolerances(self, "tolerance", "orientation_tolerance")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ApproachGoal(Brief):
    """Approach a pose along a straight line, after any free path to the start of the line.

    The configuration above the pose is chosen among those from which the line can be followed. Use
    a :class:`LineGoal` to leave again.

    Attributes:
        T_base_tool: Goal pose of ``frame``.
        hover: Start of the line relative to the goal, shape (3,), in the base frame [m].
        metric: How much of the pose counts, at the beginning, along the line and at the end.
        frame: ``"tool"``, ``"jaw_tip"``, or a frame of the arm's tool, such as ``"tcp"``.
        approach_tolerance: How far the tool may be turned off at the start of the line [rad].
        tolerance: How far the tool point may leave the line [m].
        orientation_tolerance: How far the tool may be turned off along it [rad].
    """

    T_base_tool: SE3
    hover: Array = field(default_factory=lambda: np.array([0.0, 0.0, 0.04]))
    metric: GoalMetric = GoalMetric.POSITION_AND_APPROACH
    frame: str = "tool"
    approach_tolerance: float = math.radians(1.0)
    tolerance: float = 1e-4
    orientation_tolerance: float = math.radians(5.0)

    def __post_init__(self) -> None:
        _check(self, FARTHEST_LINE, "tolerance", "orientation_tolerance")
        object.__setattr__(self, "hover", point("hover", self.hover, 1.0))

    @property
    def above(self) -> PoseGoal:
        """The start of the line, as a goal."""
        return PoseGoal(
            T_base_tool=SE3(self.T_base_tool.R, self.T_base_tool.p + self.hover),
            metric=self.metric,
            frame=self.frame,
            approach_tolerance=self.approach_tolerance,
        )

    @property
    def line(self) -> LineGoal:
        """The line, as a goal."""
        return LineGoal(
            T_base_tool=self.T_base_tool,
            metric=self.metric,
            frame=self.frame,
            tolerance=self.tolerance,
            orientation_tolerance=self.orientation_tolerance,
        )


ToolGoal = LineGoal | ToolPathGoal  # goals that prescribe the path of the tool


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class LeaveContactGoal(Brief):
    """Leave contact by a slow straight joint motion, and stop as soon as the arm is free.

    For an arm below the modelled table, or inside an obstacle that is not really there. Every other
    goal is refused if more than a small motion is needed to get free, or the arm is in a surface of
    which the inside is not known; the way out of that may lead deeper.

    Attributes:
        farthest: Longest motion of any point of the arm [m].
    """

    farthest: float = 1.0

    def __post_init__(self) -> None:
        checked_number("farthest", self.farthest, lower=ABOVE_ZERO, upper=2.0, unit="m")


Goal = PoseGoal | JointGoal | PathGoal | ToolGoal | ApproachGoal | LeaveContactGoal
