"""An SO-101 that is led by hand, as a teleoperator: ``--teleop.type=so101_motion_leader``.

Its joints are limp while a hand leads it. With torque on it holds, and is driven to where a
follower is, slowly and guarded like any arm: so a person takes over from where the follower stands.

If asked to, it hints at the guard: while the follower of the same program is held off something,
limp joints pull softly towards where it was stopped. LeRobot's own loops send no feedback to a
leader, so it looks for itself, each time it is asked for an action.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from lerobot.teleoperators import Teleoperator
from lerobot.utils.constants import TELEOPERATORS

from lerobot_robot_so101_motion.arm_on_port import ArmOnPort, open_arms
from lerobot_robot_so101_motion.arm_session import REST_WITHIN, Pace
from lerobot_robot_so101_motion.config import SO101MotionLeaderConfig
from lerobot_robot_so101_motion.so101_device import SO101Device
from lerobot_robot_so101_motion.units import KEYS, is_number
from so101_motion.common.errors import ConfigError, So101Error
from so101_motion.common.modes import Mode
from so101_motion.common.units import to_rad
from so101_motion.drivers.feetech.hand_pull import Pull
from so101_motion.planning.collision.scene import Scene

HANDED_OVER = 100.0
"""Cap on the acceleration of a leader that is driven [deg/s^2]; chosen, somebody may hold it."""

DRIVEN_ON = 2.0
"""For how long a leader goes on to the last place it was told [s]; chosen: it may lag behind."""

HINTED = 0.2
"""After how long without a new action a hint of the guard ends [s]; chosen: three at 15 Hz."""

STRONGEST = 0.2
"""Share of full drive that a hint has at most; chosen: 0.4 N m of a servo that stalls at 2 N m,
which a hand overcomes without effort."""

_log = logging.getLogger(__name__)


class SO101MotionLeader(SO101Device, Teleoperator):
    """An arm that leads.

    Args:
        config: Its settings.
        options: As for ``SO101Device``.

    Raises:
        ConfigError: ``guard_hint`` is out of range.
    """

    config_class = SO101MotionLeaderConfig
    name = "so101_motion_leader"
    stock_folder = Path(TELEOPERATORS) / "so_leader"

    def __init__(self, config: SO101MotionLeaderConfig, **options: Any) -> None:
        if not 0.0 <= config.guard_hint <= STRONGEST:
            raise ConfigError("guard_hint", config.guard_hint, f"must be 0 to {STRONGEST:g}")
        super().__init__(config, **options)
        self._asked: Future[None] | None = None

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
        """Where the hand holds the joints; it may feel the guard of the follower then.

        Raises:
            DeviceNotConnectedError: It is not connected.
            ConnectionError: The arm does not answer any more.
        """
        try:
            here = dict(self._arm.here)
            if self.config.guard_hint > 0.0:
                self._hint()
            return here
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

    # How

    def _hint(self) -> None:
        """Pull limp joints towards a follower that is held off something, for a moment."""
        session, follower = self._arm.session, self._follower()
        is_limp = session.state.mode is Mode.LIMP
        if follower is None or not is_limp or not follower.session.held_by:
            return
        if self._asked is not None and not self._asked.done():
            return  # the one before is still being obeyed
        try:
            state = follower.session.state
        except So101Error:
            return  # the robot will say so
        stopped = follower.units.to_lerobot(state.q_ref, 0.0)
        pull = Pull(
            toward=tuple(self._arm.units.from_lerobot(stopped)[0].tolist()),
            share=self.config.guard_hint,
            until=session.rig.clock.now() + HINTED,
        )
        servos = session.rig.servos
        self._asked = session.rig.executor.call(lambda _: servos.pull(pull))
        self._asked.add_done_callback(self._tell)

    def _follower(self) -> ArmOnPort | None:
        """The one other arm of this program."""
        others = [arm for arm in open_arms() if arm is not self._arm]
        return others[0] if len(others) == 1 else None

    def _tell(self, asked: Future[None]) -> None:
        if error := asked.exception():
            _log.warning("%s does not hint at the guard now: %s", self, error)
