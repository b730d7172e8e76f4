"""Jog the tool with velocities, poses and points that are sent again and again.

In every tick a ``Servo`` (``planning/differential``) computes the next setpoint from the newest
request; it keeps every limit and stays clear of everything. A velocity must be repeated: without
one for ``DEADMAN`` the arm slows to rest. A pose or a point is reached and held.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.geometry import SE3, given_array, in_metres, in_radians, point, pose
from so101_motion.control.motion_source import OpenEndedMotion
from so101_motion.planning.differential.targets import STILL, Target, Twist
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint, Trajectory

if TYPE_CHECKING:  # it brings Pinocchio along, which the I/O thread has no use for otherwise
    from so101_motion.planning.collision.collision import CollisionModel
    from so101_motion.planning.differential.servo import Servo
    from so101_motion.planning.timing.torque import Load

DEADMAN = 0.25
"""How long a velocity that is not repeated is kept up [s]. Chosen: a few periods of a page that
sends ten times a second."""

_TEXT_EVERY = 10  # ticks between two texts of ``held_by``, which take longer than a step
_HELD_BELOW = 0.9  # share of the wanted speed below which something is said to hold the tool


class Jog(OpenEndedMotion):
    """Turns velocities, poses and points into setpoints; made by ``Arm.jog``.

    Args:
        servo: Computes the steps; only this jog may use it, on the I/O thread.
        dt: How long a step takes [s].
        q_jaw: Says where the jaw is now [rad].
    """

    can_wait = False

    def __init__(self, servo: Servo, dt: float, q_jaw: Callable[[], float]) -> None:
        super().__init__("jog")
        self._servo, self._dt, self._q_jaw = servo, dt, q_jaw
        self._asked: tuple[Target, int] = (STILL, 0)  # what is asked for, and how often it was
        self._seen, self._age = 0, 0.0
        self._over = False
        self._ticks = 0
        self._held_by: tuple[str, ...] = ()

    @property
    def keeps_apart(self) -> bool:
        return self._servo.neighbours is not None

    # Any thread

    def twist(
        self, linear: ArrayLike, angular: ArrayLike = (0.0, 0.0, 0.0), *, in_tool: bool = False
    ) -> None:
        """Move the tool at a velocity for ``DEADMAN`` or until the next request.

        Where limits or obstacles do not allow this speed the tool moves slower.

        Args:
            linear: Velocity of the tool's origin, shape (3,), [m/s].
            angular: Its turning, shape (3,), [rad/s].
            in_tool: Whether both are in the axes of the tool instead of those of the base.

        Raises:
            ConfigError: These are not two finite velocities.
            MotionError: The jog is over; when it failed, the error says why.
        """
        speeds = given_array("linear", linear, (3,), "speeds in m/s")
        turning = given_array("angular", angular, (3,), "speeds in rad/s")
        wanted = Twist(linear=speeds, angular=turning, in_tool=in_tool)
        in_metres("linear", wanted.linear, per="/s")
        in_radians("angular", wanted.angular, 10.0, "/s")
        before = self._asked[0]
        same = isinstance(before, Twist) and before.same_as(wanted)
        self._ask(before if same else wanted)  # the line that the tool is on goes on

    def to_pose(self, T_base_tool: SE3) -> None:
        """Move to a pose, as straight as the joints allow, and stay there.

        The position comes first, the orientation as far as five joints can. ``ConfigError`` beyond
        ``geometry.FARTHEST``; ``MotionError`` if the jog is over.
        """
        self._ask(pose("T_base_tool", T_base_tool))

    def to_point(self, p_base: ArrayLike) -> None:
        """Move the tool's origin to ``p_base``, shape (3,), [m], and stay there.

        The orientation may be any. Raises as ``to_pose`` does.
        """
        self._ask(point("p_base", p_base))

    @property
    def held_by(self) -> tuple[str, ...]:
        """Why the tool does not move as asked, such as ``"the jaw close to the floor"``.

        Empty while it does; refreshed ten times a second.
        """
        return self._held_by

    def _ask(self, target: Target) -> None:
        self._refuse_if_over()
        self._asked = (target, self._asked[1] + 1)

    def keep_off(self, collision: CollisionModel, load: Load | None) -> None:
        """Check for contact and load with these from now on; only this jog may use them."""
        self._servo.keep_off(collision, load)

    # The I/O thread

    @property
    def start(self) -> Setpoint:
        return Setpoint(q=self._servo.q, qd=np.zeros(5), qdd=np.zeros(5))

    @property
    def is_over(self) -> bool:
        return self._over

    def sample(self, k: int) -> Setpoint:
        step = self._servo.step(self._target(), self._q_jaw())
        self._over = self._closing and not any([*step.qd.tolist(), *step.qdd.tolist()])
        if self._ticks % _TEXT_EVERY == 0:
            is_held = step.share < _HELD_BELOW or self._servo.is_short
            self._held_by = self._servo.held_by() if is_held else ()
        self._ticks += 1
        return Setpoint(q=step.q, qd=step.qd, qdd=step.qdd)

    def brake(self, now: Setpoint, limits: MotionLimits) -> Trajectory:
        """Brake along the path from the last setpoint that is known to be free."""
        dt, path = self._dt, self._servo.path_to_rest()
        path = np.concatenate((path, path[-1:]))
        qd, qdd = (path[2:] - path[:-2]) / (2.0 * dt), np.diff(path, 2, axis=0) / dt**2
        qd[-1] = qdd[-1] = 0.0
        slow = Trajectory(dt=dt, q=path[1:-1], qd=qd, qdd=qdd, duration=(len(path) - 3) * dt)
        return online.stop_on_path(slow, 0.0, limits, dt)

    def _target(self) -> Target:
        target, asked = self._asked
        self._age = self._age + self._dt if asked == self._seen else 0.0
        self._seen = asked
        is_forgotten = isinstance(target, Twist) and self._age > DEADMAN
        return STILL if self._closing or is_forgotten else target
