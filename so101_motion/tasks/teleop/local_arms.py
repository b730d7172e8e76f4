"""The jaw of a rig, and the middles of its joints' travels, from which LeRobot counts."""

from __future__ import annotations

import numpy as np

from so101_motion.arm.gripper import Gripper
from so101_motion.calib.record.zero import MIDDLE
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.rig import Rig


def jaw_of(rig: Rig) -> Gripper | None:
    """The gripper of a rig; None for an arm without its sixth servo."""
    if isinstance(rig, HardwareRig) and GRIPPER_JOINT not in rig.servos.setups:
        return None
    return rig.gripper


def middles_of(rig: Rig) -> Array:
    """The arm's angles in the middle of its joints' recorded travels, shape (5,), [rad]."""
    if not isinstance(rig, HardwareRig):
        return np.zeros(5)
    setups = rig.servos.setups
    zeros = [setups[joint].zero if joint in setups else MIDDLE for joint in ARM_JOINTS]
    return np.array([zero.angle for zero in zeros])
