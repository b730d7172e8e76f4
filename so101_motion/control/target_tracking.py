"""Follow a moving target, such as a second arm that is led by hand.

In every tick the I/O thread asks a ``Pursuit`` for the next setpoint, and that asks where the
target is: no queue and no other thread lies between. Each setpoint is one period of
the fastest motion to the moving target (:func:`~.planning.online.towards`), so velocity,
acceleration and jerk are bounded whatever the target does.

*The reserve.* A setpoint is taken only if the joints could still stop from it, as hard as a stop
brakes, inside their limits, below the speed that nothing may exceed and, with a ``Guard``, without
touching anything. Otherwise they brake
at once, which the setpoint before has left room for.

*No target.* While there is none the joints slow to rest and wait; the pursuit goes on. Every target
says how fast it may be approached.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import Array, frozen_array
from so101_motion.common.units import to_rad
from so101_motion.control.request_queue import running_future
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint, Trajectory

STOP_SAMPLES = 8
"""At how many configurations the path to rest is checked; the longest is 0.5 s and 40 deg."""

ROOM = to_rad(2.0)
"""How much of the path to the target must be free before joints that were held back set off
again [rad]; chosen: they do not creep up on it in tiny steps."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackingTarget:
    """Where a pursuit shall go in the coming period.

    Attributes:
        q: Where the target is at its end, shape (n,), [rad].
        qd: How fast it moves, shape (n,), [rad/s].
        limits: Caps of the pursuit.
    """

    q: Array
    qd: Array
    limits: MotionLimits


class PathCheck(Protocol):
    """Checks paths for collisions."""

    def admits(self, path: Array) -> bool:
        """Whether the straight lines through ``path``, shape (m, n), [rad], are free."""


class Pursuit:
    """Hands out setpoints; made for an arm that mirrors another, and by ``Gripper.open_pursuit``.

    Args:
        aim: Given the present setpoint, says where to go; None for staying. Called in every tick,
            so it must be brief.
        q_start: Where it begins, at rest, shape (n,), [rad].
        lower: Lower joint limits, shape (n,), [rad].
        upper: Upper joint limits, shape (n,), [rad].
        stop_limits: How hard a stop brakes; no less than any ``TrackingTarget.limits``.
        dt: The period [s].
        watch: Refuses paths that would touch something; None to check nothing.

    Attributes:
        future: Completes when the joints are at rest after ``close``, or raises why it ended
            earlier.
        is_held: Whether an obstacle holds the joints back.
    """

    can_wait = False

    def __init__(
        self,
        aim: Callable[[Setpoint], TrackingTarget | None],
        *,
        q_start: Array,
        lower: Array,
        upper: Array,
        stop_limits: MotionLimits,
        dt: float,
        watch: PathCheck | None = None,
    ) -> None:
        self.future: Future[None] = running_future()
        self.is_held = False
        q_start = frozen_array(q_start, (-1,))
        rest = np.zeros(len(q_start))
        self.start = self._now = Setpoint(q=q_start, qd=rest, qdd=rest)
        self._aim, self._watch = aim, watch
        # An arm that rests a little outside may stay there, and come in.
        self._lower, self._upper = np.minimum(lower, q_start), np.maximum(upper, q_start)
        self._stop_limits, self._dt = stop_limits, dt
        self._closing = False

    # Any thread

    def close(self) -> Future[None]:
        """Slow to rest and end; may be called again."""
        self._closing = True
        return self.future

    # The I/O thread

    @property
    def is_over(self) -> bool:
        """Whether it has been closed and the last setpoint was at rest."""
        return self._closing and not (self._now.qd.any() or self._now.qdd.any())

    def sample(self, k: int) -> Setpoint:
        """Where the joints shall be in the next tick, whichever it is."""
        aim = None if self._closing else self._aim(self._now)
        following, _ = self._braked()
        if aim is None:
            self.is_held = False
        else:
            following = self._led(aim, following)
        self._now = following
        return following

    def brake(self, now: Setpoint, limits: MotionLimits) -> Trajectory:
        """To rest, every joint for itself."""
        return online.stop(now.q, now.qd, now.qdd, limits, self._dt)

    def _led(self, aim: TrackingTarget, braked: Setpoint) -> Setpoint:
        """The next setpoint towards a target, or ``braked`` where that must not be."""
        fastest = _SLOWER * aim.limits.velocity
        qd_target = np.clip(aim.qd, -fastest, fastest)
        if self._watch is not None and self.is_held and not self._has_room(self._watch, aim.q):
            return braked
        try:
            led = online.towards(self._now, aim.q, qd_target, aim.limits, self._dt)
            led, path = self._inside(led, braked)
        except PlanningError:  # ruckig gives up on a few states in a million; the next is another
            return braked
        if self._watch is None or self._watch.admits(np.vstack([self._now.q, path])):
            self.is_held = False
            return led
        self.is_held = True
        return braked

    def _inside(self, led: Setpoint, braked: Setpoint) -> tuple[Setpoint, Array]:
        """``led``, but joints that could not stop in time brake; and the path to rest."""
        _, path = self._to_rest(led)
        outside = np.any(
            (path < self._lower - _ROUNDING) | (path > self._upper + _ROUNDING), axis=0
        )
        # While its acceleration is taken back, a joint still gets faster.
        top = np.abs(led.qd + 0.5 * led.qdd * np.abs(led.qdd) / self._stop_limits.jerk)
        outside |= top > self._stop_limits.velocity
        if not outside.any():
            return led, path
        led = Setpoint(
            q=np.where(outside, braked.q, led.q),
            qd=np.where(outside, braked.qd, led.qd),
            qdd=np.where(outside, braked.qdd, led.qdd),
        )
        return led, self._to_rest(led)[1]

    def _braked(self) -> tuple[Setpoint, Array]:
        return self._to_rest(self._now)

    def _to_rest(self, now: Setpoint) -> tuple[Setpoint, Array]:
        return online.path_to_rest(now, self._stop_limits, self._dt, STOP_SAMPLES)

    def _has_room(self, watch: PathCheck, q_target: Array) -> bool:
        away = q_target - self._now.q
        share = min(1.0, ROOM / max(float(np.max(np.abs(away))), ROOM))
        return watch.admits(np.vstack([self._now.q, self._now.q + share * away]))


_ROUNDING = 1e-9
_SLOWER = 0.95  # than the pursuit must its target be, or it would never be caught
