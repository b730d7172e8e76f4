"""Compute where the gripper holds an object, and the jaw angle for its thickness.

The frame ``jaw_tip`` is on the pad of the fixed jaw, which faces against that frame's x axis,
towards the moving jaw. A held object lies on the pad, so its middle is half its thickness away.
"""

from __future__ import annotations

import math

import numpy as np

from so101_motion.common.geometry import SE3
from so101_motion.planning.kinematics.model import RobotModel


class JawGeometry:
    """Geometry of an arm's jaws.

    Args:
        model: The arm.

    Attributes:
        closed: The smallest angle of the jaw [rad].
        opened: The largest angle of the jaw [rad].
    """

    def __init__(self, model: RobotModel) -> None:
        lower, upper = model.pin_model.lowerPositionLimit, model.pin_model.upperPositionLimit
        self.closed, self.opened = float(lower[5]), float(upper[5])
        zero = np.zeros(5)
        T_base_tip = model.frame(zero, "jaw_tip")
        self._T_tool_tip = model.frame(zero).inverse @ T_base_tip
        p_tip_jaw = (
            T_base_tip.inverse @ model.link_placements(zero, 0.0)["moving_jaw_so101_v1_link"]
        ).p
        self._length = math.hypot(p_tip_jaw[0], p_tip_jaw[2])
        self._aside = math.atan2(-p_tip_jaw[0], -p_tip_jaw[2])

    def T_tool_grip(self, thickness: float) -> SE3:
        """The middle of a held object: z along the approach, x across the jaws."""
        return self._T_tool_tip @ SE3.from_translation((-0.5 * thickness, 0.0, 0.0))

    def angle_for(self, gap: float) -> float:
        """The jaw angle [rad] for a gap [m] between the pads at ``jaw_tip``; at most ``opened``."""
        sine = math.sin(self._aside) - gap / self._length
        opened = self._aside - math.asin(max(sine, -1.0))
        return min(self.closed + opened, self.opened)
