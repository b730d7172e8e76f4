"""The base of robot and leader: an arm on a port, and a calibration file of LeRobot."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from pathlib import Path
from typing import Any, ClassVar

from lerobot.utils.constants import HF_LEROBOT_CALIBRATION

from lerobot_robot_so101_motion.arm_on_port import ArmOnPort
from lerobot_robot_so101_motion.arm_session import Waiter
from lerobot_robot_so101_motion.units import JOINTS, KEYS
from so101_motion.rig.hardware_rig import HardwareRig, open_hardware
from so101_motion.rig.servo_driver import ServoSettings


class SO101Device:
    """One arm as a LeRobot device; inherit it before ``Robot`` or ``Teleoperator``.

    Args:
        config: Its settings.
        open_rig: Opens the arm on a port.
        waiter: Waits for a motion; by default on the wall clock.

    Attributes:
        stock_folder: LeRobot's folder for the calibrations of these arms; ours are the same files.
    """

    stock_folder: ClassVar[Path]
    calibration: dict[str, Any]
    calibration_fpath: Path

    def __init__(
        self,
        config: Any,
        *,
        open_rig: Callable[[ServoSettings], HardwareRig] = open_hardware,
        waiter: Waiter | None = None,
    ) -> None:
        if config.calibration_dir is None:
            config = copy(config)
            config.calibration_dir = HF_LEROBOT_CALIBRATION / self.stock_folder
        super().__init__(config)  # type: ignore[call-arg]  # that of LeRobot's class
        self.config = config
        self._arm = ArmOnPort(
            str(self),
            port=config.port,
            file=self.calibration_fpath,
            use_degrees=config.use_degrees,
            open_rig=open_rig,
            waiter=waiter,
            disconnect=self.disconnect,
        )

    @property
    def action_features(self) -> dict[str, Any]:
        """The six joints."""
        return dict.fromkeys(KEYS, float)

    @property
    def is_connected(self) -> bool:
        """Whether the arm is open."""
        return self._arm.is_open

    @property
    def is_calibrated(self) -> bool:
        """Whether there is a calibration file of this arm; ``connect`` writes it to the servos."""
        return all(joint in self.calibration for joint in JOINTS)

    def calibrate(self) -> None:
        """Calibrate the arm with the help of a person; see ``calibration.calibrate``."""
        self._arm.calibrate()
        self._load_calibration()  # type: ignore[attr-defined]  # of LeRobot's class

    def setup_motors(self) -> None:
        """Give the motors their ids, one after the other, with the help of a person."""
        self._arm.set_up_motors()

    def disconnect(self) -> None:
        """Bring the arm to rest and close the port."""
        raise NotImplementedError
