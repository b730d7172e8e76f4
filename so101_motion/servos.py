"""The servos of one port as the rig uses them: which, with what calibration, and how they are.

``Servos`` is the ``JointDriver`` of a real arm. The bytes are ``FeetechArm``'s; here is what has to
be decided before those can flow and what the figures mean to the arm:

* what the ticks mean: from the calibration file, else from the servos' registers, else defaults;
* who must be there: an arm's five servos, a gripper's one, and whoever else answers;
* when a joint is in trouble (``alarms``), so that the executor ends its motion and backs off.

All of it can be decided anew while the arm is held (``rebuild``): when the calibration file was
written, or a component joins that asks for more. It runs on the I/O thread, like every driver.

While nobody asks for a servo, or the bus is lent (``lend``), nothing is driven by us: an
``Onlooker`` has the port, and reading goes on as far as servos answer.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

import numpy as np

from so101_motion.alarms import HOT_C, WARM_C, alarms
from so101_motion.calib.record import JOINTS, JointCalibration
from so101_motion.calib.survey import JointSetup, Survey, survey
from so101_motion.clock import Clock
from so101_motion.compliance import Compliance
from so101_motion.drivers.bus import PATIENCE, Bus, Port
from so101_motion.drivers.droop import Gravity
from so101_motion.drivers.feetech_arm import FeetechArm
from so101_motion.drivers.health import JointHealth
from so101_motion.drivers.port import PortOpener
from so101_motion.drivers.presence import not_there
from so101_motion.drivers.tally import Tallies
from so101_motion.drivers.ticks import JointMap, Ticks
from so101_motion.errors import BusError, NotHolding, PortUnavailable
from so101_motion.geometry import Array
from so101_motion.gripper import JAW_CLOSED
from so101_motion.onlooker import Onlooker
from so101_motion.servo_settings import ServoSettings
from so101_motion.state import ARM_JOINTS, GRIPPER_JOINT, JointReading
from so101_motion.units import to_rad

__all__ = ["ServoSettings", "Servos"]

T = TypeVar("T")

_log = logging.getLogger(__name__)

SPEED_CAP = to_rad(220.0)
"""Speed cap the servos keep by themselves [rad/s]: what is planned never exceeds 180 deg/s, and a
joint must be able to catch up; the jaw is planned with 220."""

ACCELERATION_CAP = to_rad(1000.0)
"""Acceleration cap the servos keep by themselves [rad/s^2]: twice the largest that is planned."""

JAW_DRIVE = 0.5
"""Share of its drive the jaw may use at most, as in LeRobot. A jaw that closes on something
stiff must not be able to overload itself."""

_LOOK_PERIOD = 0.1  # [s], how often the servos' figures change


class Servos:
    """The servos of one port; fits ``JointDriver``.

    Args:
        settings: What is asked of them.
        clock: What time it is.
        gravity: The torque that holds a pose, shapes (6,), [rad] to [N m].
        patience: How long to wait for an answer beyond the time on the wire [s].

    Attributes:
        settings: As given, or as of the last ``rebuild``.
        setups: Calibration by joint, for every joint that has a servo.
        notes: What a person should know about the calibration.

    Raises:
        BusError: The port cannot be opened, or a required servo cannot be reached or set up.
    """

    def __init__(
        self,
        settings: ServoSettings,
        clock: Clock,
        *,
        gravity: Gravity,
        patience: float = PATIENCE,
    ) -> None:
        self._clock, self._gravity, self._patience = clock, gravity, patience
        self.settings: ServoSettings = settings
        self.setups: Mapping[str, JointSetup] = {}
        self.notes: tuple[str, ...] = ()
        self._tallies = Tallies()
        self._losses = 0  # of arms before the present one
        self._alarms: Mapping[str, str] = {}
        self._look_due = self._retry_due = clock.now()
        self._opener = PortOpener(settings.port, settings.baudrate)
        self._arm: FeetechArm | None = None
        self._onlooker: Onlooker | None = None
        self._is_lent = False
        self._last = JointReading(q=np.zeros(5), qd=np.zeros(5), q_jaw=0.0, qd_jaw=0.0)
        self._begin(settings)

    # What a driver does

    def read(self) -> JointReading:
        """Measure all joints; see ``FeetechArm.read``.

        While nothing is driven by us nothing is raised: a joint whose servo does not answer stays
        where it was seen last, or at 0.
        """
        if self._onlooker is not None:
            self._last = self._seen(self._onlooker)
            return self._last
        arm = self._driver()
        reading = arm.read()
        now = self._clock.now()
        if now >= self._look_due:
            self._look_due = now + _LOOK_PERIOD
            self._alarms = alarms(arm.health)
        return replace(reading, alarms=self._alarms) if self._alarms else reading

    def write(self, q_cmd: Array, q_jaw_cmd: float, qd_cmd: Array | None = None) -> None:
        """Send the joints to ``q_cmd``, shape (5,), and the jaw; see ``FeetechArm.write``."""
        self._driver().write(q_cmd, q_jaw_cmd, qd_cmd)

    def set_torque(self, on: bool) -> None:
        """Hold the joints at the goal written last, or let go of them."""
        if self._onlooker is not None and not on:
            self._onlooker.let_go()
        else:
            self._driver().set_torque(on)

    def guide(self, how: Compliance | None) -> None:
        """Let the arm joints yield to a hand; see ``FeetechArm.guide``."""
        self._driver().guide(how)

    def close(self) -> None:
        """Let go of the port; the servos stay as they are."""
        arm, self._arm = self._arm, None
        onlooker, self._onlooker = self._onlooker, None
        self._losses += arm.port_losses if arm is not None else 0
        for user in (arm, onlooker):
            if user is not None:
                user.close()

    # What else can be asked, on the I/O thread

    def rebuild(self, settings: ServoSettings) -> None:
        """Set everything up anew; when that fails, go on as before.

        Angles mean something else afterwards: use it with ``Executor.renew``.

        Raises:
            BusError: A required servo cannot be reached or set up.
        """
        if self._arm is not None and self._arm.is_connected:
            self._require(self._arm.bus.port, settings)  # to learn it while all still works
        before = self.settings
        self.close()
        try:
            self._begin(settings)
        except BusError:
            self._begin(replace(before, timeout=0.0))
            self.settings = before
            raise

    # Lending the bus, on the I/O thread

    def lend(self) -> None:
        """Take our hands off the servos, which stay as they are; ``on_bus`` is for the borrower."""
        self.close()
        self._is_lent = True
        self._onlooker = self._look_on(self.settings)

    def on_bus(self, job: Callable[[Bus], T]) -> T:
        """Run ``job`` with the bus of a port on which we drive nothing.

        Raises:
            PortUnavailable: There is no port at present.
            Exception: What ``job`` raised.
        """
        assert self._onlooker is not None, "the bus has not been lent"
        return self._onlooker.on_bus(job)

    def at_baud(self, baud: int) -> None:
        """Let the borrower talk at another rate."""
        assert self._onlooker is not None, "the bus has not been lent"
        self._onlooker.at_baud(baud)

    def take_back(self, *, hold: bool) -> None:
        """The bus is ours again: set everything up anew, as the settings are by now.

        Args:
            hold: Whether the joints are to be held next. Then the servos that answer are taken in
                hand even if no component asks for them.

        Raises:
            BusError: A required servo cannot be reached or set up; it is tried again with each
                ``read``.
        """
        self._is_lent = False
        self.close()
        if hold:
            self._arm = self._build(self.settings)
        else:
            self._begin(self.settings)

    def set_torque_limit(self, joint: str, share: float) -> None:
        """Let ``joint`` use at most ``share``, 0 to 1, of its motor's drive."""
        self._driver().set_torque_limit(joint, share)

    @property
    def bus(self) -> Bus:
        """For jobs that talk to the servos themselves.

        Raises:
            PortUnavailable: There is no port at present.
        """
        return self._driver().bus

    # What any thread may ask

    @property
    def health(self) -> tuple[JointHealth, ...]:
        """How each servo is, base to jaw."""
        return self._arm.health if self._arm is not None else ()

    @property
    def is_connected(self) -> bool:
        """Whether the port is open and the servos have been found."""
        user = self._arm or self._onlooker
        return user is not None and user.is_connected

    @property
    def is_ours(self) -> bool:
        """Whether the servos are ours to drive."""
        return self._onlooker is None

    @property
    def is_driving(self) -> bool:
        """Whether the servos are ours to drive, and one of them drives its joint."""
        return self._arm is not None and self._arm.is_driving

    @property
    def limp(self) -> tuple[str, ...]:
        """The joints of an arm that is ours which no servo drives, base to jaw."""
        return self._arm.limp if self._arm is not None else ()

    @property
    def holds(self) -> bool | None:
        """Whether any servo drives its joint, ours or not; None if nobody answers."""
        if self._onlooker is None:
            return self.is_driving if self.is_connected else None
        return bool(self._onlooker.driven) if self._onlooker.positions else None

    @property
    def positions(self) -> Mapping[str, int]:
        """Where each servo is that answers while we drive nothing [tick], by joint."""
        return self._onlooker.positions if self._onlooker is not None else {}

    @property
    def port_losses(self) -> int:
        """How often the port went away."""
        return self._losses + (self._arm.port_losses if self._arm is not None else 0)

    @property
    def calibration(self) -> dict[str, JointCalibration]:
        """The calibration in use, by joint."""
        return {joint: setup.calibration for joint, setup in self.setups.items()}

    def to_ticks(self, joint: str, q: float) -> int:
        """The servo position that ``joint`` has at angle ``q`` [rad]."""
        return self.setups[joint].map.to_ticks(q)

    def to_angle(self, joint: str, ticks: int) -> float:
        """The angle of ``joint`` at a servo position [rad]."""
        return self.setups[joint].map.to_rad(Ticks(ticks))

    @property
    def lower(self) -> Array:
        """Smallest calibrated angles of the arm joints, shape (5,), [rad]."""
        return self._ends("lower", -np.inf)

    @property
    def upper(self) -> Array:
        """Largest calibrated angles of the arm joints, shape (5,), [rad]."""
        return self._ends("upper", np.inf)

    @property
    def slowdown(self) -> float:
        """What share of its speed the arm should use, 1 to 0.25, by its hottest servo."""
        hottest = max((joint.temperature_c for joint in self.health), default=0)
        return float(np.interp(hottest, (WARM_C, HOT_C), (1.0, 0.25)))

    # How

    def _ends(self, name: str, default: float) -> Array:
        setups = self.setups
        return np.array(
            [getattr(setups[j].map, name) if j in setups else default for j in ARM_JOINTS]
        )

    def _begin(self, settings: ServoSettings) -> None:
        """Take the servos in hand, or only look on if nobody asks for any."""
        if settings.required():
            self._arm = self._build(settings)
        else:
            self._take(settings, self._survey(settings))
            self._onlooker = self._look_on(settings)

    def _look_on(self, settings: ServoSettings) -> Onlooker:
        ids = settings.ids()
        return Onlooker(self._opener, self._clock, ids=ids, patience=self._patience)

    def _seen(self, onlooker: Onlooker) -> JointReading:
        onlooker.look()
        strangers = onlooker.positions.keys() - self.setups.keys()
        if strangers and not self._is_lent:  # somebody has switched the arm on
            with suppress(BusError):
                found = onlooker.on_bus(lambda bus: self._ask(bus, self.settings))
                self._take(self.settings, found)
        q = [*self._last.q, self._last.q_jaw]
        for joint, ticks in onlooker.positions.items():
            setup = self.setups.get(joint)
            q[JOINTS.index(joint)] = (setup.map if setup else JointMap(servo_id=0)).to_rad(ticks)
        return replace(self._last, q=np.array(q[:5]), q_jaw=float(q[5]))

    def _driver(self) -> FeetechArm:
        if self._onlooker is not None:
            raise NotHolding(
                f"no component uses the arm on {self.settings.port}; configure an arm or a gripper"
                " with this port"
            )
        if self._arm is None:
            now = self._clock.now()
            if now < self._retry_due:
                raise PortUnavailable(
                    self.settings.port,
                    "the servos could not be set up again yet; check the USB cable and the arm's"
                    " power, it is tried again every second",
                )
            self._retry_due = now + 1.0
            wanted = self.settings
            self._arm = self._build(replace(wanted, timeout=0.0))  # this thread must not wait
            self.settings = wanted
        return self._arm

    def _build(self, settings: ServoSettings) -> FeetechArm:
        found = self._survey(settings)
        arm = FeetechArm(
            self._opener,
            self._clock,
            {joint: setup.map for joint, setup in found.setups.items()},
            gravity=self._gravity,
            speed=SPEED_CAP,
            acceleration=ACCELERATION_CAP,
            patience=self._patience,
            tallies=self._tallies,
        )
        try:
            if GRIPPER_JOINT in found.setups:
                arm.set_torque_limit(GRIPPER_JOINT, JAW_DRIVE)
        except BusError:
            arm.close()
            raise
        self._take(settings, found)
        return arm

    def _take(self, settings: ServoSettings, found: Survey) -> None:
        known = self.notes  # a motor setup gives the bus back again and again
        self.settings, self.setups, self.notes = settings, found.setups, found.notes
        for note in found.notes:
            if note not in known:
                _log.warning("%s", note)

    def _survey(self, settings: ServoSettings) -> Survey:
        """Look who is there and what is known of them, before the driver takes the port."""
        bus = self._bus(self._opener(), settings)
        try:
            return self._ask(bus, settings)
        finally:
            bus.close()

    @staticmethod
    def _ask(bus: Bus, settings: ServoSettings) -> Survey:
        return survey(
            bus,
            settings.ids(),
            required=settings.required(),
            timeout=settings.timeout or 0.0,
            file=settings.file,
            jaw_closed=JAW_CLOSED,
            zero_offsets=settings.zero_offsets or {},
        )

    def _require(self, port: Port, settings: ServoSettings) -> None:
        bus, ids = self._bus(port, settings), settings.ids()
        answering = bus.answering(ids.values())
        missing = [ids[joint] for joint in settings.required() if ids[joint] not in answering]
        if missing:
            raise not_there(bus, missing, answering)

    def _bus(self, port: Port, settings: ServoSettings) -> Bus:
        names = {servo_id: joint for joint, servo_id in settings.ids().items()}
        return Bus(port, names=names, patience=self._patience)
