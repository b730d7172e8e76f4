"""Make the leader or follower of a teleoperation from rigs, and convert to LeRobot's units."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from so101_motion.arm.gripper import Gripper
from so101_motion.calib.record.zero import MIDDLE
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.files.trajectory_export import LeRobot
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig
from so101_motion.tasks.teleop import LocalArm


def side_of(rig: Rig, jaw: Rig | None) -> LocalArm:
    """Make one side from an arm and a gripper, which may belong to another rig.

    Args:
        rig: The arm's.
        jaw: The gripper's; None to leave it alone.

    Raises:
        NotReady: The servos of one have not been found yet.
    """
    for part in (rig, jaw):
        if isinstance(part, HardwareRig):
            part.require_ready()

    def loads() -> Sequence[float]:
        return [joint.load for joint in rig.servos.health] if isinstance(rig, HardwareRig) else ()

    return LocalArm(station=rig, jaw=jaw if jaw and jaw_of(jaw) else None, loads=loads)


def jaw_of(rig: Rig) -> Gripper | None:
    """The gripper of a rig; None for an arm without its sixth servo."""
    if isinstance(rig, HardwareRig) and GRIPPER_JOINT not in rig.servos.setups:
        return None
    return rig.gripper


def lerobot_of(rig: RigLike) -> LeRobot:
    """LeRobot's units for this arm, with the jaw's present aperture."""
    middles = middles_of(rig) if isinstance(rig, Rig) else np.zeros(5)
    return LeRobot(middles=middles, aperture=rig.gripper.aperture)


def middles_of(rig: Rig) -> Array:
    """The arm's angles in the middle of its joints' recorded travels, shape (5,), [rad]."""
    if not isinstance(rig, HardwareRig):
        return np.zeros(5)
    setups = rig.servos.setups
    zeros = [setups[joint].zero if joint in setups else MIDDLE for joint in ARM_JOINTS]
    return np.array([zero.angle for zero in zeros])
