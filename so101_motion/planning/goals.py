"""Goals that the planner accepts, as plain values."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import SE3, Array, frozen_array

FARTHEST = 1_000.0
"""Goals farther from the base are not meant [m]; chosen. Nearer ones are answered with the nearest
point in reach."""

FARTHEST_LINE = 5.0
"""The same for where a line ends [m]: 30 m take 20 s to look along. Chosen, ten times the reach."""


def _refuse_far(T_base_tool: SE3, most: float) -> None:
    p = T_base_tool.p
    if np.isfinite(p).all() and np.abs(p).max() > most:  # what is no number is the planner's
        given = [round(float(x), 3) for x in p]
        raise ConfigError("goal", given, f"must be within {most:g} m of the base; is it in metres?")


class GoalMetric(Enum):
    """How much of a target pose counts. Five joints cannot reach every orientation."""

    POSITION_ONLY = "position_only"
    """The point counts; the arm takes the configuration nearest to where it is, keeping its
    roll."""
    POSITION_AND_APPROACH = "position_and_approach"
    """The point and the direction of the tool's z axis count; roll about it is free."""
    FULL_POSE = "full_pose"
    """Everything counts; refused with the nearest pose where five joints cannot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseCloud:
    """Tolerances around a pose: every pose in the cloud is as good as the pose itself.

    All are about the pose seen from the goal, ``T_goal_reached``, and reach as far to either side.
    The largest possible orientation tolerances are 1, 1, 2 and pi: then it does not count.

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
            value = getattr(self, key)
            if not 0.0 <= value < math.inf:
                raise ConfigError(key, value, "a tolerance must be 0 or more and finite")

    @property
    def metric(self) -> GoalMetric:
        """How much of the pose counts: what the tolerances leave open altogether does not."""
        if self.theta < math.pi:
            return GoalMetric.FULL_POSE
        if self.o_x < 1.0 or self.o_y < 1.0 or self.o_z < 2.0:
            return GoalMetric.POSITION_AND_APPROACH
        return GoalMetric.POSITION_ONLY


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseGoal:
    """Bring a frame of the gripper to a pose, along any free path.

    Attributes:
        T_base_tool: Where ``frame`` shall be, in the base frame.
        metric: How much of the pose counts.
        frame: ``"tool"`` or ``"jaw_tip"``.
        position_tolerance: Largest position error that counts as arrived [m].
        approach_tolerance: Largest angle between wanted and reached approach axis [rad]; for
            ``FULL_POSE`` the largest rotation error.
        cloud: Poses that will do as well; it replaces ``metric`` and both tolerances.
    """

    T_base_tool: SE3
    metric: GoalMetric = GoalMetric.POSITION_ONLY
    frame: str = "tool"
    position_tolerance: float = 1e-4
    approach_tolerance: float = math.radians(1.0)
    cloud: PoseCloud | None = None

    def __post_init__(self) -> None:
        _refuse_far(self.T_base_tool, FARTHEST)

    @classmethod
    def at_point(cls, p_base: ArrayLike, *, frame: str = "tool") -> PoseGoal:
        """Bring ``frame`` to a point, shape (3,), [m] in the base frame, however it is turned."""
        return cls(T_base_tool=SE3.from_translation(p_base), frame=frame)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointGoal:
    """Bring the joints to ``q``, shape (5,), [rad], along any free path."""

    q: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", frozen_array(self.q, (5,)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathGoal:
    """Follow joint waypoints without stopping at each; the path itself is given, not chosen.

    Attributes:
        waypoints: Shape (n, 5), n >= 1, [rad], not including the start.
        tolerance: How far, per joint, the motion may cut a corner [rad].
    """

    waypoints: Array
    tolerance: float = math.radians(2.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "waypoints", frozen_array(self.waypoints, (-1, 5)))
        if not 0.0 <= self.tolerance < math.inf:
            raise ConfigError("tolerance", self.tolerance, "must be 0 or more and finite [rad]")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LineGoal:
    """Move the tool point along a straight line to a pose.

    Attributes:
        T_base_tool: The end of the line; as much of it counts as ``metric`` says.
        metric: How much of the pose counts along the path and at the end. What counts of the
            orientation turns steadily from the start's to the goal's.
        frame: ``"tool"`` or ``"jaw_tip"``.
        tolerance: How far the tool point may leave the line [m].
        orientation_tolerance: How far the tool may be turned from where it should be, anywhere on
            the line [rad]: its approach axis, or for ``FULL_POSE`` all of it. It is kept as near
            as five joints can; what they cannot is in the plan's report.
    """

    T_base_tool: SE3
    metric: GoalMetric = GoalMetric.POSITION_ONLY
    frame: str = "tool"
    tolerance: float = 1e-4
    orientation_tolerance: float = math.radians(5.0)

    def __post_init__(self) -> None:
        _refuse_far(self.T_base_tool, FARTHEST_LINE)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LineTo:
    """A straight segment of a tool path, to a pose."""

    T_base_tool: SE3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArcTo:
    """A circular segment of a tool path, to a pose.

    Attributes:
        T_base_tool: Where it ends.
        p_via: A point it passes on the way, shape (3,), [m].
    """

    T_base_tool: SE3
    p_via: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "p_via", frozen_array(self.p_via, (3,)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolPathGoal:
    """Move the tool point along lines and arcs, without stopping where the corners are rounded.

    Attributes:
        segments: The lines and arcs, each from where the one before ends.
        blend: How far from each corner the tool may leave the segments, to round it [m]; half a
            segment where that is less. 0 for sharp corners, at which the arm stops.
        metric: As for :class:`LineGoal`.
        frame: ``"tool"`` or ``"jaw_tip"``.
        tolerance: How far the tool point may leave the path [m], rounded as it is.
        orientation_tolerance: As for :class:`LineGoal`.
    """

    segments: tuple[LineTo | ArcTo, ...]
    blend: float = 0.0
    metric: GoalMetric = GoalMetric.POSITION_ONLY
    frame: str = "tool"
    tolerance: float = 1e-4
    orientation_tolerance: float = math.radians(5.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ApproachGoal:
    """Approach a pose along a straight line, after any free path to where the line begins.

    The configuration above the pose is chosen among those from which the line can be followed.
    Leaving again is a :class:`LineGoal`.

    Attributes:
        T_base_tool: Where ``frame`` shall be in the end.
        hover: Where the line begins, seen from there, shape (3,), in the base frame [m].
        metric: How much of the pose counts, at the beginning, along the line and at the end.
        frame: ``"tool"`` or ``"jaw_tip"``.
        approach_tolerance: How far the tool may be turned off where the line begins [rad].
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
        object.__setattr__(self, "hover", frozen_array(self.hover, (3,)))
        _refuse_far(self.T_base_tool, FARTHEST_LINE)

    @property
    def above(self) -> PoseGoal:
        """Where the line begins, as a goal."""
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


ToolGoal = LineGoal | ToolPathGoal
"""Goals that prescribe the path of the tool."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaveContactGoal:
    """Leave contact by a slow straight joint motion, and stop as soon as the arm is free.

    For an arm that hangs below its table or in an obstacle that is not there. Every other goal is
    refused if more than a small motion is needed to get free.

    Attributes:
        farthest: Longest motion of any point of the arm [m].
    """

    farthest: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 < self.farthest <= 2.0:
            raise ConfigError("farthest", self.farthest, "must be more than 0 and at most 2 m")


Goal = PoseGoal | JointGoal | PathGoal | ToolGoal | ApproachGoal | LeaveContactGoal
