"""Curves of the joints along which the tool keeps to its way, and their timing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from so101_motion.geometry import Array
from so101_motion.planning.arm_chain import ArmChain
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.online import point_to_point
from so101_motion.planning.path_geometry import JointPath
from so101_motion.planning.path_timing import time_exactly
from so101_motion.planning.trajectory import Trajectory

SAME = 1e-6
"""Joints that all move by no more than this do not move [rad]. Chosen: a servo tick is 1.5e-3."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolMotion:
    """How the joints follow a way of the tool, without time.

    Attributes:
        q_start: Where they start, shape (5,), [rad].
        curves: One after the other; the arm rests between them. None if it is there already.
        off: How far the tool is from its way at the most [m].
        turned: How far it is turned off at the most, as far as that counts [rad].
    """

    q_start: Array
    curves: tuple[JointPath, ...]
    off: float
    turned: float

    @property
    def waypoints(self) -> Array:
        """The postures the curves were laid through, shape (m, 5), [rad]."""
        knots = [curve.evaluate(curve.knots).q[1:] for curve in self.curves]
        return np.concatenate([self.q_start[None], *(knots or [self.q_start[None]])])

    def timed(self, limits: MotionLimits, dt: float, tool: ArmChain) -> list[Trajectory]:
        """The motion, from rest to rest, as fast as the limits allow on these very curves.

        Args:
            limits: Caps of the joints and of the tool.
            dt: Time between samples [s].
            tool: The tool point, whose speed has a cap.
        """
        if float(np.ptp(self.waypoints, axis=0).max()) <= SAME:
            return [point_to_point(self.q_start, self.q_start, limits, dt)]
        return [time_exactly(curve, limits, dt, tool_speed_fn=tool.speeds) for curve in self.curves]
