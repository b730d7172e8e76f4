"""Inverse kinematics for a pose with tolerances.

How it works. At a point pitch and roll are free, and the cloud bounds how far the tool may be
turned. Both are varied within these bounds, for all branches, and the closed forms give a few
thousand configurations at once (``batch_ik.py``); those remain that the model finds in the cloud.
The goal's own point is tried first; if nothing remains there, points of the cloud are tried, on a
coarse grid and then on a finer one.

Order. All poses of the cloud are as good, so the joints' distance from the seed counts; but a
tolerance should not be used without need. Using a tolerance costs, by the square of the used share,
as much as a radian of joint motion for the whole tolerance. So a narrow tolerance is used only
where it saves much joint motion, a wide one as if it were free.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import astuple
from itertools import product
from math import acos, asin, atan2, ceil, cos, hypot, pi, remainder, sin
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import SE3, Array
from so101_motion.planning.goals import PoseCloud
from so101_motion.planning.kinematics.arm_geometry import (
    JOINT_SLACK,
    TAU,
    ArmStructure,
    Joints,
    to_joints,
)
from so101_motion.planning.kinematics.batch_ik import (
    configurations_at,
    facing_turned,
    hands,
    pitch_towards,
    roll_for,
)
from so101_motion.planning.kinematics.batch_kinematics import ArmChain

SLACK = 1e-3  # beyond orientation tolerances [1], [rad]; viam-server's planner allows it
POSITION_SLACK = 1e-4  # the same for the position [m]: the tolerance of all goals
STEP_OF_TILT, STEP_OF_TURN = 0.1, 0.26  # between pitches and rolls [rad]; chosen
FEWEST = 5  # fewest pitches and rolls, if they have a tolerance

GRIDS = ((1, 2.0), (2, 3.0))
"""For the first grid and the second: points to either side along each axis with a tolerance, and
the factor by which pitches and rolls are further apart."""

APART = 0.15  # nearer solutions are left out, Euclidean distance [rad]; chosen


class Cloud(NamedTuple):
    """A goal's cloud, with the tool's rotation."""

    tolerance: PoseCloud  # the tolerances
    frame: str  # the frame of the goal
    p_base: Array  # the goal's position, shape (3,), [m]
    R_base_goal: Array  # the goal's rotation of that frame, shape (3, 3)
    R_base_tool: Array  # the tool's rotation at the goal, shape (3, 3)


class Offset(NamedTuple):
    """Deviations of poses from the goal of a cloud."""

    position: Array  # along the goal's axes, shape (n, 3), [m]
    axis: Array  # the reached z axis less the wanted one, shape (n, 3)
    turn: Array  # about that axis, shape (n,), 0 to pi [rad]

    def shares(self, tolerance: PoseCloud) -> Array:
        """Used share of each tolerance, slack included, shape (n, 7); up to 1 inside."""
        used = np.column_stack([np.abs(self.position), np.abs(self.axis), self.turn])
        slack = np.array([POSITION_SLACK] * 3 + [SLACK] * 4)
        return np.asarray(used / (np.array(astuple(tolerance)) + slack))


class CloudSolver:
    """Finds configurations in clouds for one arm."""

    def __init__(self, structure: ArmStructure, chain: Callable[[str], ArmChain]) -> None:
        self._structure, self._chain = structure, chain

    def spread(self, cloud: Cloud, seed: Joints, middle: Iterable[Joints] = ()) -> Iterator[Joints]:
        """Configurations in a cloud, those near the seed first, no two near each other.

        Args:
            middle: Configurations as near to the goal itself as possible, for narrow clouds.
        """
        q = np.array(list(middle)).reshape(-1, 5)
        for points, coarseness in self._points(cloud):
            q = np.concatenate([q, self._configurations(cloud, points, seed, coarseness)])
            shares = _offset(cloud, self._chain(cloud.frame), q).shares(cloud.tolerance)
            inside = shares.max(axis=1, initial=0.0) <= 1.0
            q, shares = q[inside], shares[inside]
            if len(q):
                break
        price = np.square(q - np.array(seed)).sum(axis=1) + np.square(shares).sum(axis=1)
        q = q[np.argsort(price, kind="stable")]
        while len(q):
            yield to_joints(q[0])
            q = q[np.square(q - q[0]).sum(axis=1) > APART**2]

    def _points(self, cloud: Cloud) -> Iterator[tuple[Array, float]]:
        """Points of a cloud to try, (n, 3) [m], and the coarseness; first the goal's own point."""
        yield cloud.p_base[None], 1.0
        tolerance = np.array([cloud.tolerance.x, cloud.tolerance.y, cloud.tolerance.z])
        if np.any(tolerance > 0.0):
            for count, coarseness in GRIDS:
                steps = [
                    np.linspace(-1.0, 1.0, 2 * count + 1) if normal else [0.0]
                    for normal in tolerance
                ]
                offsets = np.array(list(product(*steps))) * tolerance
                points = cloud.p_base + offsets @ cloud.R_base_goal.T
                beside = self._facing_it(cloud, points, tolerance)
                inside = np.abs((beside - cloud.p_base) @ cloud.R_base_goal) <= tolerance + 1e-9
                yield np.concatenate([points, beside[inside.all(axis=1)]]), coarseness

    def _facing_it(self, cloud: Cloud, points: Array, tolerance: Array) -> Array:
        """Points moved to where the arm can have exactly the wanted approach.

        The approach lies in the arm's plane. If that plane is turned to the wanted approach, a
        point must be as far beside it as the frame is.
        """
        structure, m = self._structure, self._structure.measures
        x, y, _ = cloud.R_base_tool[:, 2].tolist()
        R = cloud.R_base_tool[None]
        moved = [np.empty((0, 3))]
        for azimuth in (atan2(y, x), atan2(-y, -x)) if hypot(x, y) > SLACK else ():
            pan = np.full((1, 1, 1), m.pan_sign * remainder(azimuth - m.azimuth, TAU))
            pitch = pitch_towards(structure, pan, R[:, :, 2])
            roll = roll_for(structure, pan, pitch, R)
            lateral = float(hands(structure, cloud.frame, roll).lateral[0, 0, 0])
            left = np.array([-sin(azimuth), cos(azimuth), 0.0])
            # Along the axes that have a tolerance, most along the one with the largest.
            normal = cloud.R_base_goal @ (tolerance**2 * (cloud.R_base_goal.T @ left))
            if normal @ left > 0.0:
                beside = (points - np.array([*m.pan, 0.0])) @ left - lateral
                moved.append(points - beside[:, None] * normal / (normal @ left))
        return np.concatenate(moved)

    def _configurations(
        self, cloud: Cloud, p_base: Array, seed: Joints, coarseness: float
    ) -> Array:
        """Configurations at points, turned as far as the cloud allows, shape (k, 5), [rad]."""
        structure, tolerance, frame = self._structure, cloud.tolerance, cloud.frame
        R = np.broadcast_to(cloud.R_base_tool, (len(p_base), 3, 3))
        tilts = _offsets(_largest_tilt(tolerance), coarseness * STEP_OF_TILT)
        turns = _offsets(min(tolerance.theta, pi), coarseness * STEP_OF_TURN)
        target, pitch = facing_turned(structure, frame, p_base, R, seed[4])
        pitch = np.repeat(pitch + tilts, len(turns) + 1, axis=2)
        best = roll_for(structure, target.pan, pitch, R)
        every = np.arange(pitch.shape[2]) % (len(turns) + 1)
        # The last roll for each pitch is the seed's own.
        kept = every == len(turns)
        roll = np.where(kept, structure.clip_roll(seed[4]), best + np.append(turns, 0.0)[every])
        grid = configurations_at(structure, frame, p_base, roll, pitch)
        m = structure.measures
        return np.clip(grid.q[grid.excess <= JOINT_SLACK], m.lower, m.upper)


