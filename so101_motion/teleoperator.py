"""From rigs to the sides of a teleoperation: what the services and the command line share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from so101_motion.calib.zero import MIDDLE
from so101_motion.geometry import Array
from so101_motion.rig import HardwareRig, Rig
from so101_motion.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.teleop import LocalArm


def side_of(rig: Rig, jaw: Rig | None) -> LocalArm:
    """An arm and its gripper, which may be of another rig, as one side.

    Args:
        rig: The arm's.
        jaw: The gripper's; None to leave it alone.
    """

    def loads() -> Sequence[float]:
        return [joint.load for joint in rig.servos.health] if isinstance(rig, HardwareRig) else ()

    if isinstance(jaw, HardwareRig) and GRIPPER_JOINT not in jaw.servos.setups:
        jaw = None  # an arm without its sixth servo
    return LocalArm(station=rig, jaw=jaw, loads=loads)


def middles_of(rig: Rig) -> Array:
    """The arm's angles in the middle of its joints' recorded travels, shape (5,), [rad]."""
    if not isinstance(rig, HardwareRig):
        return np.zeros(5)
    setups = rig.servos.setups
    zeros = [setups[joint].zero if joint in setups else MIDDLE for joint in ARM_JOINTS]
    return np.array([zero.angle for zero in zeros])
