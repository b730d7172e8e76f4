"""Find the servos on a port and make a driver for them."""

from __future__ import annotations

from collections.abc import Collection

from so101_motion.arm.gripper import JAW_CLOSED
from so101_motion.common.clock import Clock
from so101_motion.common.errors import BusError
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.common.units import to_rad
from so101_motion.drivers.bus.bus import RETRIES, Bus, Port
from so101_motion.drivers.bus.reply_counters import ReplyCounters
from so101_motion.drivers.command_record import CommandListener
from so101_motion.drivers.feetech.feetech_arm import FeetechArm
from so101_motion.drivers.feetech.gravity_compensation import Gravity
from so101_motion.drivers.feetech.presence import missing_servos
from so101_motion.drivers.port.serial_port import PortOpener
from so101_motion.rig.bus_monitor import BusMonitor
from so101_motion.rig.joint_setup import JointSetups, find_joints
from so101_motion.rig.port_settings import ServoSettings

SPEED_CAP = to_rad(220.0)
"""Speed cap in the servos' registers [rad/s]: plans never exceed 180 deg/s, and a joint must be
able to catch up; the jaw is planned with 220."""

ACCELERATION_CAP = to_rad(1000.0)
"""Acceleration cap in the servos' registers [rad/s^2]: twice the largest that is planned."""

JAW_DRIVE = 0.5
"""Largest share of its drive that the jaw may use, as in LeRobot: a jaw that closes on something
stiff must not overload itself. Used for long it would heat the fitted servo by 120 K; but a jaw
that falls 0.08 rad behind yields, and then presses with a fifth (``arm/gripper.py``)."""

_GLANCE = 2
"""How often silent servos are asked in one try after the first. Chosen: a try without any servo
takes 0.02 s, which a stop or the end of the process may have to wait for; the next comes a second
later. The first takes 0.25 s, once."""


class ServoFinder:
    """Looks for the servos of one port. Used by one thread at a time.

    Args:
        settings: The port and its rate.
        clock: The rig's clock.
        gravity: The torque that holds a pose, shapes (6,), [rad] to [N m].
        per_kg: What each kilogram in the hand adds to it.
        reply_timeout: How long to wait for an answer beyond the time on the wire [s].
        open_port: Opens the port, even if its adapter has another name by now; a ``PortOpener`` by
            default.

    Attributes:
        open_port: As given.
    """

    def __init__(
        self,
        settings: ServoSettings,
        clock: Clock,
        *,
        gravity: Gravity,
        per_kg: Gravity,
        reply_timeout: float,
        open_port: PortOpener | None = None,
    ) -> None:
        self.open_port = open_port or PortOpener(settings.port, settings.baudrate)
        self._clock, self._reply_timeout = clock, reply_timeout
        self._gravity, self._per_kg = gravity, per_kg
        self._tallies = ReplyCounters()

    def find_joints(
        self,
        settings: ServoSettings,
        required: Collection[str],
        timeout: float,
        expected: Collection[str] = (),
    ) -> JointSetups:
        """Find the servos and their calibration, before a driver opens the port.

        Raises:
            BusError: The port cannot be opened, or went away.
        """
        bus = self._bus(self._open(settings), settings)
        try:
            return joints_on(bus, settings, required, timeout, expected)
        finally:
            bus.close()

    def arm(
        self, found: JointSetups, on_command: CommandListener, *, compensates: bool = True
    ) -> FeetechArm:
        """Make the driver of the joints ``found``; ``on_command`` is called for each command.

        Args:
            found: The joints.
            on_command: Called with each command as it is sent.
            compensates: Whether weight, friction and lag are compensated.

        Raises:
            BusError: One of them cannot be reached or set up.
        """
        arm = FeetechArm(
            self.open_port,
            self._clock,
            {joint: setup.map for joint, setup in found.setups.items()},
            gravity=self._gravity,
            per_kg=self._per_kg,
            speed=SPEED_CAP,
            acceleration=ACCELERATION_CAP,
            reply_timeout=self._reply_timeout,
            counters=self._tallies,
            figures=found.figures,
            compensates=compensates,
        )
        arm.on_command = on_command
        try:
            if GRIPPER_JOINT in found.setups:
                arm.set_torque_limit(GRIPPER_JOINT, JAW_DRIVE)
        except BusError:
            arm.close()
            raise
        return arm

    def monitor(self, settings: ServoSettings) -> BusMonitor:
        """Make a monitor that reads the servos without driving them."""
        ids = settings.ids()
        self.open_port.baud = settings.baudrate
        return BusMonitor(self.open_port, self._clock, ids=ids, reply_timeout=self._reply_timeout)

    def look(self, settings: ServoSettings, required: Collection[str], *, is_patient: bool) -> None:
        """Check that all required servos answer.

        Args:
            settings: The servos.
            required: The joints that must answer.
            is_patient: Whether silent servos are waited for as long as a busy computer may keep
                their answers back; otherwise it is a glance.

        Raises:
            PortUnavailable: The port cannot be opened, or went away.
            NoReply: A servo does not answer.
        """
        port = self._open(settings)
        try:
            tries = 1 + RETRIES if is_patient else _GLANCE
            self.require(port, settings, required, tries=tries)
        finally:
            port.close()

    def require(
        self,
        port: Port,
        settings: ServoSettings,
        required: Collection[str],
        *,
        tries: int = 1 + RETRIES,
    ) -> None:
        """Check that all required servos answer; ``tries`` as in ``Bus.answering``.

        Raises:
            NoReply: A servo does not answer.
        """
        bus, ids = self._bus(port, settings), settings.ids()
        answering = bus.answering(ids.values(), tries=tries)
        missing = [ids[joint] for joint in required if ids[joint] not in answering]
        if missing:
            raise missing_servos(bus, missing, answering)

    def _open(self, settings: ServoSettings) -> Port:
        self.open_port.baud = settings.baudrate  # from now on, for drivers as well
        return self.open_port()

    def _bus(self, port: Port, settings: ServoSettings) -> Bus:
        names = {servo_id: joint for joint, servo_id in settings.ids().items()}
        return Bus(port, names=names, reply_timeout=self._reply_timeout)


def joints_on(
    bus: Bus,
    settings: ServoSettings,
    required: Collection[str],
    timeout: float,
    expected: Collection[str] = (),
) -> JointSetups:
    """Find the joints of ``settings`` on ``bus``; see ``joint_setup.find_joints``."""
    return find_joints(
        bus,
        settings.ids(),
        required=required,
        expected=expected,
        timeout=timeout,
        file=settings.file,
        may_file_be_missing=settings.may_file_be_missing,
        finds_file=settings.finds_file,
        jaw_closed=JAW_CLOSED,
        zero_offsets=settings.zero_offsets or {},
        joint_zero=settings.joint_zero,
    )
