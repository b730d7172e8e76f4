"""Teleoperation: one arm follows another that is guided by hand.

``session.py`` has the whole story; ``predictor``, ``mirror``, ``gate`` and ``pilot`` say where the
follower goes, ``sides`` bring arms of this process to do so, ``recording`` writes it down. The
motion itself is a ``Following``.
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
