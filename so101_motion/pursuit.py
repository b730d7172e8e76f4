"""A motion that runs after a target which somebody else moves, such as a second arm led by hand.

The I/O thread asks for the next setpoint in every tick, and a ``Pursuit`` asks in turn where the
target is: no queue and no other thread lies between the two arms. Each setpoint is one period of
the fastest motion to the moving target (:func:`~.planning.online.towards`), so velocity,
acceleration and jerk are bounded whatever the target does.

*The reserve.* A setpoint is taken only if the joints could still stop from it, as hard as a stop
brakes, inside their limits, below the speed that nothing may exceed and, with a ``Guard``, without
touching anything. Otherwise they brake
at once, which the setpoint before has left room for. So wherever the target goes, no joint passes
its limit and nothing is touched; the joints wait where they came to rest.

*Nothing to run after.* While the one who aims has no target the joints slow to rest and stay there;
the pursuit goes on. Going on again is up to the one who aims: he is given the present setpoint and
says with every target how fast it may be approached.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from so101_motion.errors import PlanningError
from so101_motion.geometry import Array, frozen_array
from so101_motion.planning import online
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.trajectory import Setpoint
from so101_motion.units import to_rad

STOP_SAMPLES = 8
"""At how many postures the way to rest is looked at; the longest is about 0.5 s and 40 deg."""

ROOM = to_rad(2.0)
"""How much of the way to the target must be free before joints that were stopped by something set
off again [rad]; chosen: they do not creep up on it in tiny steps."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Aim:
    """Where a pursuit shall go in the coming period.

    Attributes:
        q: Where the target is at its end, shape (n,), [rad].
        qd: How fast it moves, shape (n,), [rad/s].
        limits: Caps of the pursuit.
    """

    q: Array
    qd: Array
    limits: MotionLimits


class Watch(Protocol):
    """Says whether a way may be gone."""

    def admits(self, way: Array) -> bool:
        """Whether the straight lines through ``way``, shape (m, n), [rad], may be gone."""


class Pursuit:
    """Hands out setpoints; made for an arm that mirrors another, and by ``Gripper.open_pursuit``.

    Args:
        aim: Told the present setpoint, says where to go; None for staying. Called by the I/O thread
            in every tick, so it must be brief.
        q_start: Where it begins, at rest, shape (n,), [rad].
        lower: Lower joint limits, shape (n,), [rad].
        upper: Upper joint limits, shape (n,), [rad].
        stop_limits: How hard a stop brakes; no less than any ``Aim.limits``.
        dt: The period [s].
        watch: Refuses ways that would touch something; None to look at nothing.

    Attributes:
        future: Completes when the joints are at rest after ``close``, or raises why it ended
            earlier.
        is_held: Whether something in the way holds the joints back.
    """

    def __init__(
        self,
        aim: Callable[[Setpoint], Aim | None],
        *,
        q_start: Array,
        lower: Array,
        upper: Array,
        stop_limits: MotionLimits,
        dt: float,
        watch: Watch | None = None,
    ) -> None:
        self.future: Future[None] = Future()
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

    def advance(self) -> Setpoint:
        """Where the joints shall be in the next tick."""
        aim = None if self._closing else self._aim(self._now)
        following, _ = self._braked()
        if aim is None:
            self.is_held = False
        else:
            following = self._led(aim, following)
        self._now = following
        return following

    def _led(self, aim: Aim, braked: Setpoint) -> Setpoint:
        """The next setpoint towards a target, or ``braked`` where that must not be."""
        fastest = _SLOWER * aim.limits.velocity
        qd_target = np.clip(aim.qd, -fastest, fastest)
        if self._watch is not None and self.is_held and not self._has_room(self._watch, aim.q):
            return braked
        try:
            led = online.towards(self._now, aim.q, qd_target, aim.limits, self._dt)
            led, way = self._inside(led, braked)
        except PlanningError:  # ruckig gives up on a few states in a million; the next is another
            return braked
        if self._watch is None or self._watch.admits(np.vstack([self._now.q, way])):
            self.is_held = False
            return led
        self.is_held = True
        return braked

    def _inside(self, led: Setpoint, braked: Setpoint) -> tuple[Setpoint, Array]:
        """``led``, but joints that could not stop in time brake; and the way to rest."""
        _, way = self._to_rest(led)
        outside = np.any((way < self._lower - _ROUNDING) | (way > self._upper + _ROUNDING), axis=0)
        # While its acceleration is taken back, a joint still gets faster.
        top = np.abs(led.qd + 0.5 * led.qdd * np.abs(led.qdd) / self._stop_limits.jerk)
        outside |= top > self._stop_limits.velocity
        if not outside.any():
            return led, way
        led = Setpoint(
            q=np.where(outside, braked.q, led.q),
            qd=np.where(outside, braked.qd, led.qd),
            qdd=np.where(outside, braked.qdd, led.qdd),
        )
        return led, self._to_rest(led)[1]

    def _braked(self) -> tuple[Setpoint, Array]:
        return self._to_rest(self._now)

    def _to_rest(self, now: Setpoint) -> tuple[Setpoint, Array]:
        return online.way_to_rest(now, self._stop_limits, self._dt, STOP_SAMPLES)

    def _has_room(self, watch: Watch, q_target: Array) -> bool:
        away = q_target - self._now.q
        share = min(1.0, ROOM / max(float(np.max(np.abs(away))), ROOM))
        return watch.admits(np.vstack([self._now.q, self._now.q + share * away]))


_ROUNDING = 1e-9
_SLOWER = 0.95  # than the pursuit must its target be, or it would never be caught
