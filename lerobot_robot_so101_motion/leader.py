"""An SO-101 guided by hand, as a teleoperator: ``--teleop.type=so101_motion_leader``.

With ``guard_hint``, limp joints pull softly towards the follower of the same program while the
guard holds that. LeRobot sends a leader no feedback, so it reads the follower itself.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from lerobot.teleoperators import Teleoperator
from lerobot.utils.constants import TELEOPERATORS

from lerobot_robot_so101_motion.arm_session import Pace
from lerobot_robot_so101_motion.config import SO101MotionLeaderConfig
from lerobot_robot_so101_motion.so101_device import SO101Device, open_arms
from lerobot_robot_so101_motion.units import KEYS, is_number
from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.drivers.feetech.hand_pull import Pull
from so101_motion.planning.collision.scene import Scene
from so101_motion.rig.session_end import REST_WITHIN

HANDED_OVER = 100.0  # cap on its acceleration while it moves by itself [deg/s^2]; chosen for a hand
DRIVEN_ON = 2.0  # it goes on moving to the last feedback for so long [s]; chosen: that may lag
HINTED = 0.2  # a pull of the guard ends so long after an action [s]; chosen: three at 15 Hz

STRONGEST = 0.2
"""Largest share of full drive of a pull; chosen: 0.4 N m of a servo that stalls at 2 N m, which a
hand overcomes without effort."""

_log = logging.getLogger(__name__)


class SO101MotionLeader(SO101Device, Teleoperator):
    """An arm that is guided by hand."""

    config_class = SO101MotionLeaderConfig
    name = "so101_motion_leader"
    stock_folder = Path(TELEOPERATORS) / "so_leader"

    def __init__(self, config: SO101MotionLeaderConfig) -> None:
        if not 0.0 <= config.guard_hint <= STRONGEST:
            raise ConfigError("guard_hint", config.guard_hint, f"must be 0 to {STRONGEST:g}")
        super().__init__(config)
        self._asked: Future[None] | None = None

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
        """Read the joints that the hand moves; with ``guard_hint`` also pull them."""
        try:
            here = self.session.here
            if self.config.guard_hint > 0.0:
                self._hint()
            return here
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

    # Hint of the guard

    def _hint(self) -> None:
        """While the guard holds the follower, pull limp joints towards it for a moment."""
        session, follower = self.session, self._follower()
        is_limp = session.state.mode is Mode.LIMP
        if follower is None or not is_limp or not follower.session.held_by:
            return
        if self._asked is not None and not self._asked.done():
            return  # the previous pull has not been sent yet
        try:
            state = follower.session.state
        except So101Error:
            return  # the robot raises it
        stopped = follower.session.units.to_lerobot(state.q_ref, 0.0)
        pull = Pull(
            toward=tuple(self.session.units.from_lerobot(stopped)[0].tolist()),
            share=self.config.guard_hint,
            until=session.rig.clock.now() + HINTED,
        )
        servos = session.rig.servos
        self._asked = session.rig.executor.call(lambda _: servos.pull(pull))
        self._asked.add_done_callback(self._tell)

    def _follower(self) -> SO101Device | None:
        """The one other arm of this program."""
        others = [arm for arm in open_arms() if arm is not self]
        return others[0] if len(others) == 1 else None

    def _tell(self, asked: Future[None]) -> None:
        if error := asked.exception():
            _log.warning("%s does not hint at the guard now: %s", self, error)
