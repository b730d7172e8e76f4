"""The composition root: from settings to a live arm and gripper.

Nothing else chooses an implementation. All rigs of a process share one planning process, which
ends with the last of them. A serial port has one rig, however many components use it and however
they spell it; each holds a ``HardwareRig``, and the last one out closes.
"""

from __future__ import annotations

import itertools
import os
import threading
from types import TracebackType

from so101_motion.arm import Arm
from so101_motion.clock import Clock, MonotonicClock
from so101_motion.drivers.bus import PATIENCE
from so101_motion.drivers.feetech_arm import SETTLE_POSITION, SETTLE_TIMEOUT, SETTLE_VELOCITY
from so101_motion.drivers.sim_arm import SimArm
from so101_motion.executor import Executor, JointDriver, Tolerances
from so101_motion.geometry import Array
from so101_motion.gripper import JAW_CLOSED, JAW_LIMITS, Gripper
from so101_motion.planning.collision import FLOOR_Z
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.model import RobotModel
from so101_motion.servos import Servos, ServoSettings
from so101_motion.state import GRIPPER_JOINT
from so101_motion.units import to_rad
from so101_motion.worker import PlanningWorker

TICK = 0.01
"""Period of the control loop [s]."""

HARD_STOP = MotionLimits.uniform(velocity=to_rad(180.0), acceleration=to_rad(600.0), jerk=200.0)
"""Caps of a stop, whatever the motion's own: 600 deg/s^2 is where the servos level off (460 to 620
measured by the published module's authors); the jerk is chosen, braking builds up in 50 ms. A fifth
more than any motion may have, so that a stop nearly always finds a way along the path."""

JAW_HARD_STOP = MotionLimits.uniform(
    velocity=JAW_LIMITS.velocity[0],
    acceleration=1.2 * JAW_LIMITS.acceleration[0],
    jerk=1.5 * JAW_LIMITS.jerk[0],
    n=1,
)
"""The same for the jaw, which is light and moves faster than the arm."""

_numbers = itertools.count(1)


class Rig:
    """An arm and a gripper on one driver, with their clock and their I/O thread.

    Use it in a ``with`` block or call ``close``.
    """

    def __init__(
        self,
        driver: JointDriver,
        *,
        clock: Clock,
        speed: float,
        acceleration: float,
        floor_z: float | None,
        tolerances: Tolerances | None = None,
        jaw_tolerances: Tolerances | None = None,
    ) -> None:
        self.clock = clock
        self.executor = Executor(
            driver,
            clock,
            dt=TICK,
            stop_limits=HARD_STOP,
            jaw_stop_limits=JAW_HARD_STOP,
            tolerances=tolerances,
            jaw_tolerances=jaw_tolerances,
            name=f"so101-io-{next(_numbers)}",
        )
        self._worker = _acquire_worker()
        self._closed = False
        try:
            self.arm = Arm(
                model=RobotModel.load(),
                executor=self.executor,
                planner=self._worker.plan,
                speed=speed,
                acceleration=acceleration,
                floor_z=floor_z,
            )
            self.gripper = Gripper(executor=self.executor)
            self.executor.start()
        except BaseException:
            driver.close()
            _release_worker()
            raise

    def warm_up(self) -> None:
        """Start the planning process in the background, so that the first plan comes quickly."""
        self._worker.start()

    def close(self) -> None:
        """Stop, end all threads, close the driver. May be called twice."""
        if self._closed:
            return
        self._closed = True
        self.executor.close()  # first: it lets pass the time that its motions need to come to rest
        self.arm.close()
        _release_worker()

    def __enter__(self) -> Rig:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def open_simulated(
    *,
    speed: float = to_rad(90.0),
    acceleration: float = to_rad(100.0),
    floor_z: float | None = FLOOR_Z,
    q_start: Array | None = None,
    q_jaw_start: float = JAW_CLOSED,
    clock: Clock | None = None,
) -> Rig:
    """A simulated arm and gripper, ready to move; the planning process is warming up.

    Args:
        speed: Joint speed cap [rad/s].
        acceleration: Joint acceleration cap [rad/s^2].
        floor_z: Height of the floor in the base frame [m]; None for no floor.
        q_start: Where the joints stand, shape (5,), [rad]; zeros by default.
        q_jaw_start: Where the jaw stands [rad].
        clock: What time it is; the real time by default.

    Raises:
        ConfigError: A speed or acceleration outside its range.
    """
    clock = clock or MonotonicClock()
    driver = SimArm(clock, q=q_start, q_jaw=q_jaw_start)
    rig = Rig(driver, clock=clock, speed=speed, acceleration=acceleration, floor_z=floor_z)
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
        floor_z=None,
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
        self._closed = False

    @property
    def users(self) -> int:
        """How many components share this port."""
        return self._live.users

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

    def close(self) -> None:
        """Give up this share; the last one closes the port. May be called twice."""
        with _hardware_lock:
            if self._closed:
                return
            self._closed = True
            self._live.users -= 1
            if self._live.users == 0:
                _hardware.remove(self._live)
                self._live.rig.close()


