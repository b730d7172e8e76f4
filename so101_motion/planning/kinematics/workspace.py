"""Find where to begin a search for the reachable point nearest to one that is out of reach.

The distance from a point has several local minima, so the search (``ik_task.minimise``) begins at
the nearest of many configurations, and at others that are about as near but different. All but the
pan are sampled once; the pan turns each sample as near to the point as its limits allow.
"""

from __future__ import annotations

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.kinematics.arm_geometry import ArmStructure, Joints, Point
from so101_motion.planning.kinematics.batch_ik import wrap
from so101_motion.planning.kinematics.batch_kinematics import ArmChain

_SAMPLES = 9  # of each of lift, elbow and wrist
_ROLLS = 8  # of the roll, which does not matter for a frame on the roll axis
_STARTS, _APART = 12, 0.7
"""Most starts, and the least difference of one of their joints [rad]. Chosen: for 599 of 600 random
points out of reach no nearer point was found in closed form, for one that was 0.7 mm nearer."""


class Workspace:
    """Samples of where a gripper frame can be."""

    def __init__(self, structure: ArmStructure, chain: ArmChain) -> None:
        self._structure, m = structure, structure.measures
        self._on_axis = structure.on_axis[chain.frame]
        counts = (1, _SAMPLES, _SAMPLES, _SAMPLES, 1 if self._on_axis else _ROLLS)
        ranges = map(np.linspace, (0.0, *m.lower[1:]), (0.0, *m.upper[1:]), counts)
        self._q = np.stack(np.meshgrid(*ranges), axis=-1).reshape(-1, 5)
        x, y, self._z = (chain.positions(self._q) - np.array([*m.pan, 0.0])).T
        self._azimuth, self._away = np.arctan2(y, x), np.hypot(x, y)

    def starts(self, p_base: Point, seed: Joints) -> list[Array]:
        """Different configurations (5,) [rad] that bring the frame near a point, nearest first."""
        m = self._structure.measures
        x, y, z = p_base[0] - m.pan[0], p_base[1] - m.pan[1], p_base[2]
        turned = wrap(np.arctan2(y, x) - self._azimuth)
        pan = np.clip(m.pan_sign * turned, m.lower[0], m.upper[0])
        off = wrap(turned - m.pan_sign * pan)
        square = self._away**2 - 2.0 * self._away * np.hypot(x, y) * np.cos(off)
        q = self._q.copy()
        q[:, 0] = pan
        if self._on_axis:
            q[:, 4] = self._structure.clip_roll(seed[4])
        q = q[np.argsort(square + (self._z - z) ** 2, kind="stable")]
        found: list[Array] = []
        while len(q) and len(found) < _STARTS:
            found.append(q[0])
            q = q[np.abs(q - q[0]).max(axis=1) > _APART]
        return found
