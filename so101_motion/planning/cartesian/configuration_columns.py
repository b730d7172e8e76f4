"""Compute the possible configurations at points of a tool path: the columns of the ladder graph.

At each point the position is prescribed; five joints leave two freedoms, pitch and roll, and up to
four branches. How much of them counts depends on the goal's metric:

* *Position only*: every pitch all round, with the roll the arm has. The roll moves a frame by its
  distance from the roll axis at most, and of 134 random lines none existed for another roll only.
* *Position and approach*: pitches around the one that brings the approach nearest to where it
  should point. The roll is the arm's own; a second, finer look tries others, because turning the
  tool, which is beside the roll axis, lets the arm's plane face a few degrees to either side.
* *Full pose*: pitches around the same, each with the roll that then comes nearest.

Where upper arm and forearm are in line the elbow may turn over from up to down. The two pitches at
which that is so are among those of a position-only column, however coarse it is: lines past such a
point could not be followed otherwise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.geometry import Array
from so101_motion.planning.goals import GoalMetric
from so101_motion.planning.kinematics.arm_geometry import ArmStructure
from so101_motion.planning.kinematics.batch_ik import (
    angles_between,
    configurations,
    facing,
    facing_turned,
    hands,
    pitch_towards,
    roll_for,
    rotation_angles,
    straight_pitches,
)
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.kinematics.planar_3r import JOINT_SLACK, TAU

ROOM = 0.05
"""Closer to a joint limit or a straight arm than this, configurations cost more [rad]. Chosen: 3
deg."""

OF_LIMIT = 0.3
"""Price of being at one of these all the way, against 1 for a radian of pitch. Chosen."""

OF_DEVIATION = 10.0
"""Price of being turned off by the whole tolerance all the way. Chosen: as near as joints can."""


class Allowed(NamedTuple):
    """Allowed configurations of one point; as in :class:`Columns`, without the first axis."""

    q: Array
    price: Array
    in_front: NDArray[np.bool_]


class Columns(NamedTuple):
    """Configurations for each point of a path, and what each costs.

    Attributes:
        q: Joint angles, shape (n, k, 5), [rad]; beyond the limits too.
        price: Of a path all of such configurations, shape (n, k); infinite where one is not
            allowed.
        excess: How far beyond its limits the joint is that is furthest off, shape (n, k), [rad];
            infinite where the point is out of reach like this.
        deviation: How far the tool is turned off, shape (n, k), [rad]; 0 where it does not count.
        in_front: Whether the arm faces the point, shape (n, k), or leans over backwards to it.
    """

    q: Array
    price: Array
    excess: Array
    deviation: Array
    in_front: NDArray[np.bool_]

    def at(self, i: int) -> Columns:
        """One of the points, as n = 1."""
        one = slice(i, i + 1)
        return Columns(
            self.q[one],
            self.price[one],
            self.excess[one],
            self.deviation[one],
            self.in_front[one],
        )

    def allowed(self) -> list[Allowed]:
        """For each point what is allowed there."""
        return [
            Allowed(self.q[i, each], self.price[i, each], self.in_front[i, each])
            for i, each in enumerate(np.isfinite(self.price))
        ]


class Resolution(NamedTuple):
    """How closely to look.

    Attributes:
        spacing: Distance between points [m].
        pitch_step: Distance between pitches where all are allowed [rad].
        offsets: How many pitches within a tolerance.
        rolls: How many rolls where it is free or, within a tolerance, how many of those.
    """

    spacing: float
    pitch_step: float
    offsets: int
    rolls: int


class Criteria(NamedTuple):
    """What counts along a path.

    Attributes:
        metric: How much of the pose.
        frame: Which frame of the gripper follows the path.
        orientation_tolerance: [rad].
        roll: The roll to keep where it is free [rad].
        pitch: The pitch that is among those tried [rad].
    """

    metric: GoalMetric
    frame: str
    orientation_tolerance: float
    roll: float
    pitch: float


class ConfigurationSource:
    """Lays out columns of configurations for one arm."""

    def __init__(self, structure: ArmStructure, chain: ArmChain) -> None:
        self._structure, self._chain = structure, chain

    def columns(
        self, criteria: Criteria, p_base: Array, R_base_tool: Array, resolution: Resolution
    ) -> Columns:
        """Configurations for points (n, 3) [m] with the *tool* turned as ``R_base_tool``."""
        if criteria.metric is GoalMetric.POSITION_ONLY:
            q, excess = self._any_pitch(criteria, p_base, resolution)
            deviation = np.zeros_like(excess)
        elif criteria.metric is GoalMetric.POSITION_AND_APPROACH:
            q, excess = self._approaching(criteria, p_base, R_base_tool[:, :, 2], resolution)
            reached = self._rotations(q)[..., 2]
            deviation = angles_between(reached, R_base_tool[:, None, :, 2])
        else:
            q, excess = self._turned(criteria, p_base, R_base_tool, resolution)
            left = self._rotations(q).transpose(0, 1, 3, 2) @ R_base_tool[:, None]
            deviation = rotation_angles(left)
        allowed = (excess <= JOINT_SLACK) & (deviation <= criteria.orientation_tolerance)
        straight = np.abs(q[..., 2] - self._structure.bars.straight)
        near = np.maximum(1.0 - np.minimum(-excess, straight) / ROOM, 0.0)
        price = (
            OF_LIMIT * near**2 + OF_DEVIATION * (deviation / criteria.orientation_tolerance) ** 2
        )
        price = np.where(allowed, price, np.inf)
        return Columns(q, price, excess, deviation, self.in_front(q, p_base[:, None]))

    def in_front(self, q: Array, p_base: Array) -> NDArray[np.bool_]:
        """Whether the arm faces the points (..., 3) [m] that ``q`` (..., 5) [rad] reaches."""
        m = self._structure.measures
        azimuth = m.azimuth + m.pan_sign * q[..., 0]
        x, y = p_base[..., 0] - m.pan[0], p_base[..., 1] - m.pan[1]
        return np.asarray(x * np.cos(azimuth) + y * np.sin(azimuth) >= 0.0)

    def _any_pitch(
        self, criteria: Criteria, p_base: Array, resolution: Resolution
    ) -> tuple[Array, Array]:
        roll = np.array([[[criteria.roll]]])
        hand = hands(self._structure, criteria.frame, roll)
        target = facing(self._structure, p_base, hand.lateral)
        count = round(TAU / resolution.pitch_step)
        even = criteria.pitch + np.arange(count) * (TAU / count)
        straight = straight_pitches(self._structure, target, hand)
        pitch = np.concatenate(
            [np.broadcast_to(even, (*straight.shape[:2], count)), straight], axis=2
        )
        grid = configurations(self._structure, target, hand, pitch, roll)
        excess = np.where(np.isnan(grid.excess), np.inf, grid.excess)
        excess[:, :, count:, 1] = np.inf  # straight is neither up nor down; once is enough
        return _flat(np.where(np.isfinite(grid.q), grid.q, 0.0)), _flat(excess[..., None])[..., 0]

    def _approaching(
        self, criteria: Criteria, p_base: Array, axis: Array, resolution: Resolution
    ) -> tuple[Array, Array]:
        m = self._structure.measures
        rolls = np.append(criteria.roll, np.linspace(m.lower[4], m.upper[4], resolution.rolls))
        offsets = _offsets(criteria, resolution.offsets)
        found = []
        for roll in rolls[: 1 if resolution.rolls == 1 else None]:
            roll = np.array([[[roll]]])
            hand = hands(self._structure, criteria.frame, roll)
            target = facing(self._structure, p_base, hand.lateral)
            pitch = pitch_towards(self._structure, target.pan, axis) + offsets
            grid = configurations(self._structure, target, hand, pitch, roll)
            found.append((_flat(grid.q), _flat(grid.excess[..., None])))
        q, excess = (np.concatenate(parts, axis=1) for parts in zip(*found, strict=True))
        return q, excess[..., 0]

    def _turned(
        self, criteria: Criteria, p_base: Array, R_base_tool: Array, resolution: Resolution
    ) -> tuple[Array, Array]:
        structure = self._structure
        pitches = _offsets(criteria, resolution.offsets)
        rolls = _offsets(criteria, resolution.rolls) if resolution.rolls > 1 else np.zeros(1)
        pitch_offset, roll_offset = (each.ravel() for each in np.meshgrid(pitches, rolls))
        target, pitch = facing_turned(structure, criteria.frame, p_base, R_base_tool, criteria.roll)
        pitch = pitch + pitch_offset
        roll = roll_for(structure, target.pan, pitch, R_base_tool) + roll_offset
        hand = hands(structure, criteria.frame, roll)
        target = facing(structure, p_base, hand.lateral)
        grid = configurations(structure, target, hand, pitch, roll)
        return _flat(grid.q), _flat(grid.excess[..., None])[..., 0]

    def _rotations(self, q: Array) -> Array:
        return self._chain.rotations(q.reshape(-1, 5)).reshape(*q.shape[:2], 3, 3)


def _offsets(criteria: Criteria, count: int) -> Array:
    """Angles within the tolerance, an odd number of them, so that zero is among them [rad]."""
    within = 0.999 * min(criteria.orientation_tolerance, np.pi)
    return np.linspace(-within, within, count)


def _flat(values: Array) -> Array:
    """Points first, all configurations of a point in one row: shape (n, k, last)."""
    return values.reshape(len(values), -1, values.shape[-1])
