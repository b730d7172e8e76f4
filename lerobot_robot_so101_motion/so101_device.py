"""The base of robot and leader: one arm on a port, with a calibration file of LeRobot.

LeRobot's commands disconnect after Ctrl-C and after most errors, but not after SIGTERM or an error
before their loop. So while an arm is connected, SIGTERM ends the program as Ctrl-C does, unless the
program has a handler for it; and an arm that is still connected at the exit is disconnected then.
"""

from __future__ import annotations

import atexit
import logging
import signal
import threading
from copy import copy
from pathlib import Path
from types import FrameType
from typing import Any, ClassVar

from lerobot.utils.constants import HF_LEROBOT_CALIBRATION
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_so101_motion import calibration
from lerobot_robot_so101_motion.arm_session import ArmSession, Pace
from lerobot_robot_so101_motion.units import JOINTS, KEYS
from so101_motion.common.errors import So101Error
from so101_motion.drivers.bus.defaults import GRIPPER_ID, SERVO_IDS
from so101_motion.planning.collision.scene import Scene
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.port_settings import ServoSettings
from so101_motion.rig.session_end import wait_in_real_time

_log = logging.getLogger(__name__)

_connected: list[SO101Device] = []


def open_arms() -> tuple[SO101Device, ...]:
    """The arms of this program that are connected."""
    return tuple(_connected)


class SO101Device:
    """One arm as a LeRobot device; inherit it before ``Robot`` or ``Teleoperator``.

    ``open_rig`` opens its port, ``wait`` waits for a motion. ``stock_folder`` is LeRobot's for the
    calibrations of these arms; ours are the same files.
    """

    open_rig = staticmethod(open_hardware)
    wait = staticmethod(wait_in_real_time)
    stock_folder: ClassVar[Path]
    calibration: dict[str, Any]
    calibration_fpath: Path

    def __init__(self, config: Any) -> None:
        if config.calibration_dir is None:
            config = copy(config)
            config.calibration_dir = HF_LEROBOT_CALIBRATION / self.stock_folder
        super().__init__(config)  # type: ignore[call-arg]  # that of LeRobot's class
        self.config = config
        self._session: ArmSession | None = None

    @property
    def session(self) -> ArmSession:
        """The session of the arm; ``DeviceNotConnectedError`` without one."""
        if self._session is None:
            raise DeviceNotConnectedError(f"{self} is not connected. Run `.connect()` first.")
        return self._session

    @property
    def action_features(self) -> dict[str, Any]:
        return dict.fromkeys(KEYS, float)

    @property
    def is_connected(self) -> bool:
        return self._session is not None

    @property
    def is_calibrated(self) -> bool:
        """Whether there is a calibration file of this arm; ``connect`` writes it to the servos."""
        return all(joint in self.calibration for joint in JOINTS)

    def calibrate(self) -> None:
        """Calibrate the arm with the help of a person; see ``calibration.calibrate``."""
        self.session.rest()
        calibration.calibrate(
            self.config.port, self.calibration_fpath, name=str(self), open_rig=self.open_rig
        )
        self.session.learn_units()
        self._load_calibration()  # type: ignore[attr-defined]  # of LeRobot's class

    def setup_motors(self) -> None:
        """Give the motors their ids, one after the other, with the help of a person."""
        calibration.set_up_motors(self.config.port, self.calibration_fpath, self.open_rig)

    def disconnect(self) -> None:
        """Bring the arm to rest and close the port."""
        raise NotImplementedError

    def _begin(self) -> None:
        """Prepare an arm that has just been opened and calibrated."""
        raise NotImplementedError

    def _open(self, pace: Pace, scene: Scene, *, calibrate: bool, compensates: bool = True) -> None:
        """Open the arm, whose joints hold their positions, and prepare it, or leave it closed.

        It is calibrated first as in ``SO101Motion.connect``. ``compensates`` means weight, friction
        and lag. ``DeviceAlreadyConnectedError`` if it is open, ``ConnectionError`` if it cannot be
        reached.
        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        file = self.calibration_fpath
        settings = ServoSettings(
            port=self.config.port,
            servo_ids=SERVO_IDS,
            gripper_id=GRIPPER_ID,
            calibration_file=file if file.is_file() else None,
            fallback_file=file,
            compensates=compensates,
        )
        try:
            rig = self.open_rig(settings)
        except So101Error as error:
            raise ConnectionError(f"{self} cannot be opened: {error}") from error
        try:
            use_degrees = self.config.use_degrees
            self._session = ArmSession(rig, pace, scene, use_degrees, self.wait)
        except BaseException:
            rig.close()
            raise
        _connected.append(self)
        if _may_set_handlers() and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, _end)
        if not self.is_calibrated:
            sources = {setup.source for setup in rig.servos.setups.values()}
            _log.warning(
                "%s has no calibration file (%s); the values in its servos are used%s",
                self,
                file,
                ", and defaults where those are not valid" if "defaults" in sources else "",
            )
        try:
            if calibrate and not self.is_calibrated:
                self.calibrate()
            self._begin()
        except BaseException:
            self._close()
            raise

    def _close(self) -> None:
        """Close the port; the servos stay held or limp as they are. May be called twice."""
        session, self._session = self._session, None
        if session is None:
            return
        _connected.remove(self)
        if not _connected and _may_set_handlers() and signal.getsignal(signal.SIGTERM) is _end:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        session.rig.close()


def _may_set_handlers() -> bool:
    return threading.current_thread() is threading.main_thread()


def _end(number: int, _frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


@atexit.register
def _disconnect_all() -> None:
    for device in open_arms():
        try:
            device.disconnect()
        except Exception as error:  # go on with the other arms
            _log.warning("an arm could not be disconnected properly: %s", error)
