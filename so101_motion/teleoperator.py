"""From rigs to what a hand leads: what the services and the command line share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from so101_motion.calib.zero import MIDDLE
from so101_motion.export import LeRobot
from so101_motion.geometry import Array
from so101_motion.gripper import Gripper
from so101_motion.rig import HardwareRig, Rig
from so101_motion.rig_like import RigLike
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

    return LocalArm(station=rig, jaw=jaw if jaw and jaw_of(jaw) else None, loads=loads)


def jaw_of(rig: Rig) -> Gripper | None:
    """The gripper of a rig; None for an arm without its sixth servo."""
    if isinstance(rig, HardwareRig) and GRIPPER_JOINT not in rig.servos.setups:
        return None
    return rig.gripper


def lerobot_of(rig: RigLike) -> LeRobot:
    """How LeRobot counts for this arm, with the jaw as it is."""
    middles = middles_of(rig) if isinstance(rig, Rig) else np.zeros(5)
    return LeRobot(middles=middles, aperture=rig.gripper.aperture)


def middles_of(rig: Rig) -> Array:
    """The arm's angles in the middle of its joints' recorded travels, shape (5,), [rad]."""
    if not isinstance(rig, HardwareRig):
        return np.zeros(5)
    setups = rig.servos.setups
    zeros = [setups[joint].zero if joint in setups else MIDDLE for joint in ARM_JOINTS]
    return np.array([zero.angle for zero in zeros])
