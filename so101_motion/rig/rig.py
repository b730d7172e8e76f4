"""Put an arm and a gripper together on one driver, with an I/O thread and a planner.

``simulated_rig.py`` and ``hardware_rig.py`` choose the driver. All rigs of a process share one
planning process, which ends with the last of them.
"""

from __future__ import annotations

import atexit
import itertools
import logging
from collections.abc import Callable
from functools import cached_property, partial

from numpy.typing import ArrayLike

from so101_motion.arm.arm import Arm
from so101_motion.arm.gripper import JAW_LIMITS, Gripper
from so101_motion.arm.picking import TRIES, Picker, PickRun
from so101_motion.arm.planning_worker import acquire_worker, release_worker
from so101_motion.common import interrupts
from so101_motion.common.clock import Clock
from so101_motion.common.geometry import point
from so101_motion.common.public import Complete
from so101_motion.common.units import to_rad
from so101_motion.control.executor import Executor, Tolerances
from so101_motion.control.joint_group import JointDriver
from so101_motion.drivers.things import Things
from so101_motion.planning.collision.scene import Scene
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.picking.grasps import Wishes
from so101_motion.planning.picking.pick_plan import Place
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.protocols import ArmConnection
from so101_motion.rig.session_end import AtEnd, leave_as_asked

_log = logging.getLogger(__name__)

TICK = 0.01
"""Period of the control loop [s]."""

HARD_STOP = MotionLimits.uniform(velocity=to_rad(180.0), acceleration=to_rad(600.0), jerk=200.0)
"""Caps of a stop, whatever the motion's own. Servos do not accelerate harder than 600 deg/s^2, a
fifth more than any motion may have, so a stop can nearly always follow the path. The jerk is
chosen: braking builds up in 50 ms. Servos that brake less, like that of shoulder_lift, are asked
for no more than they can do, and for 7 % less by motions."""

JAW_HARD_STOP = MotionLimits.uniform(
    velocity=JAW_LIMITS.velocity[0],
    acceleration=1.2 * JAW_LIMITS.acceleration[0],
    jerk=1.5 * JAW_LIMITS.jerk[0],
    n=1,
)
"""The same for the jaw, which is light and moves faster than the arm."""

_numbers = itertools.count(1)


class Rig(Complete):
    """An arm and a gripper on one driver, with their clock and their I/O thread.

    Use it in a ``with`` block or call ``close``.

    Attributes:
        arm: The five joints.
        gripper: The jaw.
        clock: The time that the control loop runs on.
        executor: The control loop, which alone talks to the joints.
        planner: The planning process, shared by all rigs.
        things: What is truly around a simulated arm; None on servos.
        at_end: What ``close`` does first, one of ``session_end.ENDS``; it moves nothing unasked.
        on_left: Told why the arm holds although it was to go somewhere; the log by default.
    """

    _shown = "arm at_end clock close connection gripper pick picker place planner warm_up"
    at_end = AtEnd()
    on_left: Callable[[str], None] = staticmethod(_log.warning)
    leave = leave_as_asked

    def __init__(
        self,
        driver: JointDriver,
        *,
        clock: Clock,
        speed: float,
        acceleration: float,
        scene: Scene,
        dt: float = TICK,
        tolerances: Tolerances | None = None,
        jaw_tolerances: Tolerances | None = None,
        start: Callable[[Executor], None] = Executor.start,
    ) -> None:
        self.clock = clock
        self.executor = Executor(
            driver,
            clock,
            dt=dt,
            stop_limits=HARD_STOP,
            jaw_stop_limits=JAW_HARD_STOP,
            tolerances=tolerances,
            jaw_tolerances=jaw_tolerances,
            name=f"so101-io-{next(_numbers)}",
        )
        self.planner = acquire_worker()
        self._closed = False
        self.things: Things | None = None
        try:
            self.arm = Arm(
                model=RobotModel.load(),
                executor=self.executor,
                planner=partial(self.planner.plan, owner=self.executor),
                clock=clock,
                speed=speed,
                acceleration=acceleration,
                scene=scene,
            )
            self.gripper = Gripper(self.executor)
            start(self.executor)
        except BaseException:
            driver.close()
            release_worker()
            raise

    def __repr__(self) -> str:
        now = "closed" if self._closed else self.arm.state.mode.value
        return f"<{type(self).__name__}: {self.connection.to}, {now}>"

    @property
    def connection(self) -> ArmConnection:
        """Whether the joints can be reached: the simulated ones always."""
        return ArmConnection(to="simulated arm", is_simulated=True)

    @cached_property
    def picker(self) -> Picker:
        """Picks items of ``arm.scene`` and places them."""
        return Picker(self.arm, self.gripper)

    def pick(
        self, name: str, *, wishes: Wishes | None = None, tries: int = TRIES, wait: bool = True
    ) -> PickRun:
        """Pick an item of ``arm.scene`` and lift it; supersedes what is under way.

        Every stage is planned before the first one moves. That the jaws hold the item is measured;
        if they do not, the next grasp is tried.

        Args:
            name: The item's name.
            wishes: What you say about grasps.
            tries: How many grasps are tried.
            wait: Return when it is held. With False the run is returned at once.

        Raises:
            ConfigError: There is no such item.
            PlanningError: It cannot be gripped, reached or lifted; the error says why.
            MotionError: The jaws do not hold it, or the grip was lost.
            Interrupted: A newer motion or a stop ended it; what is held stays held.
        """
        run = self.picker.start(name, wishes=wishes, tries=tries)
        if wait:
            run.result()
        return run

    def place(
        self, name: str, *, at: ArrayLike, yaw: float | None = None, wait: bool = True
    ) -> PickRun:
        """Put down what the gripper holds, upright; errors as for ``pick``.

        Args:
            name: The name of what it holds.
            at: Middle of its underside, x, y, z in the base frame [m]. Up to 3 mm above the table
                it is put on the table.
            yaw: How far it is turned from how it was picked [rad]; None for any.
            wait: Return when it is put down. With False the run is returned at once.
        """
        run = self.picker.start(name, Place(p=point("at", at), yaw=yaw))
        if wait:
            run.result()
        return run

    def warm_up(self) -> None:
        """Start the planning process in the background, so that the first plan comes quickly."""
        self.planner.start()

    @interrupts.held()
    def close(self) -> None:
        """Stop, do as ``at_end`` says, end all threads, close the driver. May be called twice."""
        if self._closed:
            return
        atexit.unregister(self.close)
        self.leave()
        self._closed = True
        self.executor.close()  # first: it waits until its motions have come to rest
        self.arm.close()
        release_worker()

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
