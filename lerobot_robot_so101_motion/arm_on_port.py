"""An arm on a port for robot and leader: open it, read it in LeRobot's units, calibrate it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_so101_motion import calibration
from lerobot_robot_so101_motion.arm_session import ArmSession, Pace, Waiter
from lerobot_robot_so101_motion.endings import Ending
from lerobot_robot_so101_motion.units import JointUnits
from so101_motion.common.errors import So101Error
from so101_motion.drivers.bus.defaults import GRIPPER_ID, SERVO_IDS
from so101_motion.planning.collision.scene import Scene
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.servo_driver import ServoSettings

_log = logging.getLogger(__name__)

_open: list[ArmOnPort] = []


def open_arms() -> tuple[ArmOnPort, ...]:
    """The arms of this program that are open."""
    return tuple(_open)


class ArmOnPort:
    """One arm, open or not.

    Args:
        name: Its name in messages.
        port: Its serial port.
        file: LeRobot's file for its calibration.
        use_degrees: Whether LeRobot's values are degrees, else -100 to 100.
        open_rig: Opens the arm on a port.
        waiter: Waits for a motion; None for the wall clock.
        disconnect: Called at the end of the program if the arm is open then.
    """

    def __init__(
        self,
        name: str,
        *,
        port: str,
        file: Path,
        use_degrees: bool,
        open_rig: Callable[[ServoSettings], HardwareRig],
        waiter: Waiter | None,
        disconnect: Callable[[], None],
    ) -> None:
        self.name = name
        self._port, self._file, self._use_degrees = port, file, use_degrees
        self._open_rig, self._waiter = open_rig, waiter
        self._session: ArmSession | None = None
        self._units: JointUnits | None = None
        self._ending = Ending(disconnect)

    @property
    def is_open(self) -> bool:
        """Whether it is open."""
        return self._session is not None

    @property
    def session(self) -> ArmSession:
        """The session of the open arm.

        Raises:
            DeviceNotConnectedError: It is not open.
        """
        if self._session is None:
            raise DeviceNotConnectedError(f"{self.name} is not connected. Run `.connect()` first.")
        return self._session

    @property
    def units(self) -> JointUnits:
        """LeRobot's units for this arm; only after ``open``."""
        assert self._units is not None
        return self._units

    @property
    def here(self) -> dict[str, float]:
        """The measured joint values in LeRobot's units, by key.

        Raises:
            So101Error: The arm cannot be reached; the message says why.
        """
        state = self.session.state
        aperture = min(max(self.session.rig.gripper.aperture, 0.0), 1.0)
        return self.units.to_lerobot(state.q, aperture)

    def open(
        self, pace: Pace, scene: Scene, *, is_calibrated: bool, compensates: bool = True
    ) -> None:
        """Open it; the joints hold their positions.

        Args:
            pace: Caps and guard while it follows.
            scene: The obstacles around it.
            is_calibrated: Whether there is a calibration file; the log says if not.
            compensates: Whether to compensate weight, friction and lag.

        Raises:
            DeviceAlreadyConnectedError: It is open.
            ConnectionError: It cannot be reached; the message says why.
        """
        if self.is_open:
            raise DeviceAlreadyConnectedError(f"{self.name} is already connected.")
        file = self._file
        settings = ServoSettings(
            port=self._port,
            servo_ids=SERVO_IDS,
            gripper_id=GRIPPER_ID,
            calibration_file=file if file.is_file() else None,
            fallback_file=file,
            compensates=compensates,
        )
        try:
            rig = self._open_rig(settings)
        except So101Error as error:
            raise ConnectionError(f"{self.name} cannot be opened: {error}") from error
        try:
            self._session = ArmSession(rig, pace, scene, waiter=self._waiter)
            self._learn_units()
        except BaseException:
            rig.close()
            raise
        _open.append(self)
        self._ending.attend()
        if not is_calibrated:
            sources = {setup.source for setup in rig.servos.setups.values()}
            _log.warning(
                "%s has no calibration file (%s); the values in its servos are used%s",
                self.name,
                file,
                ", and defaults where those are not valid" if "defaults" in sources else "",
            )

    def close(self) -> None:
        """Close the port; the servos stay held or limp as they are. May be called twice."""
        session, self._session = self._session, None
        self._ending.leave()
        if session is not None:
            _open.remove(self)
            session.close()

    def calibrate(self) -> None:
        """Calibrate it with the help of a person; see ``calibration.calibrate``."""
        self.session.rest()
        calibration.calibrate(self._port, self._file, name=self.name, open_rig=self._open_rig)
        self._learn_units()

    def set_up_motors(self) -> None:
        """Give its motors their ids with the help of a person."""
        calibration.set_up_motors(self._port, self._file, self._open_rig)

    def _learn_units(self) -> None:
        self._units = JointUnits(self.session.rig, use_degrees=self._use_degrees)
