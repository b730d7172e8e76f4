"""Call the compiled closed forms of inverse kinematics in ``native/arm_ik.c``."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Sequence
from typing import Any

from so101_motion.planning.goals import GoalMetric
from so101_motion.planning.kinematics.arm_geometry import (
    BRANCHES,
    ArmStructure,
    Configuration,
    Joints,
)
from so101_motion.planning.kinematics.ik_task import Task
from so101_motion.planning.native.library import native

_MOST = 32
"""Most configurations for one goal: ``MOST`` in the C file."""

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
