"""The composition root: from settings to a live arm and gripper.

Nothing else chooses an implementation. All rigs of a process share one planning process, which
ends with the last of them. A serial port has one rig, however many components use it and however
they spell it; each holds a ``HardwareRig``, and the last one out closes.
"""

from __future__ import annotations

import atexit
import logging
import os
import threading
from dataclasses import dataclass

from so101_motion.assembly import TICK, Rig
from so101_motion.clock import Clock, MonotonicClock
from so101_motion.drivers.bus import patience_in
from so101_motion.drivers.feetech_arm import SETTLE_POSITION, SETTLE_TIMEOUT, SETTLE_VELOCITY
from so101_motion.drivers.sim_arm import SimArm
from so101_motion.errors import ConfigError, So101Error
from so101_motion.executor import Executor, Tolerances
from so101_motion.geometry import Array
from so101_motion.gripper import JAW_CLOSED
from so101_motion.loan import BusLoan
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.model import RobotModel
from so101_motion.planning.scene import Scene
from so101_motion.realtime import go_first
from so101_motion.rig_like import Connection
from so101_motion.servos import Servos, ServoSettings
from so101_motion.state import GRIPPER_JOINT
from so101_motion.units import to_rad

__all__ = [
    "TICK",
    "HardwareRig",
    "PortUse",
    "Rig",
    "leave_all",
    "open_hardware",
    "open_simulated",
    "open_simulated_gripper",
    "use_of",
]

_log = logging.getLogger(__name__)


def open_simulated(
    *,
    speed: float = to_rad(90.0),
    acceleration: float = to_rad(100.0),
    scene: Scene | None = None,
    q_start: Array | None = None,
    q_jaw_start: float = JAW_CLOSED,
    clock: Clock | None = None,
) -> Rig:
    """A simulated arm and gripper, ready to move; the planning process is warming up.

    Args:
        speed: Joint speed cap [rad/s].
        acceleration: Joint acceleration cap [rad/s^2].
        scene: What is around it and in its hand; just the floor if not given.
        q_start: Where the joints stand, shape (5,), [rad]; zeros by default.
        q_jaw_start: Where the jaw stands [rad].
        clock: What time it is; the real time by default.

    Raises:
        ConfigError: A speed or acceleration outside its range.
    """
    clock = clock or MonotonicClock()
    driver = SimArm(clock, q=q_start, q_jaw=q_jaw_start)
    rig = Rig(driver, clock=clock, speed=speed, acceleration=acceleration, scene=scene or Scene())
    rig.warm_up()
    return rig


def open_simulated_gripper(*, q_jaw_start: float = JAW_CLOSED) -> Rig:
    """A simulated gripper; the arm it is on stands still, and no planning process is started.

    Args:
        q_jaw_start: Where the jaw stands [rad].
    """
    clock = MonotonicClock()
    return Rig(
        SimArm(clock, q_jaw=q_jaw_start),
        clock=clock,
        speed=to_rad(90.0),
        acceleration=to_rad(100.0),
        scene=Scene(),
    )


HARDWARE_TOLERANCES = Tolerances(
    settle_position=SETTLE_POSITION,
    settle_velocity=SETTLE_VELOCITY,
    settle_timeout=SETTLE_TIMEOUT,
    following_lag=0.15,
)
"""When a real arm has arrived; its servos are up to 0.1 s behind at speed."""

JAW_TOLERANCES = Tolerances(
    settle_position=to_rad(1.0),
    settle_velocity=SETTLE_VELOCITY,
    settle_timeout=0.4,
    following_error=0.08,
    following_lag=0.15,
)
"""The same for a real jaw. Nothing corrects its standing error of some ticks; and what it closes on
must stop it soon: 0.08 rad are 5 mm between the tips. Chosen."""

HARDWARE_JAW_LIMITS = MotionLimits.uniform(
    velocity=to_rad(90.0), acceleration=10.0, jerk=200.0, n=1
)
"""How fast a real jaw moves: a third of its drive goes into the speed, so half of it suffices, and
it is slow enough to feel what it meets. Chosen."""


