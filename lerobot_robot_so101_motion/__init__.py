"""The SO-101 arm in LeRobot, moved by so101_motion.

LeRobot finds this package by its name and its classes by the names of their configurations.
"""

from lerobot_robot_so101_motion.bimanual import BiSO101Motion
from lerobot_robot_so101_motion.config import (
    BiSO101MotionConfig,
    SO101MotionArmConfig,
    SO101MotionConfig,
    SO101MotionJogConfig,
    SO101MotionLeaderConfig,
)
from lerobot_robot_so101_motion.jog import SO101MotionJog
from lerobot_robot_so101_motion.leader import SO101MotionLeader
from lerobot_robot_so101_motion.robot import SO101Motion

__all__ = [
    "BiSO101Motion",
    "BiSO101MotionConfig",
    "SO101Motion",
    "SO101MotionArmConfig",
    "SO101MotionConfig",
    "SO101MotionJog",
    "SO101MotionJogConfig",
    "SO101MotionLeader",
    "SO101MotionLeaderConfig",
]
