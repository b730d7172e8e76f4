"""Jog the tool with velocities, poses and points that are sent again and again.

In every tick a ``ToolReference`` (``planning/differential``) leads the joints towards the newest
request, and they follow it as they follow any target; so the path to rest after each setpoint is
proven. A velocity must be repeated: without one for ``DEADMAN`` the arm slows to rest. A pose or a
point is reached and held.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.errors import ConfigError, MotionError
from so101_motion.common.geometry import SE3, Array, in_metres, in_radians, point
from so101_motion.control.following import Aim, Following, gentle
from so101_motion.planning.collision.course import Neighbours
from so101_motion.planning.differential.targets import STILL, Target, Twist
from so101_motion.planning.differential.tool_reference import ToolReference
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.pursuit import Arrival
from so101_motion.planning.timing.trajectory import Setpoint, Trajectory

if TYPE_CHECKING:
    from so101_motion.planning.differential.guard import Guard
    from so101_motion.planning.kinematics.model import RobotModel

DEADMAN = 0.25
"""How long a velocity that is not repeated is kept up [s]. Chosen: a few periods of a page that
sends ten times a second."""

SPARED = (0.95, 0.8)
"""Shares of the speed and the jerk of the joints that the reference uses. Chosen: they are to stay
beside it, and could not catch up with one that is as fast as they may be."""

LOST = 0.1
"""The reference begins anew where the joints are if they are as far off [rad]; chosen: joints that
stay beside it are 0.01 off at most."""


BESIDE = 1e-9  # joints nearer than this to the reference are beside it [rad]; rounding


class Jog(Following):
    """A following that takes velocities, poses and points of a frame; made by ``Arm.jog``."""

    can_wait = False
    _drives_ahead = False  # it brakes as softly as it speeds up

    def __init__(
        self,
        model: RobotModel,
        *,
        q_start: Array,
        limits: MotionLimits,
        stop_limits: MotionLimits,
        dt: float,
        guard: Guard | None,
        neighbours: Neighbours | None = None,
        frame: str = "tool",
    ) -> None:
        spared = replace(limits, velocity=SPARED[0] * limits.velocity, jerk=SPARED[1] * limits.jerk)
        self._reference = ToolReference(model, spared, dt, q_start, frame)
        self._most_jerk = spared.jerk * (1.0 + BESIDE)
        self._asked: tuple[Target, int] = (STILL, 0)  # what is asked for, and how often it was
        self._heard, self._age, self._is_refused = 0, 0.0, False
        super().__init__(
            q_start=q_start,
            lower=model.lower,
            upper=model.upper,
            limits=limits,
            # It brakes no harder than it speeds up: on the line that it is on.
            stop_limits=gentle(
                stop_limits.lowered_to(limits.velocity, limits.acceleration), limits
            ),
            dt=dt,
            guard=guard,
            neighbours=neighbours,
        )
        self._name = "jog"

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
        try:
            wanted = Twist(
                linear=np.asarray(linear, dtype=np.float64),
                angular=np.asarray(angular, dtype=np.float64),
                in_tool=in_tool,
            )
        except (TypeError, ValueError) as error:
            raise ConfigError("twist", [linear, angular], str(error)) from error
        in_metres("linear", wanted.linear, per="/s")
        in_radians("angular", wanted.angular, 10.0, "/s")
        before = self._asked[0]
        same = isinstance(before, Twist) and before.same_as(wanted)
        self._wish(before if same else wanted)  # the line that the tool is on goes on

    def to_pose(self, T_base_tool: SE3) -> None:
        """Move to a pose, as straight as the joints allow, and stay there.

        The position comes first, the orientation as far as five joints can. ``ConfigError`` beyond
        ``geometry.FARTHEST``; ``MotionError`` if the jog is over.
        """
        _check_place(T_base_tool.p)
        self._wish(T_base_tool)

    def to_point(self, p_base: ArrayLike) -> None:
        """Move the tool's origin to ``p_base``, shape (3,), [m], and stay there.

        The orientation may be any. Raises as ``to_pose`` does.
        """
        self._wish(_check_place(p_base))

    def aim(self, q: ArrayLike, qd: ArrayLike | None = None, qdd: ArrayLike | None = None) -> Array:
        """Raise ``MotionError``: joint targets are for a following."""
        raise MotionError("a jog takes no joint targets; use to_pose, or open a following")

    def hold(self, *, briefly: bool = False) -> None:
        """Slow down and wait for the next request."""
        self._wish(STILL)

    @property
    def held_by(self) -> tuple[str, ...]:
        """Why the tool does not move as asked, such as ``"the jaw close to the floor"``.

        Empty while it does.
        """
        return (*super().held_by, *self._reference.slowed_by)

    def _wish(self, target: Target) -> None:
        self._refuse_if_over()
        self._asked = (target, self._asked[1] + 1)

    # The I/O thread

    def brake(self, now: Setpoint, limits: MotionLimits) -> Trajectory:
        """Brake along the path on which the jog would stop, which is known to be free."""
        slow = online.stop(now.q, now.qd, now.qdd, self._stop_limits, self._dt)
        return online.stop_on_path(slow, 0.0, limits, self._dt)

    def _current(self) -> Aim:
        reference = self._reference
        if self._is_refused or np.abs(reference.now.q - self.now.q).max() > LOST:
            reference.restart(self.now)
        self._is_refused = False
        led = reference.step(self._target(), self.guard, self.now.q, self._others())
        rests = not (led.qd.any() or led.qdd.any())
        return Aim(led.q, led.qd, None if rests else led.qdd, self._still)

    def _next(
        self, target: tuple[Array, Array, Array | None], limits: MotionLimits, arrival: Arrival
    ) -> tuple[Setpoint, Array | None]:
        """The reference itself, if the joints are beside it: it keeps all limits."""
        led, now, dt = self._reference.now, self.now, self._dt
        mean = now.qd - 0.5 * dt * now.qdd + dt * led.qdd  # speed in this step
        apart = np.abs(led.q - now.q - dt * mean).max()
        if apart < BESIDE and (np.abs(led.qdd - now.qdd) <= dt * self._most_jerk).all():
            return led, None
        return super()._next(target, limits, arrival)

    def _drawn_back(self, guard: Guard, q: Array) -> Array:
        return q  # the reference is

    def _begin_at(self, now: Setpoint) -> None:
        super()._begin_at(now)
        self._is_refused = True  # a reference would be led from elsewhere

    def _brake(self) -> None:
        self._is_refused = True
        super()._brake()

    def _target(self) -> Target:
        target, asked = self._asked
        self._age = self._age + self._dt if asked == self._heard else 0.0
        self._heard = asked
        is_forgotten = isinstance(target, Twist) and self._age > DEADMAN
        return STILL if self._closing or is_forgotten else target


def _check_place(p: ArrayLike) -> Array:
    place = point("point", p)
    if not np.isfinite(place).all():
        raise ConfigError("point", p, "must be three finite numbers [m]")
    return place
