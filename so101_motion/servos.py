"""The servos of one port as the rig uses them: which, with what calibration, and how they are.

``Servos`` is the ``JointDriver`` of a real arm. The bytes are ``FeetechArm``'s; here is what has to
be decided before those can flow and what the figures mean to the arm:

* what the ticks mean: from the calibration file, else from the servos' registers, else defaults;
* who must be there: an arm's five servos, a gripper's one, and whoever else answers;
* that nothing moves by being set up: a servo whose homing offset is about to change, which would
  move its goal, is let go of for that moment, and a joint that stands outside its calibrated limits
  is brought in slowly;
* when a joint is in trouble (``alarms``), so that the executor ends its motion and backs off.

All of it can be decided anew while the arm is held (``rebuild``): when the calibration file was
written, or a component joins that asks for more. It runs on the I/O thread, like every driver.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from so101_motion.alarms import HOT_C, WARM_C, alarms
from so101_motion.calib.record import JOINTS, JointCalibration
from so101_motion.calib.survey import Survey, survey
from so101_motion.clock import Clock
from so101_motion.drivers import registers as reg
from so101_motion.drivers.bus import PATIENCE, Bus, Port
from so101_motion.drivers.droop import Gravity
from so101_motion.drivers.feetech_arm import FeetechArm
from so101_motion.drivers.health import JointHealth
from so101_motion.drivers.port import PortOpener
from so101_motion.drivers.presence import not_there
from so101_motion.drivers.ticks import Ticks, to_speed_ticks
from so101_motion.errors import BusError, ConfigError, PortUnavailable
from so101_motion.geometry import Array
from so101_motion.gripper import JAW_CLOSED
from so101_motion.hardware_config import BAUDRATE, GRIPPER_ID, SERVO_IDS, TIMEOUT
from so101_motion.state import ARM_JOINTS, GRIPPER_JOINT, JointReading
from so101_motion.units import to_rad

_log = logging.getLogger(__name__)

SPEED_CAP = to_rad(220.0)
"""Speed cap the servos keep by themselves [rad/s]: what is planned never exceeds 180 deg/s, and a
joint must be able to catch up; the jaw is planned with 220."""

ACCELERATION_CAP = to_rad(1000.0)
"""Acceleration cap the servos keep by themselves [rad/s^2]: twice the largest that is planned."""

JAW_DRIVE = 0.5
"""Share of its drive the jaw may use at most, as in LeRobot. A jaw that closes on something
stiff must not be able to overload itself."""

_OUTSIDE = to_rad(0.3)  # a joint further outside its limits than this is brought in slowly
_INWARD_SPEED = to_rad(8.0)  # [rad/s], chosen; the servo turns no slower than 4.4 deg/s
_INWARD_TIME = 10.0  # [s] after which a joint that cannot come in is left alone
_LOOK_PERIOD = 0.1  # [s], how often the servos' figures change


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoSettings:
    """What components ask of a port.

    Attributes:
        port: The serial port as given.
        baudrate: Bits per second.
        timeout: For how long servos that do not answer are asked at the start [s].
        servo_ids: The arm's servos, base to wrist; None when no arm is asked for.
        gripper_id: The jaw's servo; None when no gripper is asked for.
        calibration_file: None to ask the servos.
    """

    port: str
    baudrate: int = BAUDRATE
    timeout: float = TIMEOUT
    servo_ids: tuple[int, ...] | None = None
    gripper_id: int | None = None
    calibration_file: Path | None = None

    def with_arm(self, servo_ids: tuple[int, ...]) -> ServoSettings:
        """The same, and an arm with these servos."""
        return replace(self, servo_ids=servo_ids)

    def with_gripper(self, gripper_id: int) -> ServoSettings:
        """The same, and a gripper with this servo."""
        return replace(self, gripper_id=gripper_id)

    def joined_with(self, other: ServoSettings) -> ServoSettings:
        """What both ask for together.

        Raises:
            ConfigError: They contradict each other; the message names every such setting.
        """
        differing = []
        merged: dict[str, object] = {}
        for name in ("baudrate", "timeout", "servo_ids", "gripper_id", "calibration_file"):
            mine, theirs = getattr(self, name), getattr(other, name)
            if None not in (mine, theirs) and mine != theirs:
                differing.append(f"{name} {_plain(mine)} and {_plain(theirs)}")
            merged[name] = theirs if mine is None else mine
        if differing:
            raise ConfigError(
                "port",
                other.port,
                "another component uses this port with other settings: "
                + "; ".join(differing)
                + ". Give both the same",
            )
        joined = replace(self, **merged)  # type: ignore[arg-type]  # names and types are our own
        joined.ids()
        return joined

    def ids(self) -> dict[str, int]:
        """The servo of each joint that may be there.

        Raises:
            ConfigError: One servo is to move two joints.
        """
        arm = self.servo_ids or SERVO_IDS
        ids = dict(zip(ARM_JOINTS, arm, strict=True))
        if self.gripper_id in arm:
            if self.servo_ids is not None:
                raise ConfigError(
                    "servo_id", self.gripper_id, f"belongs to the arm already: {list(arm)}"
                )
            ids = {joint: i for joint, i in ids.items() if i != self.gripper_id}
        return {**ids, GRIPPER_JOINT: self.gripper_id or GRIPPER_ID}

    def required(self) -> tuple[str, ...]:
        """The joints that must be there."""
        return (ARM_JOINTS if self.servo_ids is not None else ()) + (
            (GRIPPER_JOINT,) if self.gripper_id is not None else ()
        )


def _plain(value: object) -> str:
    return str(list(value)) if isinstance(value, tuple) else str(value)


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
        self._alarms: Mapping[str, str] = {}
        self._look_due = self._retry_due = clock.now()
        self._inward_until: float | None = None
        self._opener = PortOpener(settings.port, settings.baudrate)
        self._arm: FeetechArm | None = self._build(settings)

    # What a driver does

    def read(self) -> JointReading:
        """Measure all joints; see ``FeetechArm.read``."""
        arm = self._driver()
        reading = arm.read()
        now = self._clock.now()
        if self._inward_until is not None:
            self._watch_inward(arm, reading, now)
        if now >= self._look_due:
            self._look_due = now + _LOOK_PERIOD
            self._alarms = alarms(arm.health)
        return replace(reading, alarms=self._alarms) if self._alarms else reading

    def write(self, q_cmd: Array, q_jaw_cmd: float) -> None:
        """Send the joints to ``q_cmd``, shape (5,), and the jaw to ``q_jaw_cmd`` [rad]."""
        self._driver().write(q_cmd, q_jaw_cmd)

    def set_torque(self, on: bool) -> None:
        """Hold the joints at the goal written last, or let go of them."""
        arm = self._driver()
        if on:
            self._go_inward_slowly(arm)
        arm.set_torque(on)

    def close(self) -> None:
        """Let go of the port; the servos stay as they are."""
        if self._arm is not None:
            self._arm.close()

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
        self._arm = None
        try:
            self._arm = self._build(settings)
        except BusError:
            self._arm = self._build(replace(before, timeout=0.0))
            self.settings = before
            raise

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
        return self._arm is not None and self._arm.is_connected

    @property
    def port_losses(self) -> int:
        """How often the port went away."""
        return self._arm.port_losses if self._arm is not None else 0

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

    def _driver(self) -> FeetechArm:
        if self._arm is None:
            now = self._clock.now()
            if now < self._retry_due:
                raise PortUnavailable(self.settings.port, "is being set up again")
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
        )
        try:
            if GRIPPER_JOINT in found.setups:
                arm.set_torque_limit(GRIPPER_JOINT, JAW_DRIVE)
        except BusError:
            arm.close()
            raise
        self.settings, self.setups, self.notes = settings, found.setups, found.notes
        for note in found.notes:
            _log.warning("%s", note)
        return arm

    def _survey(self, settings: ServoSettings) -> Survey:
        """Look who is there and what is known of them, before the driver takes the port."""
        ids = settings.ids()
        bus = self._bus(self._opener(), settings)
        try:
            return survey(
                bus,
                ids,
                required=settings.required(),
                timeout=settings.timeout,
                file=settings.calibration_file,
                jaw_closed=JAW_CLOSED,
            )
        finally:
            bus.close()

    def _require(self, port: Port, settings: ServoSettings) -> None:
        bus, ids = self._bus(port, settings), settings.ids()
        answering = bus.answering(ids.values())
        missing = [ids[joint] for joint in settings.required() if ids[joint] not in answering]
        if missing:
            raise not_there(bus, missing, answering)

    def _bus(self, port: Port, settings: ServoSettings) -> Bus:
        names = {servo_id: joint for joint, servo_id in settings.ids().items()}
        return Bus(port, names=names, patience=self._patience)

    def _go_inward_slowly(self, arm: FeetechArm) -> None:
        """Cap the speed of joints that will move because their goal must lie inside the limits."""
        outside = self._outside(arm.read())
        for joint in outside:
            _log.warning("%s stands outside its calibrated limits; it moves in slowly", joint)
            servo_id = self.setups[joint].map.servo_id
            arm.bus.write(servo_id, reg.GOAL_VELOCITY, to_speed_ticks(_INWARD_SPEED))
            arm.bus.write(servo_id, reg.ACCELERATION, 1)
        if outside:
            self._inward_until = self._clock.now() + _INWARD_TIME

    def _watch_inward(self, arm: FeetechArm, reading: JointReading, now: float) -> None:
        assert self._inward_until is not None
        if now >= self._inward_until or not self._outside(reading):
            self._inward_until = None
            arm.set_caps(speed=SPEED_CAP, acceleration=ACCELERATION_CAP)

    def _outside(self, reading: JointReading) -> list[str]:
        angles = dict(zip(JOINTS, (*reading.q, reading.q_jaw), strict=True))
        return [
            joint
            for joint, setup in self.setups.items()
            if not setup.map.lower - _OUTSIDE <= angles[joint] <= setup.map.upper + _OUTSIDE
        ]
