"""Closed-form inverse kinematics for each kind of goal: position, approach, full pose.

All configurations put the goal's frame at its point, as exactly as the arm's structure fits the
model; ``ik.py`` judges the orientation later. A free roll stays that of the seed if possible; a
free pitch is the one whose configuration is nearest to the seed. It is compiled
(``native/arm_ik.c``).
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable
from functools import lru_cache
from math import dist
from typing import Any

from so101_motion.native.library import native
from so101_motion.planning.goals import GoalMetric
from so101_motion.planning.kinematics.arm_geometry import ArmStructure, Joints
from so101_motion.planning.kinematics.ik_task import Task

_MOST = 2048  # most configurations for one goal, spread over its pitches and rolls

_METRICS = {metric: float(k) for k, metric in enumerate(GoalMetric)}
_NO_ROTATION = (0.0,) * 9

_GOAL = struct.Struct("19d")
_FOUND = struct.Struct("5d")


class ClosedForms:
    """Configurations for an arm with our structure. Belongs to one thread."""

    def __init__(self, structure: ArmStructure) -> None:
        self._structure = structure
        self._arm = lru_cache(maxsize=8)(self._packed)
        self._goal = ctypes.create_string_buffer(_GOAL.size)
        self._found = memoryview(bytearray(_MOST * _FOUND.size))
        library = native().library
        self._nearest, self._spread = library.so101_ik_nearest, library.so101_ik_spread
        self._nearest.argtypes = self._spread.argtypes = (ctypes.c_void_p,) * 3
        found = ctypes.c_char.from_buffer(self._found)
        self._at = ctypes.addressof(self._goal), ctypes.addressof(found)

    def nearest(self, task: Task, seed: Joints) -> list[Joints]:
        """Configurations at the task's point, the one nearest to the seed first; few or none.

        For an approach, the seed's roll comes before all others, and configurations that miss the
        approach come last, for the error.
        """
        return self._configurations(self._nearest, task, seed)

    def spread(self, task: Task, seed: Joints) -> list[Joints]:
        """Configurations at the task's point, spread over free pitch and roll, nearest first."""
        found = self._configurations(self._spread, task, seed)
        return sorted(found, key=lambda q: dist(q, seed))

    def _configurations(self, solve: Callable[..., int], task: Task, seed: Joints) -> list[Joints]:
        is_turned = task.metric is not GoalMetric.POSITION_ONLY
        R = task.R_base_tool.ravel().tolist() if is_turned else _NO_ROTATION
        metric = _METRICS[task.metric]
        _GOAL.pack_into(self._goal, 0, metric, *task.point, *R, task.angle_tolerance, *seed)
        count = solve(self._arm(task.frame), *self._at)
        found = _FOUND.iter_unpack(self._found[: count * _FOUND.size])
        return [(a, b, c, d, e) for a, b, c, d, e in found]

    def _packed(self, frame: str) -> Any:
        """An arm with one frame of its gripper, in the form of ``Arm`` in ``arm_ik.h``."""
        m, structure = self._structure.measures, self._structure
        offset = m.offsets[frame]
        values = (
            *m.pan, m.pan_sign, m.azimuth, *m.shoulder, *m.bars[:4], *m.lower, *m.upper,
            *offset.forward, *offset.left, *offset.up,
            structure.longest[frame], structure.on_axis[frame], m.approach_elevation,
            *m.R_base_tool.ravel(), *m.R_base_axes.ravel(), *m.bars.constants,
        )  # fmt: skip
        return (ctypes.c_double * len(values))(*values)
