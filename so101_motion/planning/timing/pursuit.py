"""Follow targets that move: the next setpoint of joints, in every control cycle.

Velocity, acceleration and jerk stay within their caps whatever the targets do. Otherwise as
``online.py``, whose words about ruckig hold here, too.
"""

from __future__ import annotations

import functools
import math
from typing import Literal

import numpy as np
import ruckig
from numpy.typing import ArrayLike

from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import Array
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.online import found_motion, numbers, searched
from so101_motion.planning.timing.trajectory import Setpoint

SOFTNESS = 0.035  # time constant with which a joint approaches its target [s]; chosen by trial
FORESIGHT = 0.05  # future accelerations are averaged over this [s]: a servo's delay

Arrival = Literal["each", "together", "straight"]

_SYNCHRONIZATION: dict[Arrival, ruckig.Synchronization] = {
    "each": ruckig.Synchronization.No,
    "together": ruckig.Synchronization.Time,
    "straight": ruckig.Synchronization.Phase,
}


class Pursuit:
    """Leads ``n`` joints to moving targets, one period ``dt`` [s] at a time. Belongs to one thread.

    It keeps its request to ruckig, because making one takes as long as the answer.
    """

    def __init__(self, n: int, dt: float) -> None:
        if not 0.0 < dt < math.inf:
            raise ValueError(f"dt must be positive and finite, got {dt}")
        self._n, self._dt = n, dt
        self._request, self._ruckig = ruckig.InputParameter(n), ruckig.Ruckig(n)
        self._request.target_position = [0.0] * n
        self._motion = ruckig.Trajectory(n)
        self._limits: MotionLimits | None = None
        self._rate = list[float]()
        self._arrival: ruckig.Synchronization | None = None

    def step(
        self,
        now: Setpoint,
        target: tuple[Array, Array, Array | None],
        limits: MotionLimits,
        arrival: Arrival,
    ) -> tuple[Setpoint, Array | None]:
        """``alongside`` of a target whose acceleration is known (not None), ``towards`` any other.

        Returns the setpoint, and the acceleration that ``alongside`` expects from there on.
        """
        q, qd, qdd = target
        if qdd is None:
            return self.towards(now, q, qd, limits, arrival=arrival), None
        return self.alongside(now, Setpoint(q=q, qd=qd, qdd=qdd), limits)

    def towards(
        self,
        now: Setpoint,
        q_target: ArrayLike,
        qd_target: ArrayLike,
        limits: MotionLimits,
        *,
        arrival: Arrival = "each",
    ) -> Setpoint:
        """One period of the fastest motion to a target that moves, slower than the velocity caps.

        Called in every period, it catches up with a target that moves steadily and stays with it
        without lag. The motion is computed relative to the target, as if that stood still. If it
        were computed to a position and a velocity instead, a joint slightly ahead would have to
        turn back to get behind that position, in every period.

        Each joint arrives as soon as it can, all together, or on a straight line if they start from
        rest.
        """
        return self._overtaking(now, q_target, qd_target, limits, arrival)[0]

    def alongside(
        self, now: Setpoint, target: Setpoint, limits: MotionLimits
    ) -> tuple[Setpoint, Array]:
        """The next setpoint beside a target whose acceleration at the end of the period is known.

        A joint near its target approaches it softly: its error decays with the time constant
        ``SOFTNESS``, and otherwise it accelerates like the target. A joint that would exceed a cap
        goes as fast as it may instead (``towards``). Also returns the joints' average acceleration
        during ``FORESIGHT`` from there on, shape (n,), [rad/s^2].
        """
        dt = self._dt
        before = target.qd - dt * target.qdd
        off = target.q - dt * (before + 0.5 * dt * target.qdd) - now.q
        gain, gain_d, gain_dd = _soft_gains(dt)
        jerk = gain * off + gain_d * (before - now.qd) + gain_dd * (target.qdd - now.qdd)
        qdd = now.qdd + dt * jerk
        qd = now.qd + dt * (now.qdd + 0.5 * dt * jerk)
        q = now.q + dt * (now.qd + dt * (0.5 * now.qdd + dt * jerk / 6.0))
        # The speed that a joint has when its acceleration has been taken back.
        fastest = np.abs(qd + qdd * np.abs(qdd) / (2.0 * limits.jerk))
        soft = (np.abs(jerk) <= limits.jerk) & (np.abs(qdd) <= limits.acceleration)
        soft &= (np.abs(qd) <= limits.velocity) & (fastest <= limits.velocity)
        if soft.all():
            return Setpoint(q=q, qd=qd, qdd=qdd), target.qdd
        fast, motion = self._overtaking(now, target.q, target.qd, limits, "each")
        later = target.qd + motion.at_time(dt + FORESIGHT)[1]
        setpoint = Setpoint(
            q=np.where(soft, q, fast.q),
            qd=np.where(soft, qd, fast.qd),
            qdd=np.where(soft, qdd, fast.qdd),
        )
        return setpoint, np.where(soft, target.qdd, (later - fast.qd) / FORESIGHT)

    def _overtaking(
        self,
        now: Setpoint,
        q_target: ArrayLike,
        qd_target: ArrayLike,
        limits: MotionLimits,
        arrival: Arrival,
    ) -> tuple[Setpoint, ruckig.Trajectory]:
        """The setpoint of ``towards``, and the motion relative to the target."""
        dt = self._dt
        goal, speed = (np.asarray(each, dtype=np.float64) for each in (q_target, qd_target))
        arrays = now.q, now.qd, now.qdd, goal, speed
        q, qd, qdd, to, rate = rows = [each.tolist() for each in arrays]
        if not (set(map(len, rows)) == {self._n} and math.isfinite(sum(map(sum, rows)))):
            numbers(limits, dt, q=q, qd=qd, qdd=qdd, q_target=to, qd_target=rate)  # says which
        off = [at - (end - dt * v) for at, end, v in zip(q, to, rate, strict=True)]
        slip = [v - w for v, w in zip(qd, rate, strict=True)]
        found = self._found([off, slip, qdd], rate, limits, _SYNCHRONIZATION[arrival])
        seen = found.at_time(dt)
        moved = np.array(seen)
        moved[0] += goal
        moved[1] += speed
        return Setpoint(q=moved[0], qd=moved[1], qdd=moved[2]), found

    def _found(
        self,
        state: list[list[float]],
        rate: list[float],
        limits: MotionLimits,
        arrival: ruckig.Synchronization,
    ) -> ruckig.Trajectory:
        """The motion from a state relative to the target, which moves at ``rate`` [rad/s]."""
        request = self._request
        if limits is not self._limits or rate != self._rate:
            if len(rate) != self._n:  # ruckig would accept it
                raise ValueError(f"expected {self._n} joints, got {len(rate)}")
            fastest = limits.velocity.tolist()
            request.max_velocity = [cap - v for cap, v in zip(fastest, rate, strict=True)]
            request.min_velocity = [-cap - v for cap, v in zip(fastest, rate, strict=True)]
            request.max_acceleration = limits.acceleration.tolist()
            request.max_jerk = limits.jerk.tolist()
            self._limits, self._rate = limits, rate
        request.current_position, request.current_velocity, request.current_acceleration = state
        if arrival is not self._arrival:
            request.synchronization = self._arrival = arrival
        try:
            return searched(request, self._ruckig, self._motion)
        except PlanningError:
            self._limits = None  # the request gets less jerk
            return found_motion(request)


@functools.cache
def _soft_gains(dt: float) -> tuple[float, float, float]:
    """Gains from the errors of angle, speed and acceleration to the jerk.

    Ackermann's formula for three equal poles of a joint whose jerk is constant for ``dt`` [s].
    """
    step = np.array([[1.0, dt, dt**2 / 2.0], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    push = np.array([dt**3 / 6.0, dt**2 / 2.0, dt])
    poles = step - math.exp(-dt / SOFTNESS) * np.eye(3)
    reached = np.column_stack([push, step @ push, step @ step @ push])
    gains = np.linalg.solve(reached.T, [0.0, 0.0, 1.0]) @ poles @ poles @ poles
    return tuple(gains.tolist())
