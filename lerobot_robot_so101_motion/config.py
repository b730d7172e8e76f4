"""What can be set, as ``--robot.NAME=VALUE`` on LeRobot's command line.

Angles are in degrees here, as everywhere in LeRobot; the names of caps say their units. Each field
is explained below itself, where LeRobot's parser looks. A docstring of the class must not name
fields with a colon after them: the parser would take that for the fields.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig


@dataclass
class SO101MotionArmConfig:
    """The settings of one arm."""

    port: str
    """The serial port."""
    disable_torque_on_disconnect: bool = True
    """Whether the joints are let go of at the end. They only are where the arm lies by itself: at
    its park pose, or at "rest". Elsewhere they hold, and the log says so."""
    max_relative_target: float | dict[str, float] | None = None
    """By how much a target may differ from where the joint is, for all joints or by name. The
    motion is bounded anyway."""
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    """The cameras, by name."""
    use_degrees: bool = True
    """Whether joints count in degrees from the middle of their recorded travel; else from -100 to
    100 over it. The jaw is always 0 to 100."""
    speed_degs_per_sec: float = 180.0
    """Cap on the speed of each joint [deg/s]."""
    acceleration_degs_per_sec_per_sec: float = 500.0
    """Cap on the acceleration of each joint [deg/s^2]."""
    approach_speed_degs_per_sec: float = 30.0
    """Cap on the way to a first target that is far [deg/s]."""
    guard: bool = True
    """Whether the arm keeps clear of itself, of the table and of what the scene says is around."""
    scene: Path | None = None
    """A file that says what is around the arm; none for just the table."""
    park: str | None = None
    """The pose to go to at the end, by a plan: "rest" or another by name; none to stay."""
    stock_droop: bool = False
    """Whether nothing makes up for weight, friction and lag, as with LeRobot's own driver: for
    policies that have learnt how that one droops."""
    record_taken: bool = False
    """Whether the state also has what was taken of the action before, as JOINT.taken."""
    stale_after_s: float = 0.25
    """After how long without a target the arm slows to rest [s]."""


@RobotConfig.register_subclass("so101_motion")
@dataclass
class SO101MotionConfig(RobotConfig, SO101MotionArmConfig):
    """One arm, the robot so101_motion."""


@RobotConfig.register_subclass("bi_so101_motion")
@dataclass
class BiSO101MotionConfig(RobotConfig):
    """Two arms, the robot bi_so101_motion. Their ids end with _left and _right."""

    left_arm_config: SO101MotionArmConfig
    """Of the left arm."""
    right_arm_config: SO101MotionArmConfig
    """Of the right arm."""
    cell: Path | None = None
    """Where the two stand: a file as "so101 cell" has it, with arms "left" and "right", which then
    keep off each other, and off the file's scene where they have none of their own."""


@TeleoperatorConfig.register_subclass("so101_motion_leader")
@dataclass
class SO101MotionLeaderConfig(TeleoperatorConfig):
    """An arm that is led by hand, the teleoperator so101_motion_leader."""

    port: str
    """The serial port."""
    use_degrees: bool = True
    """As for the robot; give both the same."""
    speed_degs_per_sec: float = 60.0
    """Cap on the speed of each joint while the leader is driven [deg/s]."""
    guard_hint: float = 0.0
    """How much of its drive a joint pulls back with, 0 to 0.2, while the follower of this program
    is held off something: for the hand to feel, which always wins. 0 for not at all."""


@TeleoperatorConfig.register_subclass("so101_motion_jog")
@dataclass
class SO101MotionJogConfig(TeleoperatorConfig):
    """Keys or a gamepad that lead the tool, the teleoperator so101_motion_jog."""

    device: str = "keyboard"
    """The keyboard of this terminal, or a gamepad, such as /dev/input/js0."""
    speed_mm_per_sec: float = 40.0
    """How fast the tool goes along an axis [mm/s]."""
    turning_degs_per_sec: float = 30.0
    """How fast the tool turns about an axis [deg/s]."""
    in_tool: bool = False
    """Whether the axes are those of the tool instead of those of the base."""
