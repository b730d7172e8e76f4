"""An SO-101 that is led by hand, as a teleoperator: ``--teleop.type=so101_motion_leader``.

Its joints are limp while a hand leads it. With torque on it holds, and is driven to where a
follower is, slowly and guarded like any arm: so a person takes over from where the follower stands.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lerobot.teleoperators import Teleoperator
from lerobot.utils.constants import TELEOPERATORS

from lerobot_robot_so101_motion.arm_session import REST_WITHIN, Pace
from lerobot_robot_so101_motion.config import SO101MotionLeaderConfig
from lerobot_robot_so101_motion.so101_device import SO101Device
from lerobot_robot_so101_motion.units import KEYS, is_number
from so101_motion.common.errors import So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.planning.collision.scene import Scene

HANDED_OVER = 100.0
"""Cap on the acceleration of a leader that is driven [deg/s^2]; chosen, somebody may hold it."""

DRIVEN_ON = 2.0
"""For how long a leader goes on to the last place it was told [s]; chosen: it may lag behind."""


class SO101MotionLeader(SO101Device, Teleoperator):
    """An arm that leads; see ``SO101Device``."""

    config_class = SO101MotionLeaderConfig
    name = "so101_motion_leader"
    stock_folder = Path(TELEOPERATORS) / "so_leader"

    @property
    def feedback_features(self) -> dict[str, Any]:
        """Where the follower is: the six joints."""
        return self.action_features

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