class HardwareRig(Rig):
    """One component's share of the rig of a serial port. ``open_hardware`` makes them.

    Attributes:
        servos: The servos; for what may be asked of them from any thread.
    """

    def __init__(self, live: _Live) -> None:  # shares the parts of a rig instead of making them
        self._live = live
        self.servos, rig = live.servos, live.rig
        self.clock, self.executor = rig.clock, rig.executor
        self.arm, self.gripper = rig.arm, rig.gripper
        self._loan: BusLoan | None = None
        self._closed = False

    @property
    def users(self) -> int:
        """How many components share this port."""
        return self._live.users

    @property
    def connection(self) -> Connection:
        """Whether the servos can be reached."""
        problem = None
        if not self.servos.is_connected:
            problem = self.arm.state.fault or "the port is not there; plug the adapter in again"
        return Connection(to=f"arm on {self.settings.port}", problem=problem)

    def warm_up(self) -> None:
        """Start the planning process in the background, so that the first plan comes quickly."""
        self._live.rig.warm_up()

    @property
    def settings(self) -> ServoSettings:
        """What all that share this port ask of it."""
        return self.servos.settings

    def is_on(self, port: str) -> bool:
        """Whether ``port`` is a name of this rig's port."""
        return self._live.is_on(port)

    def reload(self) -> None:
        """Take up the calibration anew, from the file or the servos; the arm stays where it is.

        Raises:
            MotionError: Something moves.
            BusError: The servos cannot be set up; all is as before.
        """
        with _hardware_lock:
            self._live.rebuild(self.servos.settings)

    def lend_bus(self, purpose: str) -> BusLoan:
        """Have the bus to ourselves, to calibrate the servos or to set them up; see ``BusLoan``.

        No servo need be there, and what is there need not be an arm.

        Args:
            purpose: What for, as it is told to those who are refused meanwhile.

        Raises:
            MotionError: Something moves, or the bus is lent already; the message says for what.
        """
        loan = BusLoan(
            self.executor,
            self.servos,
            self.clock,
            purpose=purpose,
            returned=self._live.take_ranges,
        )
        self._loan = loan
        return loan

    def close(self) -> None:
        """Give up this share; the last one closes the port. May be called twice.

        A bus lent by this share goes back first. If it is the last share, the servos stay as the
        borrower left them.
        """
        with _hardware_lock:
            if self._closed:
                return
            self._closed = True
            self._live.users -= 1
            if self._live.users == 0:
                _hardware.remove(self._live)
                self._live.rig.close()
            elif self._loan is not None:
                self._loan.abandon()


