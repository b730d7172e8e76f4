"""Compute the possible configurations at points of a tool path: the columns of the ladder graph.

Each point prescribes the position; five joints leave pitch and roll free, and up to four branches.
The goal's metric decides which of these are tried:

* *Position only*: pitches of the whole circle, with the present roll. The roll moves a frame by its
  distance from the roll axis at most, and of 134 random lines none needed another roll.
* *Position and approach*: pitches around the one that points the approach best. The roll is the
  present one; a finer search tries others, because turning the tool, which is beside the roll axis,
  lets the arm's plane face a few degrees to either side.
* *Full pose*: pitches around the same, each with its best roll.

Where upper arm and forearm are in line, the elbow may change from up to down. A position-only
column always has the two pitches at which they are in line, however coarse it is: lines past such a
point could not be followed otherwise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.geometry import Array
from so101_motion.planning.goals import GoalMetric
from so101_motion.planning.kinematics.arm_geometry import JOINT_SLACK, TAU, ArmStructure
from so101_motion.planning.kinematics.batch_ik import (
    angles_between,
    configurations,
    configurations_at,
    facing,
    facing_turned,
    hands,
    pitch_towards,
    roll_for,
    rotation_angles,
    straight_pitches,
)
from so101_motion.planning.kinematics.batch_kinematics import ArmChain

ROOM = 0.05  # nearer to a limit or a straight arm costs more [rad]; chosen, 3 deg
OF_LIMIT = 0.3  # cost of a whole path at a joint limit, against 1 for a radian of pitch. Chosen
OF_DEVIATION = 10.0  # cost of a path turned off by the tolerance; chosen: deviations stay small


class Allowed(NamedTuple):
    """Allowed configurations of one point; the fields are those of :class:`Columns`."""

    q: Array
    price: Array
    in_front: NDArray[np.bool_]


class Columns(NamedTuple):
    """Configurations for each point of a path, and what each costs."""

    q: Array  # joint angles, shape (n, k, 5), [rad]; beyond the limits too
    # cost of a whole path of such configurations, shape (n, k); infinite where one is not allowed
    price: Array
    # largest distance of a joint beyond its limits, shape (n, k), [rad]; infinite where the point
    # is out of reach
    excess: Array
    # how far the tool is turned off, shape (n, k), [rad]; 0 where it does not count
    deviation: Array
    # whether the arm faces the point, shape (n, k), or reaches it over its back
    in_front: NDArray[np.bool_]

    def at(self, i: int) -> Columns:
        """One of the points, as n = 1."""
        return Columns._make(values[i : i + 1] for values in self)

    def allowed(self) -> list[Allowed]:
        """The allowed configurations of each point."""
        return [
            Allowed(self.q[i, each], self.price[i, each], self.in_front[i, each])
            for i, each in enumerate(np.isfinite(self.price))
        ]


class Resolution(NamedTuple):
    """The resolution of a search."""

    spacing: float  # distance between points [m]
    pitch_step: float  # distance between pitches where the pitch is free [rad]
    offsets: int  # number of pitches within a tolerance
    rolls: int  # number of rolls where the roll is free, or within a tolerance


class Criteria(NamedTuple):
    """The conditions on configurations along a path."""

    metric: GoalMetric  # which parts of the pose count
    frame: str  # which frame of the gripper follows the path
    orientation_tolerance: float  # largest deviation of the orientation [rad]
    roll: float  # the roll to keep where it is free [rad]
    pitch: float  # a pitch that must be among those tried [rad]


class ConfigurationSource:
    """Computes columns of configurations for one arm."""

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
            grid = configurations_at(
                self._structure, criteria.frame, p_base, np.array([[[roll]]]),
                lambda pan: pitch_towards(self._structure, pan, axis) + offsets,
            )  # fmt: skip
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
        grid = configurations_at(structure, criteria.frame, p_base, roll, pitch)
        return _flat(grid.q), _flat(grid.excess[..., None])[..., 0]

    def _rotations(self, q: Array) -> Array:
        return self._chain.rotations(q.reshape(-1, 5)).reshape(*q.shape[:2], 3, 3)


def _offsets(criteria: Criteria, count: int) -> Array:
    """Evenly spaced angles within the tolerance [rad]; ``count`` is odd, so 0 is among them."""
    within = 0.999 * min(criteria.orientation_tolerance, np.pi)
    return np.linspace(-within, within, count)


def _flat(values: Array) -> Array:
    """Reshape to (n, k, last): all configurations of a point in one axis."""
    return values.reshape(len(values), -1, values.shape[-1])
