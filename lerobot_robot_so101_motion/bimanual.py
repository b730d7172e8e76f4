"""Two SO-101 arms as one robot of LeRobot: ``--robot.type=bi_so101_motion``.

Keys begin with ``left_`` or ``right_``. With a cell file the arms keep clear of each other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import fields
from functools import cached_property
from typing import Any

from lerobot.robots import Robot

from lerobot_robot_so101_motion.config import (
    BiSO101MotionConfig,
    SO101MotionArmConfig,
    SO101MotionConfig,
)
from lerobot_robot_so101_motion.robot import SO101Motion
from so101_motion.arm.cell import Cell
from so101_motion.common.errors import ConfigError
from so101_motion.drivers.port.port_list import device_of
from so101_motion.files.cell_file import read_cell

SIDES = ("left", "right")


class BiSO101Motion(Robot):
    """A left and a right arm."""

    config_class = BiSO101MotionConfig
    name = "bi_so101_motion"

    def __init__(self, config: BiSO101MotionConfig) -> None:
        super().__init__(config)
        self.config = config
        port = config.right_arm_config.port
        if device_of(port) == device_of(config.left_arm_config.port):
            reason = "is the port of the left arm; `so101 ports` lists the names of each"
            raise ConfigError("right_arm_config.port", port, reason)
        self.arms: dict[str, SO101Motion] = {
            f"{side}_": SO101Motion(_of_side(config, side, settings))
            for side, settings in zip(
                SIDES, (config.left_arm_config, config.right_arm_config), strict=True
            )
        }
        self._cell = None if config.cell is None else read_cell(config.cell)
        if self._cell is not None:
            names = sorted(each.name for each in self._cell.arms)
            if names != sorted(SIDES):
                raise ConfigError("cell", names, 'must have the two arms "left" and "right"')
            for each in self._cell.arms:
                arm = self.arms[f"{each.name}_"]
                if arm.config.scene is None:
                    arm.scene = self._cell.scene_of(each)
        self.cameras = {
            self._named(side, key): camera
            for side, arm in self.arms.items()
            for key, camera in arm.cameras.items()
        }

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        return self._joined(lambda arm: arm.observation_features)

    @cached_property
    def action_features(self) -> dict[str, Any]:
        return self._joined(lambda arm: arm.action_features)

    @property
    def is_connected(self) -> bool:
        return any(arm.is_connected for arm in self.arms.values())

    @property
    def is_calibrated(self) -> bool:
        return all(arm.is_calibrated for arm in self.arms.values())

    def connect(self, calibrate: bool = True) -> None:
        """Open both arms, or neither if one fails; see ``SO101Motion.connect``."""
        with ExitStack() as undo:
            for arm in self.arms.values():
                arm.connect(calibrate)
                undo.callback(arm.disconnect)
            self._join()
            undo.pop_all()

    def configure(self) -> None:
        """Do nothing."""

    def calibrate(self) -> None:
        """Calibrate one after the other, with the help of a person."""
        for arm in self.arms.values():
            arm.calibrate()

    def setup_motors(self) -> None:
        """Give the motors of both their ids, with the help of a person."""
        for side, arm in self.arms.items():
            print(f"The {side.rstrip('_')} arm:")
            arm.setup_motors()

    def get_observation(self) -> dict[str, Any]:
        """Read the joints of both and the newest pictures; see ``SO101Motion``."""
        return self._joined(lambda arm: arm.get_observation())

    def send_action(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Make both arms follow a target; returns the targets that they follow."""
        taken: dict[str, Any] = {}
        for side, arm in self.arms.items():
            own = {k.removeprefix(side): v for k, v in action.items() if k.startswith(side)}
            taken |= {side + key: value for key, value in arm.send_action(own).items()}
        return taken

    def disconnect(self) -> None:
        """Disconnect both, even if one fails; see ``SO101Motion.disconnect``."""
        with ExitStack() as both:
            for arm in self.arms.values():
                if arm.is_connected:
                    both.callback(arm.disconnect)

    def _join(self) -> None:
        """Let the two keep clear of each other, if there is a cell file."""
        if self._cell is None:
            return
        cell = Cell()
        for each in self._cell.arms:
            cell.add(each.name, self.arms[f"{each.name}_"].session.rig, each.T_cell_base)

    def _joined(self, of: Callable[[SO101Motion], dict[str, Any]]) -> dict[str, Any]:
        return {
            self._named(side, key): value
            for side, arm in self.arms.items()
            for key, value in of(arm).items()
        }

    def _named(self, side: str, key: str) -> str:
        """The key of both for a key of one arm; the left one has the cameras of neither."""
        is_shared = side == "left_" and key.removesuffix("_depth") in self.config.cameras
        return key if is_shared else side + key


def _of_side(
    config: BiSO101MotionConfig, side: str, settings: SO101MotionArmConfig
) -> SO101MotionConfig:
    own = {each.name: getattr(settings, each.name) for each in fields(SO101MotionArmConfig)}
    if twice := sorted(set(config.cameras) & set(settings.cameras)):
        raise ValueError(f"camera {twice[0]} is among those of the {side} arm and those of neither")
    if side == "left":
        own["cameras"] = {**settings.cameras, **config.cameras}
    return SO101MotionConfig(
        id=f"{config.id}_{side}" if config.id else None,
        calibration_dir=config.calibration_dir,
        **own,
    )
