"""The composition root: from settings to a live arm and gripper.

Nothing else chooses an implementation. All rigs of a process share one planning process, which
ends with the last of them.
"""

from __future__ import annotations

import itertools
import threading
from types import TracebackType

from so101_motion.arm import Arm
from so101_motion.clock import Clock, MonotonicClock
from so101_motion.drivers.sim_arm import SimArm
from so101_motion.executor import Executor, JointDriver
from so101_motion.geometry import Array
from so101_motion.gripper import JAW_CLOSED, JAW_LIMITS, Gripper
from so101_motion.planning.collision import FLOOR_Z
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.model import RobotModel
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
    ) -> None:
        self.clock = clock
        self.executor = Executor(
            driver,
            clock,
            dt=TICK,
            stop_limits=HARD_STOP,
            jaw_stop_limits=JAW_HARD_STOP,
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
