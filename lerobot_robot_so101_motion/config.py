"""What can be set, as ``--robot.NAME=VALUE`` on LeRobot's command line.

Angles are in degrees here, as everywhere in LeRobot; the names of caps say their units.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig


@dataclass
class SO101MotionArmConfig:
    """The settings of one arm.

    Attributes:
        port: The serial port.
        disable_torque_on_disconnect: Whether the joints are let go of at the end. They are only
            where the arm lies by itself: at its park pose, or at ``rest`` without one. Elsewhere
            they hold, and the log says so.
        max_relative_target: By how much a target may differ from where the joint is, in LeRobot's
            units; for all joints, or by name. None for no such bound: the motion is bounded anyway.
        cameras: By name.
        use_degrees: Whether joints count in degrees from the middle of their recorded travel; else
            from -100 to 100 over it. The jaw is always 0 to 100.
        speed_degs_per_sec: Cap on the speed of each joint [deg/s].
        acceleration_degs_per_sec_per_sec: Cap on the acceleration of each joint [deg/s^2].
        approach_speed_degs_per_sec: Cap on the way to a first target that is far [deg/s].
        guard: Whether the arm keeps clear of itself, of the table and of what is in ``scene``.
        scene: A file that says what is around the arm; None for just the table.
        park: The pose to go to at the end, by a plan: ``rest``, another built-in one or one of the
            user's own. None to stay.
        stale_after_s: After how long without a target the arm slows to rest [s].
    """

    port: str
    disable_torque_on_disconnect: bool = True
    max_relative_target: float | dict[str, float] | None = None
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    use_degrees: bool = True
    speed_degs_per_sec: float = 180.0
    acceleration_degs_per_sec_per_sec: float = 500.0
    approach_speed_degs_per_sec: float = 30.0
    guard: bool = True
    scene: Path | None = None
    park: str | None = None
    stale_after_s: float = 0.25


@RobotConfig.register_subclass("so101_motion")
@dataclass
class SO101MotionConfig(RobotConfig, SO101MotionArmConfig):
    """One arm: ``--robot.type=so101_motion``."""


@RobotConfig.register_subclass("bi_so101_motion")
@dataclass
class BiSO101MotionConfig(RobotConfig):
    """Two arms: ``--robot.type=bi_so101_motion``.

    Their calibrations are those of ``ID_left`` and ``ID_right``, as in LeRobot.

    Attributes:
        left_arm_config: Of the left one: ``--robot.left_arm_config.port=...``.
        right_arm_config: Of the right one.
    """

    left_arm_config: SO101MotionArmConfig
    right_arm_config: SO101MotionArmConfig


@TeleoperatorConfig.register_subclass("so101_motion_leader")
@dataclass
class SO101MotionLeaderConfig(TeleoperatorConfig):
    """An arm that is led by hand: ``--teleop.type=so101_motion_leader``.

    Attributes:
        port: The serial port.
        use_degrees: As for the robot; give both the same.
        speed_degs_per_sec: Cap on the speed of each joint while the leader is driven [deg/s].
    """

    port: str
    use_degrees: bool = True
    speed_degs_per_sec: float = 60.0
