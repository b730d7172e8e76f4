"""What can be asked of the planner, as plain values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from numpy.typing import ArrayLike

from so101_motion.geometry import SE3, Array, frozen_array


class GoalMetric(Enum):
    """How much of a target pose counts. Five joints cannot reach every orientation."""

    POSITION_ONLY = "position_only"
    """The point counts; the arm takes the posture nearest to where it is, keeping its roll."""
    POSITION_AND_APPROACH = "position_and_approach"
    """The point and the direction of the tool's z axis count; roll about it is free."""
    FULL_POSE = "full_pose"
    """Everything counts; refused with the nearest pose where five joints cannot."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseGoal:
    """Bring a frame of the gripper to a pose, along any free way.

    Attributes:
        T_base_tool: Where ``frame`` shall be, in the base frame.
        metric: How much of the pose counts.
        frame: ``"tool"`` or ``"jaw_tip"``.
        position_tolerance: Largest position error that counts as arrived [m].
        approach_tolerance: Largest angle between wanted and reached approach axis [rad]; for
            ``FULL_POSE`` the largest rotation error.
    """

    T_base_tool: SE3
    metric: GoalMetric = GoalMetric.POSITION_ONLY
    frame: str = "tool"
    position_tolerance: float = 1e-4
    approach_tolerance: float = math.radians(1.0)

    @classmethod
    def at_point(cls, p_base: ArrayLike, *, frame: str = "tool") -> PoseGoal:
        """Bring ``frame`` to a point, shape (3,), [m] in the base frame, however it is turned."""
        return cls(T_base_tool=SE3.from_translation(p_base), frame=frame)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointGoal:
    """Bring the joints to ``q``, shape (5,), [rad], along any free way."""

    q: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", frozen_array(self.q, (5,)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathGoal:
    """Follow joint waypoints without stopping at each; the way itself is given, not chosen.

    Attributes:
        waypoints: Shape (n, 5), n >= 1, [rad], not including the start.
        tolerance: How far, per joint, the motion may cut a corner [rad].
    """

    waypoints: Array
    tolerance: float = math.radians(2.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "waypoints", frozen_array(self.waypoints, (-1, 5)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LineGoal:
    """Move the tool point along a straight line to a pose.

    Attributes:
        T_base_tool: The end of the line; as much of it counts as ``metric`` says.
        metric: How much of the pose counts along the way and at the end.
        frame: ``"tool"`` or ``"jaw_tip"``.
        tolerance: How far the tool point may leave the line [m].
    """

    T_base_tool: SE3
    metric: GoalMetric = GoalMetric.POSITION_ONLY
    frame: str = "tool"
    tolerance: float = 1e-4


Goal = PoseGoal | JointGoal | PathGoal | LineGoal
