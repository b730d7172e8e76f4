"""An SO-101 guided by hand, as a teleoperator: ``--teleop.type=so101_motion_leader``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lerobot.teleoperators import Teleoperator
from lerobot.utils.constants import TELEOPERATORS

from lerobot_robot_so101_motion.arm_session import Pace
from lerobot_robot_so101_motion.config import SO101MotionLeaderConfig
from lerobot_robot_so101_motion.so101_device import SO101Device
from lerobot_robot_so101_motion.units import KEYS, is_number
from so101_motion.common.errors import So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.planning.collision.scene import Scene
from so101_motion.rig.session_end import REST_WITHIN

HANDED_OVER = 100.0  # cap on its acceleration while it moves by itself [deg/s^2]; chosen for a hand
DRIVEN_ON = 2.0  # it goes on moving to the last feedback for so long [s]; chosen: that may lag


class SO101MotionLeader(SO101Device, Teleoperator):
    """An arm that is guided by hand."""

    config_class = SO101MotionLeaderConfig
    name = "so101_motion_leader"
    stock_folder = Path(TELEOPERATORS) / "so_leader"

    @property
    def feedback_features(self) -> dict[str, Any]:
        return self.action_features

    def connect(self, calibrate: bool = True) -> None:
        """Open the arm and release its joints: have a hand on it. As ``SO101Motion.connect``."""
        speed = to_rad(self.config.speed_degs_per_sec)
        pace = Pace(
            speed=speed,
            acceleration=to_rad(HANDED_OVER),
            approach_speed=speed,
            stale_after=DRIVEN_ON,
        )
        self._open(pace, Scene(), calibrate=calibrate)

    def configure(self) -> None:
        """Release the joints, and read them in every period from now on."""
        self.session.rig.executor.listen(lambda _: None)
        self.disable_torque()

    _begin = configure

    def get_action(self) -> dict[str, Any]:
        """Read the joints that the hand moves."""
        try:
            return self.session.here
        except So101Error as error:
            raise ConnectionError(str(error)) from error

    def enable_torque(self) -> None:
        """Hold the joints in their positions."""
        session = self.session
        session.wait(session.rig.executor.hold(), REST_WITHIN)

    def disable_torque(self) -> None:
        """Come to rest and release the joints: have a hand on the arm."""
        session = self.session
        session.rest()
        session.rig.arm.set_torque(False)

    def send_feedback(self, feedback: Mapping[str, Any]) -> None:
        """Move the leader to the follower's position; does nothing while its joints are limp.

        A joint that is left out does not move. ``ConnectionError`` if the arm cannot follow.
        """
        session = self.session
        sent = {key: float(feedback[key]) for key in KEYS if is_number(feedback.get(key))}
        try:
            if not sent or session.state.mode is Mode.LIMP:
                return
            session.follow(*session.units.from_lerobot({**session.here, **sent}))
        except So101Error as error:
            raise ConnectionError(f"{self} cannot follow: {error}") from error

    def disconnect(self) -> None:
        """Come to rest and close the port; limp joints stay limp, held ones stay held."""
        session = self.session
        try:
            session.rest()
        except So101Error:
            pass  # it holds, or cannot be reached
        finally:
            self._close()
