"""Lead joints so that the tool moves as a jog asks: the next joint angles, step by step.

*The task velocity* (``task_velocity.py``). A twist, a pose or a point becomes joint velocities.

*The bounds.* Of these as much is taken as the joints' caps of speed and acceleration allow. With a
``Guard`` the velocity is the nearest one that leaves room to brake for each near pair of bodies and
each joint near its torque limit, so these are approached more and more slowly (B. Faverjon, P.
Tournassoud, A local based approach for path planning of manipulators with a high number of degrees
of freedom, ICRA 1987). Slower on the tool's line counts as nearer than as fast beside it.

*The moving average.* Such a motion has no bound of jerk. Its mean over a window of ``2 a / j``
seconds bounds the jerk by ``j`` and keeps every bound that its input keeps. All joints are late by
half of it, so a straight line stays straight, and an input that stands still is reached exactly (L.
Biagiotti, C. Melchiorri, FIR filters for online trajectory planning, 2012).

Nothing is proven here: whoever follows this (``control/cartesian_jog.py``) has to look.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.planning.collision.course import NearArms
from so101_motion.planning.differential.guard import Guard
from so101_motion.planning.differential.targets import Target
from so101_motion.planning.differential.task_velocity import SAME, TaskControl, braking_speed
from so101_motion.planning.kinematics.geometry_from_model import measure_structure
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint

STRAIGHT = 0.05
"""Smallest bend of the elbow, on the side where it was at the start [rad]. Beyond straight the same
motion leads back again, and joints that cannot turn round at once would swing to and fro. Chosen:
it costs 0.1 mm of reach."""

HELD_BELOW = 0.9  # share of the wanted speed below which something is said to hold the tool
WORTH = 0.02  # of the full velocity against its direction; chosen: it slides at a slant
_TOOL = np.array([25.0, 25.0, 25.0, 0.05, 0.05, 0.05])
"""Weights of deviations of the tool [s^2/m^2], [s^2/rad^2]: about one for a full speed of each."""
_OWN = 0.05 * np.eye(5)  # weights of deviations of the joints [s^2/rad^2]


class ToolReference:
    """Leads joints from rest at ``q_start``, shape (5,), [rad]. Belongs to one thread.

    A joint that starts outside its limits may stay there.

    Attributes:
        now: The last setpoint.
        share: Which share of the task velocity the last step granted, 0 to 1.
        slowed_by: What took the rest of it, other than the guard, in words.
    """

    def __init__(
        self,
        model: RobotModel,
        limits: MotionLimits,
        dt: float,
        q_start: Array,
        frame: str = "tool",
    ) -> None:
        self._model, self._limits, self._dt = model, limits, dt
        self._task = TaskControl(model, limits, dt, frame)
        self._lower, self._upper = _range_with(model, q_start)
        window = 2.0 * float((limits.acceleration / limits.jerk).max())
        self._averaged = max(1, math.ceil(window / dt - 1e-9))
        self.share, self.slowed_by = 1.0, tuple[str, ...]()
        self.restart(Setpoint.at_rest(q_start))

    def restart(self, now: Setpoint) -> None:
        """Go on from another setpoint, as if it had been reached at its present speed."""
        late = self._dt * np.arange(1.0 - self._averaged, 1.0)[:, None] * now.qd
        self._trail = now.q - late.mean(axis=0) + late  # what is averaged, the oldest first
        self._qd, self.now = now.qd, now
        self._task.refuse()

    def step(
        self,
        target: Target,
        guard: Guard | None = None,
        q_arm: Array | None = None,
        others: Sequence[NearArms] = (),
    ) -> Setpoint:
        """Move on by one step towards a target, slowed down by what ``guard`` finds near.

        ``others``: near bodies of other arms.
        """
        q, dt, most = self._trail[-1], self._dt, self._limits.acceleration
        time = float((np.abs(self._qd) / most).max())
        rest = q + 0.5 * time * self._qd
        wanted = self._task.velocity(target, q, rest - self._lower, self._upper - rest)
        share = self._attainable(wanted.qd)
        qd = share * wanted.qd
        # The joints may become a step's worth faster, and would brake as much longer.
        ahead = 1.5 * dt + 0.5 * (time + float((most / self._limits.jerk).max()))
        free = qd
        if guard is not None:
            at = q if q_arm is None else q_arm
            free = guard.within_reach(at, q + ahead * qd, others, lambda: _weights(wanted.J, qd))
            free = (free - q) / ahead
        left = np.maximum(np.where(free > 0.0, self._upper - q, q - self._lower), 0.0)
        fastest = braking_speed(left, most, dt)
        free = np.minimum(np.maximum(free, -fastest), fastest)
        if (np.abs(free - qd) > SAME).any():
            size = float(qd @ qd)
            share *= min(1.0, max(0.0, float(free @ qd) / size)) if size else 1.0
            self._task.refuse()
        change = free - self._qd
        much = float((np.abs(change) / (dt * most)).max())
        if much > 1.0 + SAME:
            free = self._qd + change / much
            self._task.refuse()
        else:
            self._task.grant(share)
        self.share, self._qd = share, free
        self.slowed_by = ()
        if share < HELD_BELOW:
            named = [self._limit_of(i, wanted.qd[i], fastest[i]) for i in range(5)]
            if wanted.is_damped:
                named.append("the arm nearly straight, or over its own base")
            self.slowed_by = tuple(dict.fromkeys(filter(None, named)))
        return self._averaged_with(q + dt * free)

    def _averaged_with(self, q: Array) -> Setpoint:
        self._trail[:-1] = self._trail[1:]
        self._trail[-1] = q
        # Relative to the reference, so that it is exact when all are the same.
        q = q + (self._trail - q).sum(axis=0) / self._averaged
        now, dt = self.now, self._dt
        # The speed at the end of a step is half a step's gain above the mean speed in it.
        qdd = ((q - now.q) / dt - now.qd) / dt + 0.5 * now.qdd
        self.now = Setpoint(q=q, qd=(q - now.q) / dt + 0.5 * dt * qdd, qdd=qdd)
        return self.now

    def _attainable(self, wanted: Array) -> float:
        """The share of a task velocity that speed and acceleration limits allow now.

        Its direction is kept; a joint that has to turn round gets no more than from rest.
        """
        size, limits = np.abs(wanted), self._limits
        moves = size > SAME
        along = np.maximum(np.sign(wanted) * self._qd, 0.0) + limits.acceleration * self._dt
        most = np.minimum(along, limits.velocity)[moves] / size[moves]
        return min(1.0, float(most.min(initial=1.0)))

    def _limit_of(self, i: int, wanted: float, fastest: float) -> str | None:
        """The limit that keeps a joint from a velocity, for messages; None if none does."""
        up = wanted > 0.0
        if abs(wanted) > fastest:
            mine, its = (self._upper, self._model.upper) if up else (self._lower, self._model.lower)
            if mine[i] != its[i]:
                return "the arm stretched out"
            return f"{ARM_JOINTS[i]} at its {'upper' if up else 'lower'} limit"
        is_fast = abs(wanted) > self._limits.velocity[i]
        return f"{ARM_JOINTS[i]} at its top speed" if is_fast else None


def _weights(J: Array, qd: Array) -> Array:
    """How much deviations from ``qd`` (5,) count, for a guard: those along it ``WORTH``."""
    weights: Array = (J.T * _TOOL) @ J + _OWN
    along = weights @ qd
    if (size := float(along @ qd)) > 0.0:
        weights -= np.outer(along, along) / (size * (1.0 + WORTH))
    return weights


def _range_with(model: RobotModel, q: Array) -> tuple[Array, Array]:
    """Lower and upper bounds for joints that start at ``q``, shapes (5,), [rad]."""
    lower, upper = model.lower.copy(), model.upper.copy()
    structure = measure_structure(model)
    if structure is not None:
        straight = structure.bars.straight
        if q[2] >= straight:
            lower[2] = max(lower[2], straight + STRAIGHT)
        else:
            upper[2] = min(upper[2], straight - STRAIGHT)
    return np.minimum(lower, q), np.maximum(upper, q)
