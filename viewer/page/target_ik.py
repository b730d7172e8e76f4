"""Inverse kinematics for the ghost while the target is dragged, by the planner's rule."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from so101_motion.common.errors import OutsideLimits, Unreachable
from so101_motion.common.geometry import SE3, Array, freeze
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import range_deg, to_deg, to_mm, to_rad
from so101_motion.planning.collision.collision import Clearance, CollisionModel
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.goals import GoalMetric, JointGoal, PoseGoal
from so101_motion.planning.kinematics.ik import IkSolver
from so101_motion.planning.kinematics.model import RobotModel

FRAMES = ("jaw_tip", "tool")
"""What can be brought to a target: the tip of the fixed jaw, or the tool frame."""

_FIRST_OFFSETS = tuple(
    np.array([x, y, z])
    for z in (-0.10, 0.05)
    for x, y in ((-0.08, -0.16), (-0.08, 0.16), (0.05, 0.05), (-0.12, 0.0))
)
"""Where to look for a first target, seen from the tool [m]; chosen: aside, nearer and lower."""

DIRECTION_TOLERANCE = to_rad(3.0)
"""How far the gripper may be turned off a wanted direction [rad]; chosen: with five joints a point
and a direction seldom go together to the last digit."""

_TRIES = 3
"""How often the turn of the base is guessed anew for a direction; chosen: the first does nearly
always, for the jaw's tip stands 20 mm beside the arm's plane."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Direction:
    """Where the gripper shall point, in the plane in which the arm stands."""

    tilt: float  # how far up it points [rad]: 0 level, -pi/2 straight down
    # how far it is turned about that direction [rad], as wrist_roll; None if that is free
    roll: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Target:
    """A target, and the joint angles that reach it or not."""

    goal: PoseGoal | JointGoal
    frame: str  # the frame that shall be at the target point, one of FRAMES
    p_base: Array  # the target point in the base frame, shape (3,), [m]
    q: Array  # joint angles of the ghost, shape (5,), [rad]: at the target, or as near as it gets
    problem: str | None  # why the target cannot be had, as a sentence; None when it can
    direction: Direction | None = None  # where the gripper shall point; None where that is free

    def __post_init__(self) -> None:
        freeze(self, p_base=(3,), q=(5,))


class TargetSolver:
    """Solves targets by inverse kinematics, in a scene and a joint range, shapes (5,), [rad].

    Belongs to one thread.
    """

    def __init__(self, scene: Scene, limits: tuple[Array, Array]) -> None:
        self._model = RobotModel.load().narrowed(*limits)
        self._collisions = CollisionModel(self._model, scene)
        self._ik = IkSolver(self._model)

    def point(self, q: Array, frame: str) -> Array:
        """Where a frame is for joint angles (5,); shape (3,), [m]."""
        return self._model.frame(q, frame).p

    def clearance(self, q: Array, q_jaw: float) -> Clearance:
        """How close bodies are for joint angles (5,) and jaw angle [rad]."""
        return self._collisions.clearance(q, q_jaw)

    def direction(self, q: Array) -> Direction:
        up = self._model.frame(q, "tool").R[2, 2]
        return Direction(tilt=float(np.arcsin(np.clip(up, -1.0, 1.0))), roll=float(q[4]))

    def turned(self, direction: Direction, pan: float, frame: str) -> Array:
        """How ``frame`` is turned while the gripper points there with the base at ``pan`` [rad]."""
        # With upper arm and forearm at zero the wrist alone tilts the gripper, down from level.
        q = np.array([pan, 0.0, 0.0, -direction.tilt, direction.roll or 0.0])
        return self._model.frame(q, frame).R

    def at_point(
        self,
        p_base: Array,
        frame: str,
        *,
        q_seed: Array,
        q_jaw: float,
        direction: Direction | None = None,
    ) -> Target:
        """The target that brings ``frame`` to a point, shape (3,), [m], in the base frame.

        The ghost stays as near to ``q_seed``, shape (5,), [rad], as it can.
        """
        target = self._solved(
            PoseGoal(T_base_tool=SE3.from_translation(p_base), frame=frame), q_seed, q_jaw
        )
        if direction is None:
            return target
        for _ in range(_TRIES):
            R_base_tool = self.turned(direction, float(target.q[0]), frame)
            free = direction.roll is None
            goal = PoseGoal(
                T_base_tool=SE3(R_base_tool, p_base),
                metric=GoalMetric.POSITION_AND_APPROACH if free else GoalMetric.FULL_POSE,
                frame=frame,
                approach_tolerance=DIRECTION_TOLERANCE,
            )
            target = replace(self._solved(goal, q_seed, q_jaw), direction=direction)
            if target.problem is None:
                break
        return target

    def _solved(self, goal: PoseGoal, q_seed: Array, q_jaw: float) -> Target:
        def found(q: Array, problem: str | None) -> Target:
            p_base = goal.T_base_tool.p
            return Target(goal=goal, frame=goal.frame, p_base=p_base, q=q, problem=problem)

        touching = []  # there is one at least
        try:
            for solution in self._ik.candidates(goal, q_seed):
                contact = self._collisions.first_contact(solution.q, q_jaw)
                if contact is None:
                    return found(solution.q, None)
                touching.append((solution.q, contact))
        except Unreachable as error:
            return found(error.q_nearest, _out_of_reach(error))
        q, contact = touching[0]
        return found(q, _collides(contact))

    def at_joints(self, q: Array, frame: str, *, q_jaw: float) -> Target:
        """The target at joint angles, shape (5,), [rad], with the jaw at ``q_jaw`` [rad]."""
        return Target(
            goal=JointGoal(q=q),
            frame=frame,
            p_base=self.point(q, frame),
            q=q,
            problem=self._problem(q, q_jaw),
        )

    def first_target(self, q: Array, *, q_jaw: float) -> Target:
        p_now = self.point(q, FRAMES[0])
        for offset in _FIRST_OFFSETS:
            target = self.at_point(p_now + offset, FRAMES[0], q_seed=q, q_jaw=q_jaw)
            if target.problem is None:
                return target
        return self.at_joints(q, FRAMES[0], q_jaw=q_jaw)

    def is_in_contact(self, q: Array, q_jaw: float) -> bool:
        """Whether the arm touches itself or something at joint angles (5,) and jaw angle [rad]."""
        return self._collisions.first_contact(q, q_jaw) is not None

    def _problem(self, q: Array, q_jaw: float) -> str | None:
        try:
            self._model.check_limits(q)
        except OutsideLimits as error:
            return _beyond(error)
        contact = self._collisions.first_contact(q, q_jaw)
        return None if contact is None else _collides(contact)


def _out_of_reach(error: Unreachable) -> str:
    limit = "arm fully stretched" if error.limit == "full stretch" else error.limit
    why = f" ({limit})" if limit else ""
    if error.error_position < 0.001 and error.error_angle > DIRECTION_TOLERANCE:
        return f"The gripper cannot point there: {to_deg(error.error_angle):.0f}° off."
    return f"{max(to_mm(error.error_position), 1.0):.0f} mm out of reach{why}."


def _beyond(error: OutsideLimits) -> str:
    assert error.joint in ARM_JOINTS
    value, between = to_deg(error.value), range_deg(error.lower, error.upper)
    return f"{error.joint} would be at {value:.2f}°; its range is {between}°."


def _collides(pair: tuple[str, str]) -> str:
    first, second = map(Scene().called, pair)
    return f"Target: {first} would hit {second}."
