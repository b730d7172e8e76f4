"""The geometry of the arm: a pan, three parallel joints, and a roll.

The pan axis is vertical and turns a vertical plane; lift, elbow and wrist move within that plane;
the roll turns the gripper about an axis in it. So the *lateral* distance of a gripper frame (the
tool, the jaw tip) from the plane through the pan axis depends on the roll alone, and so does its
place relative to the wrist within the plane. For a given roll,

- the pan follows from the target's azimuth and the lateral distance, with two solutions: the arm
  faces the target (front), or reaches it over its back (back);
- the rest is a problem in the plane.

The closed forms are compiled (``native/arm_ik.c``, ``native/planar.c``), and for many poses at once
in ``batch_ik.py``. ``geometry_from_model.py`` takes the measures from the kinematic model.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, pi, remainder
from typing import NamedTuple

from so101_motion.common.geometry import Array

TAU = 2.0 * pi

JOINT_SLACK = 1e-6
"""Joint angles this far beyond a limit [rad] count as inside, and the caller clamps them: arccos
near a straight elbow loses that much. At full reach it moves the tool by half a micrometre.
Chosen."""

REACH_SLACK = 1e-5  # how far beyond it the straight arm is a solution [m]; chosen
_ON_AXIS = 1e-9  # a frame closer to the roll axis than this is on it [m]. Chosen: rounding is 1e-17
Joints = tuple[float, float, float, float, float]  # five joint angles [rad]
Point = tuple[float, float, float]  # a point in the base frame [m]


Angles = tuple[float, float, float]  # lift, elbow and wrist [rad]


class Bars(NamedTuple):
    """The three parallel joints, without the hand."""

    upper_arm: float  # shoulder to elbow [m]
    upper_arm_elevation: float  # its elevation when all joints are at zero [rad]
    forearm: float  # elbow to wrist [m]
    forearm_elevation: float  # its elevation when all joints are at zero [rad]
    lower: Angles  # smallest angles of lift, elbow, wrist [rad]
    upper: Angles  # largest angles of lift, elbow, wrist [rad]

    @property
    def straight(self) -> float:
        """The elbow angle at which upper arm and forearm are in line [rad]."""
        return self.forearm_elevation - self.upper_arm_elevation

    @property
    def constants(self) -> tuple[float, ...]:
        """Constants of the chain, in the order of ``arm_ik.h``."""
        a, b = self.upper_arm, self.forearm
        squares, twice, longest = a * a + b * b, 2.0 * a * b, (a + b + REACH_SLACK) ** 2
        # Distance from shoulder to wrist, squared, with the elbow as far down or up as it bends.
        shortest = (
            squares + twice * cos(self.straight - limit) for limit in (self.lower[1], self.upper[1])
        )
        slack, cos_max = longest - (a + b) ** 2, (longest - squares) / twice
        return (self.straight, squares, twice, slack, cos_max, *shortest)


class FrameOffset(NamedTuple):
    """Offset of a frame from the wrist at pitch zero, as a function of the roll.

    Forward, left and up are each a constant, a factor of the roll's cosine and a factor of its sine
    [m]. Left counts from the plane through the pan axis.
    """

    forward: tuple[float, float, float]
    left: tuple[float, float, float]
    up: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measures:
    """The dimensions of an arm with this structure."""

    pan: tuple[float, float]  # the pan axis, x and y in the base frame [m]
    pan_sign: float  # +1 if a positive pan turns left, -1 if it turns right
    azimuth: float  # azimuth of the arm's plane when the pan is at zero [rad]
    # the lift axis: forward of the pan axis, and up from the base [m]
    shoulder: tuple[float, float]
    bars: Bars  # the three parallel joints
    offsets: dict[str, FrameOffset]  # the gripper's frames by name
    approach_elevation: float  # elevation of the tool's z axis when the pitch is zero [rad]
    R_base_tool: Array  # the tool's rotation when all joints are at zero, shape (3, 3)
    # roll axis, lift axis and their cross product when all joints are at zero, as columns, shape
    # (3, 3)
    R_base_axes: Array
    lower: Joints  # smallest joint angles [rad]
    upper: Joints  # largest joint angles [rad]


class ArmStructure:
    """Closed forms for an arm of the given measures.

    Attributes:
        measures: The arm's measures.
        bars: Its three parallel joints.
        on_axis: Whether a frame's origin is on the roll axis, so that the roll does not move it.
        longest: Upper bound on the distance of a frame from the shoulder [m].
    """

    def __init__(self, measures: Measures) -> None:
        self.measures = measures
        self.bars = measures.bars
        self.on_axis = {
            name: all(hypot(*row[1:]) < _ON_AXIS for row in offset)
            for name, offset in measures.offsets.items()
        }
        links = measures.bars.upper_arm + measures.bars.forearm + REACH_SLACK
        self.longest = {
            name: links + hypot(*(abs(row[0]) + hypot(*row[1:]) for row in (each.forward, each.up)))
            for name, each in measures.offsets.items()
        }

    def clip_roll(self, roll: float) -> float:
        """A roll [rad] inside its limits: shifted by whole turns, else clamped."""
        lower, upper = self.measures.lower[4], self.measures.upper[4]
        if lower <= roll <= upper:
            return roll
        middle = 0.5 * (lower + upper)
        return min(max(middle + remainder(roll - middle, TAU), lower), upper)


def to_joints(q: Array) -> Joints:
    """Five plain numbers from an array of shape (5,), [rad]."""
    a, b, c, d, e = q.tolist()
    return a, b, c, d, e
