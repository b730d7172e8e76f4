"""Where the gripper holds a thing, and how wide its jaw has to be for that.

The fixed jaw's pad is where the frame ``jaw_tip`` is, and faces against that frame's x axis; the
other jaw comes from there. What is held lies on the pad, so its middle is half its thickness off.
"""

from __future__ import annotations

import math

import numpy as np

from so101_motion.common.geometry import SE3
from so101_motion.planning.kinematics.model import RobotModel


class JawGeometry:
    """The jaws of an arm.

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
        """Where the middle of a thing is that is held: z along the approach, x across the jaws."""
        return self._T_tool_tip @ SE3.from_translation((-0.5 * thickness, 0.0, 0.0))

    def angle_for(self, gap: float) -> float:
        """How far the jaw is open when so much is between the pads at ``jaw_tip`` [m], [rad].

        At most what the jaw can.
        """
        sine = math.sin(self._aside) - gap / self._length
        opened = self._aside - math.asin(max(sine, -1.0))
        return min(self.closed + opened, self.opened)