def is_in_cloud(tolerance: PoseCloud, T_goal_reached: SE3) -> bool:
    """Whether a pose relative to the goal is within the tolerances around it."""
    T = T_goal_reached
    return bool(_apart(T.R[None], T.p[None]).shares(tolerance).max() <= 1.0)


def _largest_tilt(tolerance: PoseCloud) -> float:
    """The largest angle between wanted and reached z axis that a cloud can allow [rad]."""
    by_z = acos(max(1.0 - tolerance.o_z - SLACK, -1.0))
    across = hypot(tolerance.o_x, tolerance.o_y) + SLACK
    return min(by_z, asin(across)) if by_z < 0.5 * pi and across < 1.0 else by_z


def _offsets(within: float, step: float) -> Array:
    """An odd number of angles within a tolerance, so that zero is among them [rad]."""
    if within <= 2.0 * SLACK:
        return np.zeros(1)
    count = max(FEWEST, 2 * ceil(within / step) + 1)
    return np.linspace(-within, within, count)


def _offset(cloud: Cloud, chain: ArmChain, q: Array) -> Offset:
    """Deviations of configurations (n, 5) [rad] from the goal of a cloud."""
    R = cloud.R_base_goal.T @ chain.rotations(q)
    return _apart(R, (chain.positions(q) - cloud.p_base) @ cloud.R_base_goal)


def _apart(R: Array, position: Array) -> Offset:
    """Deviations of rotations (n, 3, 3) and positions (n, 3) [m], both relative to the goal."""
    axis = R[:, :, 2] - np.array([0.0, 0.0, 1.0])
    # The rotation that is left after the axis is brought back by the shortest rotation.
    turn = np.arctan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1])
    return Offset(position, axis, np.abs(turn))