class _Live:
    """A rig on a serial port, and how many use it. Its methods: with ``_hardware_lock`` held."""

    def __init__(self, settings: ServoSettings, clock: Clock, patience: float) -> None:
        self.users = 0
        self._device = os.path.realpath(settings.port)
        self.servos = Servos(
            settings, clock, gravity=RobotModel.load().gravity_torque, patience=patience
        )
        self.rig = Rig(
            self.servos,
            clock=clock,
            speed=to_rad(50.0),
            acceleration=to_rad(100.0),
            floor_z=FLOOR_Z,
            tolerances=HARDWARE_TOLERANCES,
            jaw_tolerances=JAW_TOLERANCES,
        )
        self.rig.gripper.limits = HARDWARE_JAW_LIMITS
        self.rig.arm.slowdown = lambda: self.servos.slowdown
        self._take_ranges()

    def is_on(self, port: str) -> bool:
        """Whether ``port`` is another name, or the name, of this rig's."""
        device = os.path.realpath(port)
        return device in (self._device, os.path.realpath(self.servos.settings.port))

    def admit(self, settings: ServoSettings) -> None:
        """Let another component in; what it asks for beyond the others is set up.

        Raises:
            ConfigError: It contradicts the others.
            BusError: What it asks for is not there.
        """
        now, joined = self.servos.settings, self.servos.settings.joined_with(settings)
        ids = joined.ids()
        in_use = {joint: setup.map.servo_id for joint, setup in self.servos.setups.items()}
        if (
            joined.calibration_file != now.calibration_file
            or any(joint not in in_use for joint in joined.required())
            or any(ids.get(joint) != servo_id for joint, servo_id in in_use.items())
        ):
            self.rebuild(joined)
        self.servos.settings = joined

    def rebuild(self, settings: ServoSettings) -> None:
        """Set the servos up anew; held joints stay put."""
        self.rig.executor.renew(lambda _: self.servos.rebuild(settings)).result()
        self._take_ranges()
        self.rig.gripper.regrip()

    def _take_ranges(self) -> None:
        self.rig.arm.set_range(self.servos.lower, self.servos.upper)
        jaw = self.servos.setups.get(GRIPPER_JOINT)
        if jaw is not None:
            self.rig.gripper.closed, self.rig.gripper.opened = jaw.map.lower, jaw.map.upper


def open_hardware(
    settings: ServoSettings, *, clock: Clock | None = None, patience: float = PATIENCE
) -> HardwareRig:
    """The arm and gripper on a serial port; nothing moves by being opened.

    Several may be opened on one port: they share it, and what they ask for must agree.

    Args:
        settings: Which port, and what is asked of it.
        clock: What time it is; the real time by default, or what the port's first user said.
        patience: How long to wait for an answer beyond the time on the wire [s]; likewise.

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


_hardware_lock = threading.RLock()
_hardware: list[_Live] = []

_worker_lock = threading.Lock()
_worker: PlanningWorker | None = None
_worker_users = 0


def _acquire_worker() -> PlanningWorker:
    global _worker, _worker_users
    with _worker_lock:
        if _worker is None:
            _worker = PlanningWorker()
        _worker_users += 1
        return _worker


def _release_worker() -> None:
    global _worker, _worker_users
    with _worker_lock:
        _worker_users -= 1
        if _worker_users > 0:
            return
        worker, _worker = _worker, None
    if worker is not None:
        worker.close()
