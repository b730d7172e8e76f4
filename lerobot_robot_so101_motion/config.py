"""The settings of the robots and teleoperators, as ``--robot.NAME=VALUE`` for LeRobot's commands.

Angles are in degrees here, as everywhere in LeRobot; the names of caps have their units. The text
below each field is its help for LeRobot's parser. A docstring of the class must not name fields
with a colon after them: the parser would take that for the fields' help.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig

from lerobot_robot_so101_motion.units import JOINTS, is_number


@dataclass
class SO101MotionArmConfig:
    """The settings of one arm."""

    port: str
    """The serial port."""
    disable_torque_on_disconnect: bool = True
    """Whether the joints are released at the end. They are released only where the arm lies without
    torque: at its park pose, or at "rest". Elsewhere they hold, and the log says so."""
    max_relative_target: float | dict[str, float] | None = None
    """Largest difference between a target and a joint's position, for all joints or by name. Speed
    and acceleration are limited anyway."""
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    """The cameras, by name."""
    use_degrees: bool = True
    """Whether joint values are degrees from the middle of the recorded travel; else -100 to 100
    over it. The jaw is always 0 to 100."""
    speed_degs_per_sec: float = 180.0
    """Cap on the speed of each joint [deg/s]."""
    acceleration_degs_per_sec_per_sec: float = 500.0
    """Cap on the acceleration of each joint [deg/s^2]."""
    approach_speed_degs_per_sec: float = 30.0
    """Cap on the speed to a first target that is far [deg/s]."""
    guard: bool = True
    """Whether the arm keeps clear of itself, of the table and of the scene's obstacles."""
    scene: Path | None = None
    """A scene file with the obstacles around the arm; none for just the table."""
    tool: str | None = None
    """What is fixed to the gripper: a tool's name, or its .json file."""
    park: str | None = None
    """The pose to move to at the end, along a plan: "rest" or another by name; none to stay."""
    stock_droop: bool = False
    """Whether weight, friction and lag are not compensated, as in LeRobot's own driver: for
    policies that were trained with its droop."""
    record_taken: bool = False
    """Whether the state also has the target that the arm followed last, as JOINT.taken."""
    stale_after_s: float = 0.25
    """The arm slows to rest after this long without a target [s]."""

    def __post_init__(self) -> None:
        most = self.max_relative_target
        bounds = most if isinstance(most, dict) else {} if most is None else {"": most}
        for joint, bound in bounds.items():
            if joint and joint not in JOINTS:
                known = ", ".join(JOINTS)
                raise ValueError(f"max_relative_target: there is no joint {joint}; known: {known}")
            if not is_number(bound) or bound <= 0.0:
                name = f"max_relative_target {joint}".rstrip()
                raise ValueError(f"{name} must be a number above 0, not {bound}")
        parent = getattr(super(), "__post_init__", None)
        if parent is not None:
            parent()


@RobotConfig.register_subclass("so101_motion")
@dataclass
class SO101MotionConfig(RobotConfig, SO101MotionArmConfig):
    """One arm, the robot so101_motion."""


@RobotConfig.register_subclass("bi_so101_motion")
@dataclass
class BiSO101MotionConfig(RobotConfig):
    """Two arms, the robot bi_so101_motion. Their ids end with _left and _right."""

    left_arm_config: SO101MotionArmConfig
    """Settings of the left arm."""
    right_arm_config: SO101MotionArmConfig
    """Settings of the right arm."""
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    """Cameras of neither arm; their names get no prefix."""
    cell: Path | None = None
    """A cell file, as for "so101 cell", with arms "left" and "right", which then keep clear of each
    other, and of the file's scene if they have none of their own."""


@TeleoperatorConfig.register_subclass("so101_motion_leader")
@dataclass
class SO101MotionLeaderConfig(TeleoperatorConfig):
    """An arm that is guided by hand, the teleoperator so101_motion_leader."""

    port: str
    """The serial port."""
    use_degrees: bool = True
    """As for the robot; give both the same."""
    speed_degs_per_sec: float = 60.0
    """Cap on the speed of each joint while the leader is driven [deg/s]."""
    guard_hint: float = 0.0
    """Share of its drive with which a joint pulls back, 0 to 0.2, while the guard holds the
    follower of this program: the hand feels it and is always stronger. 0 for none."""


@TeleoperatorConfig.register_subclass("so101_motion_jog")
@dataclass
class SO101MotionJogConfig(TeleoperatorConfig):
    """Keys or a gamepad that move the tool, the teleoperator so101_motion_jog."""

    device: str = "keyboard"
    """The keyboard of this terminal, or a gamepad, such as /dev/input/js0."""
    speed_mm_per_sec: float = 40.0
    """Speed of the tool along an axis [mm/s]."""
    turning_degs_per_sec: float = 30.0
    """Speed of the tool about an axis [deg/s]."""
    in_tool: bool = False
    """Whether the axes are those of the tool; else those of the base."""
