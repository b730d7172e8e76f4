"""Measure the distance between the grippers of two arms that hold the same object."""

from __future__ import annotations

import coal
import numpy as np

from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.bodies import hull_of
from so101_motion.planning.kinematics.model import GRIPPER_LINK, JAW_LINK, RobotModel


class Hand:
    """The gripper and the jaw of an arm, in its tool frame.

    Args:
        model: The arm.
        q_jaw: Angle of the jaw [rad].
    """

    def __init__(self, model: RobotModel, q_jaw: float) -> None:
        zero = np.zeros(5)
        T_tool_base, links = model.frame(zero).inverse, model.link_placements(zero, q_jaw)
        self.parts = [
            (hull_of(each), T_tool_base @ links[each]) for each in (GRIPPER_LINK, JAW_LINK)
        ]

    def clearance(self, other: Hand, T_tool_other: SE3) -> float:
        """The distance to another arm's hand with its tool at ``T_tool_other`` [m]."""
        return min(
            float(
                coal.distance(
                    *_placed(a), *_placed(b), coal.DistanceRequest(), coal.DistanceResult()
                )
            )
            for a in self.parts
            for b in ((shape, T_tool_other @ T) for shape, T in other.parts)
        )


def _placed(part: tuple[object, SE3]) -> tuple[object, object]:
    shape, T = part
    return shape, coal.Transform3s(np.array(T.R), np.array(T.p))
