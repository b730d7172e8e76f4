"""Closed-form inverse kinematics for each kind of goal: position, approach, full pose.

All configurations put the goal's frame at its point, as exactly as the arm's structure fits the
model; ``ik.py`` judges the orientation later. A free roll stays that of the seed if possible; a
free pitch is the one whose configuration is nearest to the seed. The nearest ones are compiled
(``native/arm_ik.c``); those spread over what a goal leaves free are found here.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Iterable, Iterator, Sequence
from math import atan2, cos, dist, hypot, pi, sin
from typing import Any

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.goals import GoalMetric
from so101_motion.planning.kinematics.arm_geometry import (
    BRANCHES,
    ArmStructure,
    Configuration,
    Joints,
    Side,
    to_joints,
)
from so101_motion.planning.kinematics.ik_task import Task
from so101_motion.planning.kinematics.planar_3r import Bend, Target, ThreeBars
from so101_motion.planning.kinematics.workspace import Workspace
from so101_motion.planning.native.library import native

_MOST = 32  # most configurations for one goal: ``MOST`` in the C file

_METRICS = {
    GoalMetric.POSITION_AND_APPROACH: 1.0,
    GoalMetric.FULL_POSE: 2.0,
}
_BRANCHES = tuple(BRANCHES.values())
_NO_ROTATION = (0.0,) * 9

_GOAL = struct.Struct("19d")
_FOUND = struct.Struct("6d")


class CompiledForms:
    """Configurations for an arm with our structure. Belongs to one thread.

    Args:
        structure: The arm.
    """

    def __init__(self, structure: ArmStructure) -> None:
        self._structure = structure
        self._arms: dict[str, Any] = {}
        self._addresses: dict[str, int] = {}
        self._goal = ctypes.create_string_buffer(_GOAL.size)
        self._found = memoryview(bytearray(_MOST * _FOUND.size))
        self._nearest = native().library.so101_ik_nearest
        self._nearest.argtypes = (ctypes.c_void_p,) * 3
        found = ctypes.c_char.from_buffer(self._found)
        self._at = ctypes.addressof(self._goal), ctypes.addressof(found)

    def nearest(self, task: Task, seed: Joints) -> list[Configuration]:
        """As ``ClosedForms.nearest``."""
        arm = self._addresses.get(task.frame)
        if arm is None:
            packed = self._arms[task.frame] = _packed(self._structure, task.frame)
            arm = self._addresses[task.frame] = ctypes.addressof(packed)
        R: Sequence[float]
        if task.metric is GoalMetric.POSITION_ONLY:
            metric, R = 0.0, _NO_ROTATION
        else:
            metric, R = _METRICS[task.metric], task.R_base_tool.ravel().tolist()
        _GOAL.pack_into(self._goal, 0, metric, *task.point, *R, task.angle_tolerance, *seed)
        count = self._nearest(arm, *self._at)
        found = _FOUND.iter_unpack(self._found[: count * _FOUND.size])
        return [Configuration((a, b, c, d, e), _BRANCHES[int(k)]) for a, b, c, d, e, k in found]


def _packed(structure: ArmStructure, frame: str) -> Any:
    """An arm with one frame of its gripper, in the form of ``Arm`` in the C file."""
    m, bars = structure.measures, structure.bars
    offset = m.offsets[frame]
    values = (
        *m.pan, m.pan_sign, m.azimuth, *m.shoulder, *bars.bars[:4], *m.lower, *m.upper,
        *offset.forward, *offset.left, *offset.up,
        structure.longest(frame), structure.on_axis(frame), m.approach_elevation,
        *m.R_base_tool.ravel(), *m.R_base_axes.ravel(), *bars.constants,
    )  # fmt: skip
    return (ctypes.c_double * len(values))(*values)


ROLLS = 6
"""Number of parts into which the roll's range is cut if its present angle does not work. Chosen."""

PITCH_STEP = 0.2  # distance between alternative pitches [rad]. Chosen: 11 degrees


