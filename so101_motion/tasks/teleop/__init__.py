"""Teleoperation: one arm follows another that is guided by hand."""

from so101_motion.tasks.teleop.pilot import Mirror, Pace
from so101_motion.tasks.teleop.recording import Recorder
from so101_motion.tasks.teleop.session import Status, Teleop
from so101_motion.tasks.teleop.sides import LocalArm, LocalFollower, LocalLeader

__all__ = [
    "LocalArm",
    "LocalFollower",
    "LocalLeader",
    "Mirror",
    "Pace",
    "Recorder",
    "Status",
    "Teleop",
]
