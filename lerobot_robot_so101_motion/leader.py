"""An SO-101 that is led by hand, as a teleoperator: ``--teleop.type=so101_motion_leader``.

Its joints are limp while a hand leads it. With torque on it holds, and is driven to where a
follower is, slowly and guarded like any arm: so a person takes over from where the follower stands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from typing import Any

from lerobot.teleoperators import Teleoperator
from lerobot.utils.constants import HF_LEROBOT_CALIBRATION, TELEOPERATORS

from lerobot_robot_so101_motion.arm_on_port import ArmOnPort
from lerobot_robot_so101_motion.arm_session import REST_WITHIN, Pace, Waiter
from lerobot_robot_so101_motion.config import SO101MotionLeaderConfig
from lerobot_robot_so101_motion.units import JOINTS, KEYS, is_number
from so101_motion.common.errors import So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.planning.collision.scene import Scene
from so101_motion.rig.hardware_rig import HardwareRig, open_hardware
from so101_motion.rig.servo_driver import ServoSettings

STOCK_FOLDER = "so_leader"
"""LeRobot's folder for the calibrations of these arms; ours are the same files."""

HANDED_OVER = 100.0
"""Cap on the acceleration of a leader that is driven [deg/s^2]; chosen, somebody may hold it."""

DRIVEN_ON = 2.0
"""For how long a leader goes on to the last place it was told [s]; chosen: it may lag behind."""


class SO101MotionLeader(Teleoperator):
    """An arm that leads.

    Args:
        config: Its settings.
        open_rig: Opens the arm on a port.
        waiter: How to wait for a motion; by default on the wall clock.
    """

    config_class = SO101MotionLeaderConfig
    name = "so101_motion_leader"

    def __init__(
        self,
        config: SO101MotionLeaderConfig,
        *,
        open_rig: Callable[[ServoSettings], HardwareRig] = open_hardware,
        waiter: Waiter | None = None,
    ) -> None:
        if config.calibration_dir is None:
            config = copy(config)
            config.calibration_dir = HF_LEROBOT_CALIBRATION / TELEOPERATORS / STOCK_FOLDER
        super().__init__(config)
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
    def feedback_features(self) -> dict[str, Any]:
        """Where the follower is: the six joints."""
        return self.action_features

    @property
    def is_connected(self) -> bool:
        """Whether the arm has been opened and not been given up."""
        return self._arm.is_open

    @property
    def is_calibrated(self) -> bool:
        """Whether there is a calibration file of this arm."""
        return all(joint in self.calibration for joint in JOINTS)

    def connect(self, calibrate: bool = True) -> None:
        """Open the arm and let go of its joints: have a hand on it.

        Args:
            calibrate: Whether an arm without a calibration file is calibrated first.

        Raises:
            DeviceAlreadyConnectedError: It is connected.
            ConnectionError: The arm cannot be reached; the message says why.
        """
        speed = to_rad(self.config.speed_degs_per_sec)
        pace = Pace(
            speed=speed,
            acceleration=to_rad(HANDED_OVER),
            approach_speed=speed,
            stale_after=DRIVEN_ON,
        )
        self._arm.open(pace, Scene(), is_calibrated=self.is_calibrated)
        try:
            if calibrate and not self.is_calibrated:
                self.calibrate()
            self.configure()
        except BaseException:
            self._arm.close()
            raise

    def configure(self) -> None:
        """Let go of the joints, and look at them in every period from now on."""
        self._arm.session.rig.executor.listen(lambda _: None)
        self.disable_torque()

    def calibrate(self) -> None:
        """Calibrate the arm with the help of a person; see ``calibration.calibrate``."""
        self._arm.calibrate()
        self._load_calibration()

    def setup_motors(self) -> None:
        """Give the motors their ids, one after the other, with the help of a person."""
        self._arm.set_up_motors()

    def get_action(self) -> dict[str, Any]:
        """Where the hand holds the joints.

        Raises:
            DeviceNotConnectedError: It is not connected.
            ConnectionError: The arm does not answer any more.
        """
        try:
            return dict(self._arm.here)
        except So101Error as error:
            raise ConnectionError(str(error)) from error

    def enable_torque(self) -> None:
        """Hold the joints where they are."""
        session = self._arm.session
        session.wait(session.rig.executor.hold(), REST_WITHIN)

    def disable_torque(self) -> None:
        """Let go of the joints, from rest: have a hand on the arm."""
        session = self._arm.session
        session.rest()
        session.rig.arm.set_torque(False)

    def send_feedback(self, feedback: Mapping[str, Any]) -> None:
        """Drive the leader to where the follower is; nothing while its joints are limp.

        Args:
            feedback: Values by key; a joint that is left out stays.

        Raises:
            DeviceNotConnectedError: It is not connected.
            ConnectionError: The arm cannot follow; the message says why.
        """
        arm = self._arm
        sent = {key: float(feedback[key]) for key in KEYS if is_number(feedback.get(key))}
        try:
            if not sent or arm.session.state.mode is Mode.LIMP:
                return
            arm.session.follow(*arm.units.from_lerobot({**arm.here, **sent}))
        except So101Error as error:
            raise ConnectionError(f"{self} cannot follow: {error}") from error

    def disconnect(self) -> None:
        """Come to rest and close the port; limp joints stay limp, held ones are held.

        Raises:
            DeviceNotConnectedError: It is not connected.
        """
        session = self._arm.session
        try:
            session.rest()
        except So101Error:
            pass  # it holds, or cannot be reached
        finally:
            self._arm.close()