class _Live:
    """A rig on a serial port, and how many use it. Its methods: with ``_hardware_lock`` held."""

    def __init__(self, settings: ServoSettings, clock: Clock, patience: float | None) -> None:
        self.users = 0
        dt = 1.0 / settings.rate if settings.rate else TICK
        self._device = os.path.realpath(settings.port)
        self.servos = Servos(
            settings,
            clock,
            gravity=RobotModel.load().gravity_torque,
            patience=patience_in(dt) if patience is None else patience,
        )
        self.rig = Rig(
            self.servos,
            clock=clock,
            speed=to_rad(50.0),
            acceleration=to_rad(100.0),
            scene=Scene(),
            dt=dt,
            tolerances=HARDWARE_TOLERANCES,
            jaw_tolerances=JAW_TOLERANCES,
            start=Executor.start if settings.required() else Executor.start_limp,
        )
        if isinstance(clock, MonotonicClock):
            self.rig.executor.call(lambda _: go_first())
        self.rig.gripper.limits = HARDWARE_JAW_LIMITS
        self.rig.arm.slowdown = lambda: self.servos.slowdown
        self.take_ranges()

    def leave(self) -> None:
        """Let go of the joints if that is how they are to be left; needs no lock."""
        if not self.servos.settings.lets_go:
            return
        try:
            self.rig.arm.set_torque(False)
        except So101Error as error:
            _log.warning("%s was not let go of: %s", self.servos.settings.port, error)

    def is_on(self, port: str) -> bool:
        """Whether ``port`` is another name, or the name, of this rig's."""
        device = os.path.realpath(port)
        return device in (self._device, os.path.realpath(self.servos.settings.port))

    def admit(self, settings: ServoSettings) -> None:
        """Let another component in; what it asks for beyond the others is set up.

        While the bus is lent that waits until it is given back.

        Raises:
            ConfigError: It contradicts the others.
            BusError: What it asks for is not there.
        """
        now, joined = self.servos.settings, self.servos.settings.joined_with(settings)
        running = 1.0 / self.rig.executor.dt
        if joined.rate is not None and abs(joined.rate - running) > 1e-6:
            raise ConfigError(
                "control_rate_hz",
                joined.rate,
                f"the port runs at {running:g} Hz already, for another component; give every"
                " component on it the same",
            )
        ids = joined.ids()
        in_use = {joint: setup.map.servo_id for joint, setup in self.servos.setups.items()}
        if self.rig.executor.state.lent_to is None and (
            not now.required()
            or joined.file != now.file
            or joined.zero_offsets != now.zero_offsets
            or any(joint not in in_use for joint in joined.required())
            or any(ids.get(joint) != servo_id for joint, servo_id in in_use.items())
        ):
            self.rebuild(joined)
        self.servos.settings = joined

    def rebuild(self, settings: ServoSettings) -> None:
        """Set the servos up anew; held joints stay put, and what nobody drove until now is held."""
        executor, first = self.rig.executor, not self.servos.settings.required()
        executor.renew(lambda _: self._rebuild(settings)).result()
        if first and settings.required():
            executor.hold().result()
        self.rig.gripper.regrip()

    def _rebuild(self, settings: ServoSettings) -> None:
        self.servos.rebuild(settings)
        self.take_ranges()

    def take_ranges(self) -> None:
        """Let arm and gripper know how far their joints go by the calibration in force."""
        self.rig.arm.set_range(self.servos.lower, self.servos.upper)
        jaw = self.servos.setups.get(GRIPPER_JOINT)
        if jaw is not None:
            self.rig.gripper.closed, self.rig.gripper.opened = jaw.map.lower, jaw.map.upper


def open_hardware(
    settings: ServoSettings, *, clock: Clock | None = None, patience: float | None = None
) -> HardwareRig:
    """The arm and gripper on a serial port; nothing moves by being opened.

    Several may be opened on one port: they share it, and what they ask for must agree. As long as
    none asks for a servo, nobody need be there and nothing is driven: that is for ``lend_bus``.

    Args:
        settings: Which port, and what is asked of it.
        clock: What time it is; the real time by default, or what the port's first user said.
        patience: How long to wait for an answer beyond the time on the wire [s]; by default what
            the period of the setpoints has room for, or what the port's first user said.

    Raises:
        ConfigError: Another component uses the port with other settings.
        BusError: The port cannot be opened, or a servo that is asked for does not answer.
    """
    with _hardware_lock:
        live = next((live for live in _hardware if live.is_on(settings.port)), None)
        if live is None:
            live = _Live(settings, clock or MonotonicClock(), patience)
            _hardware.append(live)
        else:
            live.admit(settings)
        live.users += 1
        return HardwareRig(live)


@dataclass(frozen=True, slots=True, kw_only=True)
class PortUse:
    """What the components of this process do with a port.

    Attributes:
        settings: What they ask of it.
        joints: The joints they have found there, base to jaw.
    """

    settings: ServoSettings
    joints: tuple[str, ...]


def use_of(port: str) -> PortUse | None:
    """What this process does with a port, by any of its names; None if nothing.

    Asks nobody on the bus and waits for nobody.
    """
    for live in tuple(_hardware):
        if live.is_on(port):
            return PortUse(settings=live.servos.settings, joints=tuple(live.servos.setups))
    return None


_hardware_lock = threading.RLock()
_hardware: list[_Live] = []


def leave_all() -> None:
    """Bring every arm that is to be let go of at the end to rest, and let go of it.

    For whoever ends the process in order, before the rigs are closed. An arm that cannot be reached
    stays as it is; the log says so.
    """
    for live in tuple(_hardware):
        live.leave()


@atexit.register
def _close_all() -> None:
    """A program that ends without closing leaves arms at rest, not ones in mid-motion."""
    leave_all()
    for live in tuple(_hardware):
        live.rig.close()
