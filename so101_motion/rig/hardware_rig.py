"""Open arms and grippers on a serial port; share a port between components.

A serial port has one rig, however many components use it and by whatever name; each component holds
a ``HardwareRig``, and closing the last of them closes the port.

``open_hardware`` waits for the servos. ``open_without_waiting`` is for an event loop: the port's
own thread looks for the servos until they answer, and says meanwhile why they do not.
"""

from __future__ import annotations

import atexit
import logging
import threading
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial
from pathlib import Path

from so101_motion.calib.procedure.eeprom import write_calibration
from so101_motion.calib.record import lerobot, store
from so101_motion.common import interrupts
from so101_motion.common.clock import Clock, MonotonicClock
from so101_motion.common.errors import BusError, CalibrationError, ConfigError, NotReady
from so101_motion.drivers.bus.defaults import GRIPPER_ID, SERVO_IDS
from so101_motion.drivers.port.serial_port import PortOpener
from so101_motion.rig.bus_lease import BusLease
from so101_motion.rig.port_settings import NO_FILE, ServoSettings
from so101_motion.rig.protocols import ArmConnection
from so101_motion.rig.rig import Rig
from so101_motion.rig.shared_port import SharedPort

_log = logging.getLogger(__name__)


class HardwareRig(Rig):
    """One component's share of the rig of a serial port. ``open_hardware`` makes them.

    Attributes:
        servos: The servos; some of its methods may be called from any thread.
        first_try: Done when the servos have been looked for once, found or not.
        held: Whether any servo held its joint when this share was closed; None if none answered.
    """

    def __init__(self, shared: SharedPort, asked: ServoSettings) -> None:
        # It shares the parts of a rig instead of making them.
        self._shared, self._asked = shared, asked
        shared.shares.append(asked)
        self.servos, rig = shared.servos, shared.rig
        self.clock, self.executor = rig.clock, rig.executor
        self.arm, self.gripper, self.planner = rig.arm, rig.gripper, rig.planner
        self.first_try: Future[None] = Future()
        self.first_try.set_result(None)
        self._lease: BusLease | None = None
        self._closed = False
        self.held: bool | None = None

    @property
    def users(self) -> int:
        """How many rigs of this process share the servos."""
        return len(self._shared.shares)

    @property
    def not_ready(self) -> str | None:
        """Why the servos cannot be used yet; None once they have been found; never waits."""
        return self._shared.not_ready(self._asked)

    def require_ready(self) -> None:
        """Raise ``NotReady`` unless the servos have been found; it names the silent ones."""
        reason = self.not_ready
        if reason is not None:
            raise NotReady(reason)

    def look_again(self) -> Future[None]:
        """Set up what could not be: servos that did not answer, settings that came in a motion.

        Returns:
            Done when they have been looked for, found or not.
        """
        return self._shared.set_up_soon(self._asked)

    @property
    def last_failure(self) -> Path | None:
        """The file with the second before the last failure; None if nothing has failed."""
        return self._shared.failures.latest

    @property
    def uncalibrated(self) -> tuple[str, ...]:
        """The joints that were never calibrated, so that their angles are guesses."""
        setups = self.servos.setups
        return tuple(joint for joint, setup in setups.items() if setup.is_guessed(joint))

    @property
    def has_file(self) -> bool:
        """Whether the calibration of any joint is from a file."""
        return any(setup.source == "file" for setup in self.servos.setups.values())

    @property
    def connection(self) -> ArmConnection:
        problem = None
        if not self.servos.is_connected:
            problem = (
                self.not_ready
                or self.arm.state.fault
                or "the port is not there; plug the adapter in again"
            )
        return ArmConnection(
            to=f"arm on {self.settings.port}",
            problem=problem,
            encoder_zeros=self.servos.encoder_zeros,
        )

    def warm_up(self) -> None:
        """Start the planning process in the background, so that the first plan comes quickly.

        This waits until the servos have been looked for: a process that is just starting holds
        every file that is open here, so the port would seem to be in use by another program.
        """
        rig = self._shared.rig
        self.first_try.add_done_callback(lambda _: rig.warm_up())

    @property
    def settings(self) -> ServoSettings:
        """The port and the servos, as they were opened."""
        return self.servos.settings

    def is_on(self, port: str) -> bool:
        """Whether its servos are on a port, whatever link names it."""
        return self._shared.is_on(port)

    def reload(self) -> None:
        """Load the calibration again, from the file or the servos; the arm stays where it is.

        If something moves, or the servos cannot be set up, it raises and all is as before.
        """
        with _hardware_lock:
            self._shared.rebuild(self.servos.settings)

    def drive(self) -> None:
        """Ask for the arm's servos, if this share only looks at them; they hold where they are."""
        with _hardware_lock:
            looks = self._asked
            if not looks.required():
                self._shared.replace(looks, looks.with_arm(SERVO_IDS))
                self._asked = looks.with_arm(SERVO_IDS)

    def write_calibration(self) -> Path | None:
        """Store the calibration file in the servos for good; see ``eeprom.write_calibration``.

        Returns the version that has what they held before. Raises ``CalibrationError`` if there is
        no file, or what they held cannot be kept.
        """
        file = self._asked.file or self.settings.file
        if file is None:
            raise CalibrationError(None, "no calibration file is configured", "configure one")
        stored = store.load(file)
        lease = self.lend_bus("writing the calibration")
        try:
            kept = lease.call(partial(write_calibration, stored=stored))
        except BaseException:
            lease.abandon()
            raise
        lease.give_back(hold=None)
        return kept

    def lend_bus(self, purpose: str) -> BusLease:
        """Borrow the bus for a ``purpose``, which errors name; see ``BusLease``.

        Raises ``MotionError`` if something moves, or the bus is lent already.
        """
        lease = BusLease(
            self.executor,
            self.servos,
            self.clock,
            purpose=purpose,
            returned=self._shared.take_ranges,
        )
        self._lease = lease
        return lease

    @interrupts.held()
    def close(self) -> None:
        """Give up this share; the last one closes the port. May be called twice.

        A bus lent by this share goes back first. If it is the last share, the servos stay as the
        borrower left them, and else it does as ``at_end`` says.
        """
        if not self._closed and self.users == 1 and self._lease is None:
            self.leave()
        with _hardware_lock:
            if self._closed:
                return
            self._closed, self.held = True, self.servos.holds
            is_last = self._shared.leave(self._asked)
        # Outside the lock: the arm may have to come to rest, and others open other ports meanwhile.
        if is_last:
            self._shared.close()
            with _hardware_lock:
                _hardware.remove(self._shared)
                _hardware_lock.notify_all()
        elif self._lease is not None:
            self._lease.abandon()


