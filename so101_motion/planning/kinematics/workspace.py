"""Find the reachable point nearest to one that is out of reach, on the edge of the workspace.

In the arm's plane the reachable points fill a region. On its boundary the arm cannot move further
out: each of the three joints is at a limit, or moves the hand only along the boundary. The possible
combinations (two joints at limits and one free; one at a limit and the other two links in line; all
three links in line) show that the boundary consists of circular arcs: one joint turns, the other
two stay at angles that are known in advance. There are fewer than thirty.

So the nearest point of the region is the nearest point of these arcs, which is elementary, and it
is the global minimum, not a local one. The pan adds four cases: the plane turned to the target,
away from it, or at one of the pan's limits. A frame beside the roll axis has such arcs for every
roll; they are computed for a set of rolls, and ``ik_task.minimise`` does the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from math import atan2, cos, hypot, inf, pi, remainder, sin, sqrt
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.kinematics.arm_geometry import (
    TAU,
    Angles,
    ArmStructure,
    Bars,
    Hand,
    Joints,
    Point,
)
from so101_motion.planning.kinematics.batch_ik import wrap

_ROLLS = 16
"""Number of rolls for which arcs are computed. Chosen: 21 degrees apart. For the jaw tip another
roll is often almost as near; with 8, one result in two was up to 35 um too far."""

_ROUNDING = 1e-9  # by how much more than a frame's distance a point is moved off the pan axis


class BoundaryArc(NamedTuple):
    """The arc of the hand's end while one joint turns; its angle falls as the joint's grows."""

    joint: int  # which of lift, elbow and wrist turns, 0 to 2
    angles: Angles  # lift, elbow and wrist [rad]; that of the turning joint is zero
    x: float  # centre, forward of the shoulder [m]
    z: float  # centre, up from the shoulder [m]
    radius: float  # radius [m]
    # elevation of the hand's end from the centre when the turning joint is at zero [rad]
    elevation: float


class Workspace:
    """The edge of the reachable points of one gripper frame.

    ``at`` returns configurations with the frame at a point [m], near a seed; or none.
    """

    def __init__(
        self,
        structure: ArmStructure,
        frame: str,
        at: Callable[[Point, Joints], list[Joints]],
    ) -> None:
        self._structure, self._at = structure, at
        m = structure.measures
        lower, upper = m.lower, m.upper
        self._on_axis = structure.on_axis(frame)
        count = 1 if self._on_axis else _ROLLS
        rolls = np.linspace(lower[4], upper[4], count).tolist()
        rolled = [(roll, *structure.rolled(frame, roll)) for roll in rolls]
        rows = [
            (roll, lateral, arc) for roll, lateral, hand in rolled for arc in _arcs(structure, hand)
        ]
        self._roll, self._lateral = (np.array([row[i] for row in rows]) for i in range(2))
        arcs = [row[2] for row in rows]
        self._joint = np.array([arc.joint for arc in arcs])
        self._angles = np.array([arc.angles for arc in arcs])
        self._circle = np.array([(arc.x, arc.z, arc.radius, arc.elevation) for arc in arcs]).T
        # With the roll half a step off, a frame is farther by its eccentricity times this; the
        # factor of four covers the effect of the pan.
        open_angle = 0.5 * (upper[4] - lower[4]) / (_ROLLS - 1)
        eccentricity = max(hypot(*row[1:]) for row in m.offsets[frame])
        self._open = 4.0 * eccentricity * (1.0 - cos(open_angle))
        low, high = np.array(lower[1:4])[self._joint], np.array(upper[1:4])[self._joint]
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low)

    def nearest(self, p_base: Point, seed: Joints) -> list[Joints]:
        """Joint angles at the edge of the workspace near a point [m] that is out of reach.

        For a frame on the roll axis those of the nearest reachable point. Otherwise starts for a
        minimisation: all that may lead to it, the most promising first.
        """
        m = self._structure.measures
        x, y, z = p_base[0] - m.pan[0], p_base[1] - m.pan[1], p_base[2] - m.shoulder[1]
        heading, away = atan2(y, x), hypot(x, y)
        found: list[tuple[float, Joints]] = []
        ahead = np.sqrt(np.maximum(away * away - self._lateral**2, 0.0))
        for along in (ahead, -ahead):
            pan = m.pan_sign * wrap(heading - m.azimuth - np.arctan2(self._lateral, along))
            if np.any((pan >= m.lower[0]) & (pan <= m.upper[0])):
                found += self._best(along - m.shoulder[0], z, 0.0 * along, pan)

        # Points missed only sideways: too close to the pan axis, or beyond the pan's limits.
        k = int(np.argmin(np.abs(self._lateral)))
        outwards = abs(float(self._lateral[k])) * (1.0 + _ROUNDING) - away
        if outwards > 0.0:
            found += self._beside(p_base, outwards, heading, (*seed[:4], float(self._roll[k])))
        for limit in (m.lower[0], m.upper[0]):
            azimuth = m.azimuth + m.pan_sign * limit
            beside = y * cos(azimuth) - x * sin(azimuth) - self._lateral
            k = int(np.argmin(np.abs(beside)))
            if abs(beside[k]) <= self._worth(found):
                along = x * cos(azimuth) + y * sin(azimuth) + 0.0 * ahead
                found += self._best(along - m.shoulder[0], z, beside, limit + 0.0 * ahead)
                there = (limit, *seed[1:4], float(self._roll[k]))
                found += self._beside(p_base, float(beside[k]), azimuth - 0.5 * pi, there)
        worth = self._worth(found)
        starts = [q for off, q in sorted(found) if off <= worth]
        if self._on_axis:
            return [(*starts[0][:4], self._structure.clip_roll(seed[4]))]
        return starts

    def _beside(
        self, p_base: Point, by: float, azimuth: float, seed: Joints
    ) -> list[tuple[float, Joints]]:
        """Configurations near a seed at a point that is moved ``by`` [m] to an azimuth."""
        moved = (p_base[0] + by * cos(azimuth), p_base[1] + by * sin(azimuth), p_base[2])
        return [(abs(by), q) for q in self._at(moved, seed)]

    def _worth(self, found: list[tuple[float, Joints]]) -> float:
        """Up to which distance a start may lead to a point nearer than those found [m]."""
        return min(found)[0] + self._open if found else inf

    def _best(self, x: Array, z: float, beside: Array, pan: Array) -> list[tuple[float, Joints]]:
        """The nearest arc that the pan can face: its distance [m] and the joints."""
        m = self._structure.measures
        centre_x, centre_z, radius, elevation = self._circle
        bearing = np.arctan2(z - centre_z, x - centre_x)
        turn = wrap(elevation - bearing - self._middle)
        angle = self._middle + np.clip(turn, -self._half, self._half)
        off_x = centre_x + radius * np.cos(elevation - angle) - x
        off_z = centre_z + radius * np.sin(elevation - angle) - z
        square = off_x**2 + off_z**2 + beside**2
        square[(pan < m.lower[0]) | (pan > m.upper[0])] = np.inf
        i = int(np.argmin(square))
        if not np.isfinite(square[i]):
            return []
        angles = self._angles[i].tolist()
        angles[self._joint[i]] = float(angle[i])
        return [(sqrt(square[i]), (float(pan[i]), *angles, float(self._roll[i])))]


def _arcs(structure: ArmStructure, hand: Hand) -> list[BoundaryArc]:
    """All arcs that can bound the region of the plane that a hand can reach."""
    bars = structure.bars
    lifts, elbows, wrists = zip(bars.lower, bars.upper, strict=True)
    choices: list[tuple[int, Angles]] = []
    for elbow in (*elbows, bars.straight):
        # The hand in line with shoulder and wrist, outwards or inwards.
        outwards = hand.elevation - elbow - _elevation(bars, (0.0, elbow, 0.0), hand, 0, 2)
        choices += [(0, (0.0, elbow, w)) for w in (*wrists, outwards, outwards - pi)]
    for wrist in wrists:
        # The line from elbow to the hand's end in line with the upper arm.
        outwards = _elevation(bars, (0.0, 0.0, wrist), hand, 1, 3) - bars.upper_arm_elevation
        choices += [(0, (0.0, elbow, wrist)) for elbow in (outwards, outwards - pi)]
    outwards = hand.elevation - bars.forearm_elevation
    choices += [
        (1, (lift, 0.0, wrist))
        for lift, wrist in product(lifts, (*wrists, outwards, outwards - pi))
    ]
    choices += [(2, (lift, elbow, 0.0)) for lift, elbow in product(lifts, elbows)]
    arcs = []
    for joint, (lift, elbow, wrist) in choices:
        angles = remainder(lift, TAU), remainder(elbow, TAU), remainder(wrist, TAU)
        fixed = [i for i in range(3) if i != joint]
        if all(bars.lower[i] <= angles[i] <= bars.upper[i] for i in fixed):
            arcs.append(_arc(bars, joint, angles, hand))
    return arcs


def _arc(bars: Bars, joint: int, angles: Angles, hand: Hand) -> BoundaryArc:
    points = bars.points(angles, hand)
    (x, z), (tip_x, tip_z) = points[joint], points[3]
    radius, elevation = hypot(tip_x - x, tip_z - z), atan2(tip_z - z, tip_x - x)
    return BoundaryArc(joint, angles, x, z, radius, elevation)


def _elevation(bars: Bars, angles: Angles, hand: Hand, start: int, end: int) -> float:
    """Elevation of the line between two of shoulder, elbow, wrist, hand's end [rad]."""
    points = bars.points(angles, hand)
    (x, z), (end_x, end_z) = points[start], points[end]
    return atan2(end_z - z, end_x - x)
