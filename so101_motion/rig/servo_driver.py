"""Drive the servos of one port with their calibration, and report their health.

``ServoDriver`` is the ``JointDriver`` of a real arm. ``FeetechArm`` talks to the servos; this file
decides how ticks become angles (by the calibration file, else the servos' registers, else
defaults), which servos must answer, and when a joint has an alarm. All of it can be decided again
while the arm is held (``rebuild``), when the calibration file has changed or another component
joins. It runs on the I/O thread, like every driver.

While no component asks for a servo, or the bus is lent, a ``BusMonitor`` has the port: nothing is
driven, and reading goes on as far as servos answer.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import replace

import numpy as np

from so101_motion.calib.record.record import JOINTS, JointCalibration
from so101_motion.calib.record.zero import encoder_zeros
from so101_motion.common.clock import Clock
from so101_motion.common.compliance import Compliance, Wall
from so101_motion.common.encoder_zeros import EncoderZeros
from so101_motion.common.errors import BusError, NotHolding, NotReady, PortUnavailable
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT, JointReading
from so101_motion.common.units import to_rad
from so101_motion.drivers.bus.bus import REPLY_TIMEOUT, RETRIES, Bus, Port
from so101_motion.drivers.bus.reply_counters import ReplyCounters
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.command_record import CommandListener
from so101_motion.drivers.feetech.feetech_arm import FeetechArm
from so101_motion.drivers.feetech.gravity_compensation import Gravity
from so101_motion.drivers.feetech.hand_pull import Pull
from so101_motion.drivers.feetech.health import JointHealth
from so101_motion.drivers.feetech.presence import missing_servos
from so101_motion.drivers.feetech.servo_judgement import alarms, let_go, share_of_speed
from so101_motion.drivers.feetech.servo_model import ServoModel
from so101_motion.drivers.port.serial_port import PortOpener
from so101_motion.planning.timing.torque import Drive
from so101_motion.rig.bus_monitor import BusMonitor
from so101_motion.rig.joint_setup import JointSetup, JointSetups, find_joints
from so101_motion.rig.port_settings import ServoSettings

RETRY_PERIOD = 1.0
"""Servos that could not be set up are tried again after this time [s]. Chosen: a try in which no
servo answers takes 0.02 s."""


SPEED_CAP = to_rad(220.0)
"""Speed cap in the servos' registers [rad/s]: plans never exceed 180 deg/s, and a joint must be
able to catch up; the jaw is planned with 220."""

ACCELERATION_CAP = to_rad(1000.0)
"""Acceleration cap in the servos' registers [rad/s^2]: twice the largest that is planned."""

JAW_DRIVE = 0.5
"""Largest share of its drive that the jaw may use, as in LeRobot: a jaw that closes on something
stiff must not overload itself. Used for long it would heat the fitted servo by 120 K; but a jaw
that falls 0.08 rad behind yields, and then presses with a fifth (``arm/gripper.py``)."""

_PATIENT, _GLANCE = 1 + RETRIES, 2
"""How often silent servos are asked in the first try, and in one after it. Chosen: a try without
any servo takes 0.02 s, which a stop or the end of the process may have to wait for; the next comes
a second later. The first takes 0.25 s, once."""

__all__ = ["ServoDriver", "ServoSettings"]

_log = logging.getLogger(__name__)

_PATIENCE = 1.0  # [s] for servos that were known before the bus was lent; chosen
_LOOK_PERIOD = 0.1  # [s], how often the servos' figures change