def open_hardware(
    settings: ServoSettings | str,
    *,
    clock: Clock | None = None,
    reply_timeout: float | None = None,
    open_port: PortOpener | None = None,
) -> HardwareRig:
    """Open the arm and gripper on a serial port; opening moves nothing.

    Several may be opened on one port: they share it, and their settings must agree, except for the
    calibration file and the timeout (``port_settings.combined``). As long as none
    asks for a servo, servos may be missing and nothing is driven: that is for ``lend_bus``.

    The first user of a port decides ``clock``, ``reply_timeout`` and ``open_port``.

    Args:
        settings: The port, and the settings asked of it; or the port of a whole arm. Without a
            calibration file, the saved one that agrees with the servos is used, else their own.
        clock: The rig's clock; the real time by default.
        reply_timeout: How long to wait for an answer beyond the time on the wire [s]; by default
            as long as the period of the setpoints allows.
        open_port: Opens the port, if it is not an ordinary serial port.

    Raises:
        ConfigError: Another component uses the port with other settings.
        BusError: The port cannot be opened, or a servo that is asked for does not answer.
    """
    if isinstance(settings, str):
        settings = ServoSettings(port=settings, servo_ids=SERVO_IDS, gripper_id=GRIPPER_ID)
    finds = settings.calibration_file is None and settings.fallback_file is None
    settings = replace(settings, finds_file=finds)
    return _open(settings, clock, reply_timeout, open_port, waits=True)


def open_so101(
    port: str, calibration: str | Path | None = None, *, clock: Clock | None = None
) -> HardwareRig:
    """Open a whole SO-101, arm and gripper, on a serial port; opening moves nothing.

    Args:
        port: The serial port.
        calibration: A file, or the name that LeRobot knows the arm by (``--robot.id``); None for
            the saved file that agrees with the servos, else their own.
        clock: As for ``open_hardware``, which raises further errors.

    Raises:
        ConfigError: There is no such calibration.
        CalibrationError: It cannot be used.
    """
    file = None if calibration is None else Path(calibration)
    if file is not None and not file.is_file():
        if file.parent != Path():
            raise ConfigError("calibration", str(file), "is not a file")
        file = lerobot.path_for(str(calibration))
        if not file.is_file():
            raise ConfigError(
                "calibration", str(calibration), f"is not a file, nor is {file}, LeRobot's"
            )
    if file is not None:
        store.load(file)  # a rig goes on without a file that it cannot use; this one was named
    settings = ServoSettings(
        port=port, servo_ids=SERVO_IDS, gripper_id=GRIPPER_ID, calibration_file=file
    )
    rig = open_hardware(settings, clock=clock)
    if not rig.has_file:
        _log.warning("%s", NO_FILE)
    return rig


def open_without_waiting(settings: ServoSettings) -> HardwareRig:
    """Like ``open_hardware``, but return before the servos have been found.

    The port's thread looks for them every second and then holds them where they stand. Until then
    ``HardwareRig.not_ready`` says why, and methods that need them raise.
    """
    return _open(settings, waits=False)


def _open(
    settings: ServoSettings,
    clock: Clock | None = None,
    reply_timeout: float | None = None,
    open_port: PortOpener | None = None,
    *,
    waits: bool,
) -> HardwareRig:
    with _hardware_lock:
        while (shared := use_of(settings.port)) is not None and shared.is_closing:
            _hardware_lock.wait()
        if shared is None:
            clock = clock or MonotonicClock()
            try:
                shared = SharedPort(settings, clock, reply_timeout, open_port, waits=waits)
            except BusError as error:
                if settings.port in str(error):
                    raise
                raise error.about(settings.port) from error
            _hardware.append(shared)
        elif waits:
            shared.admit(shared.join(settings))
        else:
            shared.servos.settings = shared.join(settings)
        rig = HardwareRig(shared, settings)
        if not waits:
            rig.first_try = shared.set_up_soon(settings)
        return rig


def use_of(port: str) -> SharedPort | None:
    """How this process uses a port, by any of its names; None if it does not. Never waits."""
    return next((shared for shared in tuple(_hardware) if shared.is_on(port)), None)


_hardware_lock = threading.Condition()
_hardware: list[SharedPort] = []


def leave_arms_at_end() -> None:
    """Leave every arm as it is configured to be left when the process ends, all at once.

    An arm that cannot be reached, or cannot go where it should, holds; the log says so.
    """
    with ThreadPoolExecutor(thread_name_prefix="so101-end") as beside:
        wait([beside.submit(live.leave_as_configured) for live in tuple(_hardware)])


@atexit.register
def _close_all() -> None:
    for live in tuple(_hardware):
        if live.servos.settings.at_end == "release":  # no thread can be started for a motion now
            live.leave_as_configured()
    for live in tuple(_hardware):
        live.close()
