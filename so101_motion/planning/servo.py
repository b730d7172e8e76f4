"""Moving the tool under somebody's hand: one small step at a time, safe after every one.

Each step answers: given where the tool shall go, what velocity may the joints have next? How it
works:

*The wish* (:mod:`servo_wish`). A twist, a pose or a point becomes joint velocities.

*The room.* A wish that keeps all limits is granted as it is. Otherwise a quadratic program
(:mod:`servo_qp`) finds what comes nearest: bounds of velocity and acceleration; and for each joint
limit and each pair of bodies near each other, what is left of the way must suffice to brake on, so
they are approached more and more slowly.

*The certificate.* Joints that brake together, each in proportion to its speed, run along a straight
joint line. The last step left such a line that is free, to its end inside the limits. A new
velocity is taken only if it leaves one too, which the distances at hand show or
``CollisionModel`` proves; otherwise the arm brakes along the line it has. So whatever is asked for,
and however wrong a linearised distance may be, the arm can always stop and never touches anything.

Velocities and accelerations are the first and second differences of the positions, exactly. Jerk is
not bounded: an arm led by hand answers at once, at accelerations that are the arm's own.

``Step.share`` says how much of the wish was granted, and :meth:`Servo.held_by` in words what stands
against the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.geometry import Array, frozen_array
from so101_motion.planning.arm_measure import measure_structure
from so101_motion.planning.bodies import NEAR
from so101_motion.planning.collision import CollisionModel, Near
from so101_motion.planning.limits import MotionLimits
from so101_motion.planning.model import RobotModel
from so101_motion.planning.servo_qp import ROWS, ServoQp
from so101_motion.planning.servo_wish import SAME, Wish, Wisher
from so101_motion.planning.targets import Target
from so101_motion.state import ARM_JOINTS

RANGE = 0.05
"""From how near on, beyond the margin, bodies are approached more slowly [m]. Chosen: a tool that
moves at 0.25 m/s brakes within that at 0.6 m/s^2; what comes faster the certificate stops."""

STRAIGHT = 0.05
"""How far from straight the elbow stays, on the side where it was at the start [rad]. On the other
side the same motion leads back again, and joints that cannot turn round at once would swing to and
fro between the two. Chosen: it costs 0.1 mm of reach."""

GAP = 0.002
"""What stays free beyond the margin when something is approached [m]. Chosen: the certificate,
which goes by the margin itself, then has nothing to refuse."""

CLOSE = 0.02
"""A joint is said to be at its limit when it would come to rest so near it [rad]. Chosen."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """What the joints do next.

    Attributes:
        q: Positions, shape (5,), [rad].
        qd: Velocities, shape (5,), [rad/s].
        qdd: Accelerations, shape (5,), [rad/s^2].
        share: How much of what was wanted is granted, 0 to 1.
    """

    q: Array
    qd: Array
    qdd: Array
    share: float


class _Room(NamedTuple):
    """How the joints may move in a step.

    Attributes:
        lower: Smallest velocities, shape (5,), [rad/s].
        upper: Largest velocities, shape (5,), [rad/s].
        G: How velocities change the distance of each pair of bodies, shape (k, 5), [m/rad].
        b: How fast each may change at least, shape (k,), [m/s].
        near: Those pairs.
    """

    lower: Array
    upper: Array
    G: Array
    b: Array
    near: list[Near]

    def has(self, qd: Array) -> bool:
        """Whether velocities keep all of it."""
        if (qd < self.lower).any() or (qd > self.upper).any():
            return False
        return not (self.G @ qd < self.b).any()


class Servo:
    """Follows targets from a posture on. Belongs to one thread.

    A start outside the limits may be returned to, and bodies that are too close at the start may
    only part.

    Args:
        model: The arm.
        collision: What is in the way; for this servo alone.
        limits: Velocity and acceleration caps.
        dt: How long a step takes [s].
        q_start: Where the arm is at rest, shape (5,), [rad].
        frame: Which frame of the gripper is led.

    Attributes:
        q: Where the joints are wanted now, shape (5,), [rad].
        qd: Their velocities, shape (5,), [rad/s].
        braking_time: How long they need to come to rest, all in proportion [s].
    """

    def __init__(
        self,
        model: RobotModel,
        collision: CollisionModel,
        limits: MotionLimits,
        dt: float,
        q_start: ArrayLike,
        *,
        frame: str = "tool",
    ) -> None:
        self.q, self.qd, self.braking_time = frozen_array(q_start, (5,)), np.zeros(5), 0.0
        self._model, self._collision, self._limits, self._dt = model, collision, limits, dt
        self._wisher, self._qp = Wisher(model, limits, dt, frame), ServoQp()
        self._lower, self._upper = _way_of(model, self.q)
        self._margins = collision.margins
        self._widest = float(collision.margins.max(initial=collision.margin))
        self._range = min(NEAR, self._widest + RANGE)
        self._last: tuple[Wish, _Room] | None = None

    @property
    def q_rest(self) -> Array:
        """Where the joints come to rest if they brake now, shape (5,), [rad]."""
        return np.asarray(self.q + 0.5 * self.braking_time * self.qd)

    def step(self, target: Target, q_jaw: float = 0.0) -> Step:
        """Move on by one step towards a target, or brake.

        Args:
            target: What is wanted.
            q_jaw: Jaw angle [rad].
        """
        rest = self.q_rest
        wish = self._wisher.wish(target, self.q, rest - self._lower, self._upper - rest)
        time = self.braking_time
        brake = self.qd * max(0.0, 1.0 - self._dt / time) if time > 0.0 else self.qd
        if not wish.qd.any():
            self._last = None
            return self._taken(brake, self._time_to_brake(brake), 1.0)
        near = self._collision.nearest(self.q, q_jaw, within=self._range)
        near.sort(key=_free)
        room = self._room(near[:ROWS], brake)
        qd, share = wish.qd, 1.0
        if not room.has(qd):
            share = self._attainable(qd)
            qd = share * qd
        if room.has(qd):
            self._wisher.grant(share)
        else:
            qd, granted = self._qp.solve(wish.J, qd, *room[:4])
            share *= granted
            self._wisher.refuse()
        time = self._time_to_brake(qd)
        if not self._can_stop(qd, time, near, q_jaw):
            qd, share, time = brake, 0.0, self._time_to_brake(brake)
            self._wisher.refuse()
        self._last = (wish, room)
        return self._taken(qd, time, share)

    def held_by(self) -> tuple[str, ...]:
        """In words, what stood against the wish of the last step.

        Such as ``"elbow_flex at its upper limit"`` or ``"the jaw close to the floor"``; that the
        joints were still gaining speed is not told.
        """
        if self._last is None:
            return ()
        wish, room = self._last
        told = [word for i in range(5) if (word := self._limit_of(i, wish.qd[i]))]
        called = self._collision.scene.called
        for each, gain, least in zip(room.near, room.G @ wish.qd, room.b, strict=True):
            if gain < least:
                told.append(f"{called(each.first)} close to {called(each.second)}")
        if wish.is_damped:
            told.append("the arm nearly straight, or over its own base")
        return tuple(told)

    def _room(self, near: list[Near], brake: Array) -> _Room:
        """Velocities that leave way enough to brake, after this step as well."""
        # The joints may become a step's worth faster, and would brake as much longer.
        time = 1.5 * self._dt + 0.5 * self.braking_time
        below, above = (self._lower - self.q) / time, (self._upper - self.q) / time
        G = np.array([each.gradient for each in near]).reshape(-1, 5)
        b = np.array([GAP - _free(each) for each in near]) / time
        gain = G @ brake
        late = b - 0.5 * GAP / time  # what is short by less, the certificate need not mind
        change, top = self._limits.acceleration * self._dt, self._limits.velocity
        is_late = ((late > gain) & (gain < 0.0)).any()
        if is_late or (below > brake).any() or (above < brake).any():
            # Something takes full braking now. The others go on if they can be as late as that.
            left = max(0.0, self.braking_time - self._dt)
            top = np.minimum(top, self._limits.acceleration * left)
        lower = np.maximum(np.maximum(self.qd - change, -top), below)
        upper = np.minimum(np.minimum(self.qd + change, top), above)
        # Braking is always among them.
        return _Room(
            np.minimum(lower, brake), np.maximum(upper, brake), G, np.minimum(b, gain), near
        )

    def _attainable(self, wish: Array) -> float:
        """The share of a wish that speeds and accelerations allow now, its direction kept.

        Of a joint that has to turn round it is no more than it can do from rest.
        """
        size, limits = np.abs(wish), self._limits
        change = limits.acceleration * self._dt
        along = np.maximum(np.sign(wish) * self.qd, 0.0) + change
        moves = size > SAME
        return min(1.0, float((np.minimum(along, limits.velocity)[moves] / size[moves]).min()))

    def _can_stop(self, qd: Array, time: float, near: list[Near], q_jaw: float) -> bool:
        """Whether a step with velocities that take ``time`` to brake leaves a free line for it."""
        way = (self._dt + 0.5 * time) * qd
        end = self.q + way
        if (end < self._lower - SAME).any() or (end > self._upper + SAME).any():
            return False
        free = self._range - self._widest
        if near:
            free = min(free, _free(near[0]))
        travel = float(np.abs(way) @ self._collision.reach)
        if travel <= free:
            return True
        if free >= 0.0:  # no point moves so far without the line's help
            line = np.array([self.q + (free / travel) * way, end])
            return self._collision.blocked_posture(line, q_jaw) is None
        # Bodies that are too close may part, if no others become too close.
        postures = (self.q, self.q + self._dt * qd, end)
        now, next_, then = (self._collision.distances(q, q_jaw) for q in postures)
        kept = np.minimum(now, self._margins)
        return bool((next_ >= kept).all() and (then >= kept).all())

    def _taken(self, qd: Array, time: float, share: float) -> Step:
        qdd = (qd - self.qd) / self._dt
        self.q, self.qd = self.q + self._dt * qd, qd
        self.braking_time = time
        return Step(q=self.q, qd=qd, qdd=qdd, share=share)

    def _time_to_brake(self, qd: Array) -> float:
        return float((np.abs(qd) / self._limits.acceleration).max())

    def _limit_of(self, i: int, wanted: float) -> str | None:
        """What keeps a joint from a velocity."""
        up, speed = wanted > 0.0, abs(wanted)
        left = self._upper[i] - self.q_rest[i] if up else self.q_rest[i] - self._lower[i]
        if left < CLOSE and speed > 0.5 * left / self._dt:
            limit = self._model.upper[i] if up else self._model.lower[i]
            if abs(limit - self.q[i]) > 2.0 * CLOSE:
                return "the arm stretched out"
            return f"{ARM_JOINTS[i]} at its {'upper' if up else 'lower'} limit"
        if speed > self._limits.velocity[i]:
            return f"{ARM_JOINTS[i]} at its top speed"
        return None


def _free(pair: Near) -> float:
    """How much nearer two bodies may come [m]."""
    return pair.distance - pair.margin


def _way_of(model: RobotModel, q: Array) -> tuple[Array, Array]:
    """Between which angles the joints may move that start at ``q``, shapes (5,), [rad]."""
    lower, upper = model.lower.copy(), model.upper.copy()
    structure = measure_structure(model)
    if structure is not None:
        straight = structure.bars.straight
        if q[2] >= straight:
            lower[2] = max(lower[2], straight + STRAIGHT)
        else:
            upper[2] = min(upper[2], straight - STRAIGHT)
    return np.minimum(lower, q), np.maximum(upper, q)
