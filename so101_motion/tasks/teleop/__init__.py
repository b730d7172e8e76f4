"""Teleoperation: one arm follows another that is guided by hand.

``session.py`` runs a teleoperation; ``predictor``, ``mirror``, ``gate`` and ``pilot`` compute the
follower's targets, ``sides`` connects arms of this process, ``recording`` records them. The motion
itself is a ``Following``.
"""

from so101_motion.tasks.teleop.mirror import Mirror
from so101_motion.tasks.teleop.pilot import Pace
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