class ServoDriver:
    """The servos of one port; fits ``JointDriver``.

    Until ``connect``, ``find`` or a later ``read`` has set them up every use raises ``NotReady``;
    but ``read`` returns ``no_reading`` as long as they have not been looked for.

    ``gravity`` is the torque that holds a pose, shapes (6,), [rad] to [N m], ``per_kg`` what each
    kilogram in the hand adds to it. ``open_port`` opens the port, even if its adapter has another
    name by now. ``reply_timeout`` is as in ``Bus``.

    Attributes:
        settings: The settings that components ask for; may be set.
        in_force: The settings with which the servos were set up last.
        setups: Calibration by joint, for every joint that has a servo.
        notes: What the user should know about the calibration.
        on_command: Called on the I/O thread with every command as it is sent; None for nothing.
        speed_share: The share of its speed that the arm should use, as of the last ``read``.
        no_reading: The result of ``read`` before any servo was asked; its angles mean nothing.
        is_found: Whether they have been set up since they were asked for.
        on_found: Called on the I/O thread when a ``read`` has set the servos up for the first
            time since they were asked for; not called when ``connect`` has.
    """

    def __init__(
        self,
        settings: ServoSettings,
        clock: Clock,
        *,
        gravity: Gravity,
        per_kg: Gravity,
        reply_timeout: float = REPLY_TIMEOUT,
        open_port: PortOpener | None = None,
    ) -> None:
        self._clock = clock
        self.settings = self.in_force = settings
        self.setups: Mapping[str, JointSetup] = {}
        self.notes: tuple[str, ...] = ()
        self.on_command: CommandListener | None = None
        self._told: CommandListener | None = None  # what the present arm has been given
        self.speed_share = 1.0
        self._losses = 0  # of arms and monitors before the present one
        self._alarms: Mapping[str, str] = {}
        self._gone: frozenset[str] = frozenset()  # joints whose servos have switched off
        self._look_due = clock.now()
        self._open_port = open_port or PortOpener(settings.port, settings.baudrate)
        self._reply_timeout, self._gravity, self._per_kg = reply_timeout, gravity, per_kg
        self._tallies = ReplyCounters()
        self._arm: FeetechArm | None = None
        self._monitor: BusMonitor | None = None
        self._is_lent = False
        self.on_found: Callable[[], None] | None = None
        self._look_anew()

    def _look_anew(self) -> None:
        self.no_reading = self._last = JointReading(
            q=np.zeros(5), qd=np.zeros(5), q_jaw=0.0, qd_jaw=0.0
        )
        self.is_found = self._is_asked = False
        self._why: BusError | None = None  # they were not found at the last try
        self._begun = self._try_due = self._clock.now()

    def probe(self) -> None:
        """Raise ``PortUnavailable`` if the port cannot be opened; asks no servo."""
        self._open_port().close()

    def connect(self) -> None:
        """Find the servos and set them up; waits ``settings.timeout`` for silent ones.

        Raises ``BusError`` if the port cannot be opened, or a required servo cannot be set up.
        """
        self._begin(self.settings, self.settings.timeout or 0.0)

    def monitor_only(self, settings: ServoSettings | None = None) -> None:
        """Only monitor the servos that answer; for use instead of ``connect``."""
        now = settings or self.settings
        self._open_port.baud = now.baudrate
        self._monitor = BusMonitor(
            self._open_port, self._clock, ids=now.ids(), reply_timeout=self._reply_timeout
        )

    def require(self, joints: Collection[str]) -> None:
        """Raise ``BusError`` unless the servos of ``joints`` answer; it must be closed."""
        with self._bus_for(self.settings) as bus:
            _require(bus, self.settings, joints)

    def forget(self) -> None:
        """Close the port; ``find`` opens it again and looks for the servos of ``settings``."""
        self.close()
        self._look_anew()

    def find(self) -> None:
        """Find the servos and set them up now, or, if that fails, with one of the next reads.

        Raises ``NotReady`` if some that are asked for do not answer.
        """
        if self._monitor is None:
            self._driver()
        else:
            self._take_note(self._monitor)

    # What a driver does

    def read(self) -> JointReading:
        """Measure all joints; see ``FeetechArm.read``. Raises ``NotReady`` before they were found.

        While the servos are only monitored nothing is raised: a joint whose servo does not answer
        keeps its last angle, or 0.
        """
        if self._monitor is None and self._arm is None and not self.settings.required():
            self.monitor_only()  # whoever asked for servos left before they were found
        if self._monitor is not None:
            reading = self._last = self._seen(self._monitor)
        elif self._arm is None and not self._is_asked:
            return self.no_reading
        else:
            reading = self._driver().read()
        now = self._clock.now()
        if now >= self._look_due:
            self._look_due = now + _LOOK_PERIOD
            health = self.health
            self._alarms, self._gone = alarms(health), let_go(health)
            self.speed_share = share_of_speed(health)
        if not self._alarms:
            return reading
        return replace(reading, alarms=self._alarms, let_go=self._gone)

    def write(
        self,
        q_cmd: Array,
        q_jaw_cmd: float,
        qd_cmd: Array | None = None,
        qdd_cmd: Array | None = None,
        follows_target: bool = False,
        room: float = 0.0,
    ) -> None:
        self._driver().write(q_cmd, q_jaw_cmd, qd_cmd, qdd_cmd, follows_target, room)

    def set_torque(self, on: bool) -> None:
        if self._monitor is not None and not on:
            self._monitor.let_go()
        else:
            self._driver().set_torque(on)

    def guide(self, compliance: Compliance | None, wall: Wall | None = None) -> None:
        self._driver().guide(compliance, wall)

    def pull(self, pull: Pull) -> None:
        self._driver().pull(pull)

    def close(self) -> None:
        """Close the port; the servos stay as they are."""
        arm, self._arm = self._arm, None
        monitor, self._monitor = self._monitor, None
        for user in (arm, monitor):
            if user is not None:
                self._losses += user.port_losses
                user.close()

    # What else can be asked, on the I/O thread

    def rebuild(self, settings: ServoSettings) -> None:
        """Set the servos up again with ``settings``; if that fails (``BusError``), go on as before.

        Angles may mean something else afterwards, so use it with ``Executor.call_and_rehold``.
        """
        if self._arm is not None and self._arm.is_connected:  # to learn it while all still works
            _require(self._bus(self._arm.bus.port, settings), settings, settings.required())
        before = self.in_force
        self.close()
        try:
            self._begin(settings, 0.0)  # the I/O thread must not wait
        except BusError:
            self._begin(before, 0.0)
            raise

    # Lending the bus, on the I/O thread

    def lend(self) -> None:
        """Lend the bus: leave the servos as they are, and monitor them."""
        self.close()
        self._is_lent = True
        self.monitor_only()

    @property
    def lent(self) -> BusMonitor:
        """The bus while it is lent, for the borrower; on the port's thread."""
        assert self._monitor is not None, "the bus has not been lent"
        return self._monitor

    def take_back(self, *, hold: bool) -> None:
        """Set the servos up again after a lease, with the present settings.

        To ``hold`` the joints next is possible even if no component asks for them. Joints that were
        known are then waited for, and left out if they stay silent. What raises ``BusError`` is
        tried again with each ``read``.
        """
        self._is_lent = False
        known, now = self.known, self.settings
        timeout = now.timeout or 0.0
        self.close()
        if hold:
            with self._bus_for(now) as bus:
                found = find_joints(
                    bus, now, now.required(), timeout=max(timeout, _PATIENCE), expected=known
                )
            self._arm = self._build(now, found)
        else:
            self._begin(now, timeout)

    def set_torque_limit(self, joint: str, share: float) -> None:
        """Let ``joint`` use at most ``share``, 0 to 1, of its motor's drive."""
        self._driver().set_torque_limit(joint, share)

    @property
    def bus(self) -> Bus:
        return self._driver().bus

    # What any thread may ask

    @property
    def health(self) -> tuple[JointHealth, ...]:
        user = self._arm or self._monitor
        return user.health if user is not None else ()

    @property
    def models(self) -> Mapping[str, ServoModel]:
        """The models of the servos that this program drives, by joint."""
        models = self._arm.models if self._arm is not None else ()
        return dict(zip(JOINTS, models, strict=False))

    @property
    def drive(self) -> Drive | None:
        """What the servos can do now and what they carry; None unless the whole arm is known."""
        arm = self._arm
        if arm is None or not all(joint in self.setups for joint in ARM_JOINTS):
            return None
        trim, volts = arm.trim, min(each.volts for each in arm.models[: len(ARM_JOINTS)])
        rows = [trim.drive(i) for i in range(len(ARM_JOINTS))]
        stall, fastest, friction, growth = zip(*rows, strict=True)
        return Drive(stall, fastest, friction, growth, volts, max(trim.carried, 0.0))

    @property
    def has_port(self) -> bool:
        """Whether the port is open, whichever servos answer."""
        why = self._why
        return self.is_connected or not (why is None or isinstance(why, PortUnavailable))

    @property
    def why_not_found(self) -> str | None:
        """Why the servos cannot be used yet; None once they have been set up."""
        if self.is_found:
            return None
        if self._why is None:
            return "the servos have not been looked for yet; try again"
        tried = self._clock.now() - self._begun
        return f"{self._why} (tried for {tried:.0f} s; it goes on trying every second)"

    @property
    def is_connected(self) -> bool:
        user = self._arm or self._monitor
        return user is not None and user.is_connected

    @property
    def is_ours(self) -> bool:
        """Whether this program drives the servos, or may."""
        return self._monitor is None

    @property
    def is_driving(self) -> bool:
        """Whether this program drives the servos and the torque of one of them is on."""
        return self._arm is not None and self._arm.is_driving

    @property
    def known(self) -> tuple[str, ...]:
        """The joints whose servos were found when the port was set up, or answered since."""
        return tuple(j for j in JOINTS if j in self.setups or j in self.positions)

    @property
    def limp(self) -> tuple[str, ...]:
        """The joints, of an arm that this program drives, whose torque is off; base to jaw."""
        return self._arm.limp if self._arm is not None else ()

    @property
    def holds(self) -> bool | None:
        """Whether any servo holds its joint, ours or not; None if none answers."""
        if self._monitor is None:
            return self.is_driving if self.is_connected else None
        driven = bool(self._monitor.driven)
        return driven if driven or self._monitor.positions else None

    @property
    def positions(self) -> Mapping[str, int]:
        """Positions of the servos that answer while they are only monitored [tick], by joint."""
        return self._monitor.positions if self._monitor is not None else {}

    @property
    def port_losses(self) -> int:
        """How often the port went away."""
        user = self._arm or self._monitor
        return self._losses + (user.port_losses if user is not None else 0)

    @property
    def calibration(self) -> dict[str, JointCalibration]:
        return {joint: setup.calibration for joint, setup in self.setups.items()}

    @property
    def encoder_zeros(self) -> EncoderZeros | None:
        """The zeros of the calibration in use, with configured ones; None before they are known."""
        if not self.setups:
            return None
        return encoder_zeros(self.calibration, {j: setup.zero for j, setup in self.setups.items()})

    def to_ticks(self, joint: str, q: float) -> int:
        """The servo position that ``joint`` has at angle ``q`` [rad]."""
        return self.setups[joint].map.to_ticks(q)

    def to_angle(self, joint: str, ticks: int) -> float:
        """The angle of ``joint`` at a servo position [rad]."""
        return self.setups[joint].map.to_rad(Ticks(ticks))

    # How

    def _begin(self, settings: ServoSettings, timeout: float) -> None:
        """Drive the servos, or only monitor them if no component asks for any."""
        with self._bus_for(settings) as bus:
            found = find_joints(bus, settings, settings.required(), timeout=timeout)
        if settings.required():
            self._arm = self._build(settings, found)
        else:
            self._take(settings, found)
            self.monitor_only(settings)

    @contextmanager
    def _bus_for(self, settings: ServoSettings) -> Iterator[Bus]:
        """Open the port to find servos on it, before a driver opens it."""
        self._open_port.baud = settings.baudrate  # from now on, for drivers as well
        with closing(self._bus(self._open_port(), settings)) as bus:
            yield bus

    def _bus(self, port: Port, settings: ServoSettings) -> Bus:
        names = {servo_id: joint for joint, servo_id in settings.ids().items()}
        return Bus(port, names=names, reply_timeout=self._reply_timeout)

    def _seen(self, monitor: BusMonitor) -> JointReading:
        monitor.look()
        newcomers = monitor.positions.keys() - self.setups.keys()
        if newcomers and not self._is_lent:  # somebody has switched the arm on
            with suppress(BusError):
                self._take_note(monitor)
        q = [*self._last.q, self._last.q_jaw]
        for joint, ticks in monitor.positions.items():
            setup = self.setups.get(joint)
            q[JOINTS.index(joint)] = (setup.map if setup else JointMap(servo_id=0)).to_rad(ticks)
        return replace(
            self._last, q=np.array(q[:5]), q_jaw=float(q[5]),
            driven=monitor.driven, silent=monitor.silent,
        )  # fmt: skip

    def _take_note(self, monitor: BusMonitor) -> None:
        now = self.settings
        with monitor.bus() as bus:
            self._take(now, find_joints(bus, now, now.required()))

    def _driver(self) -> FeetechArm:
        if self._monitor is not None:
            raise NotHolding(
                f"no component uses the arm on {self.settings.port}; configure an arm or a gripper"
                " with this port"
            )
        if self._arm is None:
            self._arm = self._found()
        if self._told is not self.on_command:  # any thread may have set it
            self._arm.on_command = self._told = self.on_command
        return self._arm

    def _found(self) -> FeetechArm:
        """Try to find the servos, if a try is due; does not wait, because the I/O thread must not.

        The first try is patient: nothing is driven yet. A jaw that does not answer is left out.
        """
        settings, now, is_first = self.settings, self._clock.now(), not self.is_found
        if now < self._try_due:
            if is_first:
                raise NotReady(str(self.why_not_found)) from self._why
            raise PortUnavailable(
                settings.port,
                "the servos could not be set up again yet; check the USB cable and the arm's"
                " power. It goes on trying every second",
            )
        tries, self._is_asked = _GLANCE if self._is_asked else _PATIENT, True
        self._try_due = now + RETRY_PERIOD
        required = ARM_JOINTS if settings.servo_ids is not None else settings.required()
        try:
            with self._bus_for(settings) as bus:
                _require(bus, settings, required, tries=tries)
                found = find_joints(bus, settings, required)
            arm = self._build(settings, found)
        except BusError as error:
            if not is_first:
                raise
            self._why = error
            raise NotReady(str(self.why_not_found)) from error
        if is_first and self.on_found is not None:
            self.on_found()
        return arm

    def _build(self, settings: ServoSettings, found: JointSetups) -> FeetechArm:
        arm = FeetechArm(
            self._open_port,
            self._clock,
            {joint: setup.map for joint, setup in found.setups.items()},
            gravity=self._gravity,
            per_kg=self._per_kg,
            speed=SPEED_CAP,
            acceleration=ACCELERATION_CAP,
            reply_timeout=self._reply_timeout,
            counters=self._tallies,
            figures=found.figures,
            compensates=settings.compensates is not False,
        )
        try:
            if GRIPPER_JOINT in found.setups:
                arm.set_torque_limit(GRIPPER_JOINT, JAW_DRIVE)
        except BusError:
            arm.close()
            raise
        self._take(settings, found)
        self._told = None
        return arm

    def _take(self, settings: ServoSettings, found: JointSetups) -> None:
        known = self.notes  # a motor setup gives the bus back again and again
        self.in_force, self.setups, self.notes = settings, found.setups, found.notes
        self.is_found = self._is_asked = True
        self._why = None
        for note in found.notes:
            if note not in known:
                _log.warning("%s", note)


def _require(
    bus: Bus, settings: ServoSettings, joints: Collection[str], *, tries: int = _PATIENT
) -> None:
    """Raise ``NoReply`` unless all ``joints`` answer; ``tries`` as in ``Bus.answering``."""
    ids = settings.ids()
    answering = bus.answering(ids.values(), tries=tries)
    missing = [ids[joint] for joint in joints if ids[joint] not in answering]
    if missing:
        raise missing_servos(bus, missing, answering)