class ClosedForms:
    """Configurations for an arm with our structure. Belongs to one thread.

    Args:
        structure: The arm.
    """

    def __init__(self, structure: ArmStructure) -> None:
        self._structure = structure
        self._compiled = CompiledForms(structure)
        self._workspaces: dict[str, Workspace] = {}

    def nearest(self, task: Task, seed: Joints) -> list[Configuration]:
        """Configurations at the task's point, the one nearest to the seed first; few or none.

        For an approach, the seed's roll comes before all others, and configurations that miss the
        approach come last, for the error.
        """
        return self._compiled.nearest(task, seed)

    def spread(self, task: Task, seed: Joints) -> list[Configuration]:
        """Configurations at the task's point, spread over free pitch and roll, nearest first."""
        structure = self._structure
        if task.metric is GoalMetric.FULL_POSE:
            return self.nearest(task, seed)
        if task.metric is GoalMetric.POSITION_ONLY:
            return _by_distance(all_positions(structure, task, seed), seed)
        roll = structure.clip_roll(seed[4])
        rolls = [roll, *approach_rolls(structure, task), *spread_rolls(structure)]
        sides, _ = sides_by_approach(structure, task, rolls)
        return _by_distance(approach(structure, task, sides), seed)

    def edge(self, task: Task, seed: Joints) -> list[Array]:
        """Starts for a minimisation to a point out of reach, each of shape (5,), [rad].

        For a frame on the roll axis they are at the nearest reachable point already.
        """
        if task.frame not in self._workspaces:
            self._workspaces[task.frame] = Workspace(self._structure, task.frame)
        return [np.array(q) for q in self._workspaces[task.frame].nearest(task.point, seed)]

    def branch(self, q: Array, frame: str) -> str:
        """The name of the branch that joint angles belong to."""
        return self._structure.branch(to_joints(q), frame)


def _by_distance(configurations: list[Configuration], seed: Joints) -> list[Configuration]:
    return sorted(configurations, key=lambda configuration: dist(configuration.q, seed))


def spread_rolls(structure: ArmStructure) -> list[float]:
    """Rolls evenly spaced over the range [rad]."""
    m = structure.measures
    return [float(roll) for roll in np.linspace(m.lower[4], m.upper[4], ROLLS + 1)]


def all_positions(structure: ArmStructure, task: Task, q_seed: Joints) -> list[Configuration]:
    """Configurations that put the frame at the point, spread over pitch, roll, and all branches."""
    roll = structure.clip_roll(q_seed[4])
    return [
        Configuration((side.pan, *bend.angles, each), BRANCHES[side.name, bend.elbow_up])
        for each in (roll, *spread_rolls(structure))
        for side in structure.sides(task.point, structure.rolled(task.frame, each))
        for bend in _spread_bends(structure.bars, side.target)
    ]


def _spread_bends(bars: ThreeBars, target: Target) -> Iterator[Bend]:
    """Configurations of the plane no farther apart in pitch than ``PITCH_STEP``."""
    for elbow_up in (True, False):
        for _, low, high in bars.intervals(target, 0.0, elbow_up):
            count = int((high - low) / PITCH_STEP) + 1
            for i in range(count):
                bends = bars.bends(target, low + (high - low) * (i + 0.5) / count)
                yield from (bend for bend in bends if bend.elbow_up == elbow_up)


RolledSide = tuple[float, Side]  # a roll [rad] and one of the sides possible with it


def sides_by_approach(
    structure: ArmStructure, task: Task, rolls: Iterable[float]
) -> tuple[list[RolledSide], list[RolledSide]]:
    """The sides whose plane contains the wanted approach within its tolerance, and the others."""
    x, y, _ = task.R_base_tool[:, 2].tolist()
    out_of_plane = sin(min(task.angle_tolerance, 0.5 * pi))
    near: list[RolledSide] = []
    others: list[RolledSide] = []
    for roll in rolls:
        for side in structure.sides(task.point, structure.rolled(task.frame, roll)):
            azimuth = structure.azimuth(side.pan)
            aside = y * cos(azimuth) - x * sin(azimuth)
            (near if abs(aside) <= out_of_plane else others).append((roll, side))
    return near, others


def approach(
    structure: ArmStructure, task: Task, sides: Iterable[RolledSide]
) -> list[Configuration]:
    """Configurations at the point, the approach as near to the wanted one as each side allows."""
    x, y, z = task.R_base_tool[:, 2].tolist()
    return [
        configuration
        for roll, side in sides
        for configuration in _configurations(
            structure, side, structure.pitch_towards(side.pan, (x, y, z)), roll
        )
    ]


def approach_rolls(structure: ArmStructure, task: Task) -> list[float]:
    """Rolls that turn the arm's plane to the wanted approach [rad]; none if it is vertical.

    The approach lies in the arm's plane. A frame beside the roll axis lets the plane turn a
    little, to either side of the point, because the roll moves the frame out of the plane.
    """
    x, y, _ = task.R_base_tool[:, 2].tolist()
    offset = structure.measures.offsets[task.frame]
    rolls: list[float] = []
    if not structure.on_axis(task.frame) and hypot(x, y) > 1e-9:
        for azimuth in (atan2(y, x), atan2(-y, -x)):
            if structure.can_face(azimuth):
                rolls += offset.rolls_with_lateral(structure.lateral_for(task.point, azimuth))
    return [structure.clip_roll(roll) for roll in rolls]


def _configurations(
    structure: ArmStructure, side: Side, pitch: float, roll: float
) -> list[Configuration]:
    return [
        Configuration((side.pan, *angles, roll), BRANCHES[side.name, elbow_up])
        for angles, elbow_up in structure.bars.nearest_pitch(side.target, pitch)
    ]
