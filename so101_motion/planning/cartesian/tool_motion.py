"""The joint motion along a tool path: its curves and its timing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.kinematics.batch_kinematics import ArmChain
from so101_motion.planning.timing.exact_retiming import time_exactly
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import point_to_point
from so101_motion.planning.timing.path_geometry import JointPath
from so101_motion.planning.timing.trajectory import Trajectory

SAME = 1e-6  # a motion smaller than this is none [rad]. Chosen: a servo tick is 1.5e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolMotion:
    """Joint curves that follow a tool path, still without timing."""

    q_start: Array  # joint angles at the start, shape (5,), [rad]
    # one after the other; the arm rests between them. Empty if the arm is there already
    curves: tuple[JointPath, ...]
    off: float  # largest distance of the tool from its path [m]
    turned: float  # largest deviation of its orientation, as far as that counts [rad]

    @property
    def waypoints(self) -> Array:
        """The configurations through which the curves go, shape (m, 5), [rad]."""
        knots = [curve.evaluate(curve.knots).q[1:] for curve in self.curves]
        return np.concatenate([self.q_start[None], *(knots or [self.q_start[None]])])

    def timed(self, limits: MotionLimits, dt: float, tool: ArmChain) -> list[Trajectory]:
        """The motion on these curves, from rest to rest, as fast as the limits allow."""
        if float(np.ptp(self.waypoints, axis=0).max()) <= SAME:
            return [point_to_point(self.q_start, self.q_start, limits, dt)]
        return [time_exactly(curve, limits, dt, tool_speed_fn=tool.speeds) for curve in self.curves]
