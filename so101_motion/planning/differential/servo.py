"""Compute one step of a jog: joint velocities that keep limits and clearance, and can always stop.

*The task velocity* (``task_velocity.py``). A twist, a pose or a point becomes joint velocities.

*The bounds.* A task velocity that keeps all bounds is taken as it is. Otherwise a quadratic program
(``servo_qp.py``) finds the nearest one. The bounds are those of velocity and acceleration; and for
each joint limit, each near pair of bodies and each joint near its torque limit, the room that is
left must suffice to brake, so these are approached more and more slowly (B. Faverjon, P.
Tournassoud, A local based approach for path planning of manipulators with a high number of degrees
of freedom, ICRA 1987).

*The unfiltered reference.* Such a motion has no bound of jerk. The arm gets it through a moving
average, which keeps every bound of position, velocity and acceleration that its input keeps. Its
acceleration changes in each step by what enters the window of ``n`` steps less what leaves it, over
``n``: a window of ``2 a / j`` seconds bounds the jerk by ``j``. All joints are late by half of it,
so a straight line stays straight, and an input that stands still is reached exactly (L. Biagiotti,
C. Melchiorri, FIR filters for online trajectory planning, 2012).

*The proof.* The unfiltered reference can always brake, all joints in proportion to their speed, and
the path to rest that the filter then makes for the arm is known. The last step left such a path
that is free, inside the limits and bearable. A new velocity is taken only if it leaves one too,
which the known distances show or a ``Guard`` proves; otherwise the reference brakes. So whatever
the target, and however wrong a linearised distance, the arm can always stop and never touches
anything.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.geometry import Array, frozen_array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.planning.collision.collision import ClosePair, CollisionModel
from so101_motion.planning.collision.course import Neighbours
from so101_motion.planning.collision.following_apart import GAP
from so101_motion.planning.differential.guard import Guard, room_of
from so101_motion.planning.differential.servo_qp import ROWS, ServoQp
from so101_motion.planning.differential.targets import Target
from so101_motion.planning.differential.task_velocity import SAME, TaskControl, TaskVelocity
from so101_motion.planning.kinematics.geometry_from_model import measure_structure
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Load, TorqueReserve


class MovingAverage:
    """Filters positions [rad] of a reference that starts at rest at ``q``; ``steps`` are averaged.

    ``limits`` are the reference's accelerations, and the jerk that the output shall keep.
    """

    def __init__(self, q: Array, limits: MotionLimits, dt: float) -> None:
        window = 2.0 * float((limits.acceleration / limits.jerk).max())
        self.steps = max(1, math.ceil(window / dt - 1e-9))
        self._trail = np.tile(q, (self.steps, 1))  # the oldest first

    def step(self, q: Array) -> Array:
        """The output after the reference has stepped to ``q``, shape (n,), [rad]."""
        self._trail[:-1] = self._trail[1:]
        self._trail[-1] = q
        # Relative to the reference, so that it is exact when all are the same.
        return np.asarray(q + (self._trail - q).sum(axis=0) / self.steps)

    def ahead(self, q: Array) -> Array:
        """The coming outputs, step by step, until they rest at the end of ``q``, (m, n) [rad]."""
        end, steps = q[-1], self.steps
        passed = np.empty((2 * steps - 1 + len(q), len(end)))
        passed[:steps], passed[steps : steps + len(q)], passed[steps + len(q) :] = (
            self._trail,
            q,
            end,
        )
        passed -= end
        sums = np.cumsum(passed, axis=0)
        return np.asarray(end + (sums[steps:] - sums[:-steps]) / steps)


STRAIGHT = 0.05
"""Smallest bend of the elbow, on the side where it was at the start [rad]. Beyond straight the same
motion leads back again, and joints that cannot turn round at once would swing to and fro. Chosen:
it costs 0.1 mm of reach."""

BENT = 0.5  # share of the margin by which a path to rest may bend; chosen
CLOSE = 0.02  # a joint is reported at its limit when it would come to rest so near it [rad]. Chosen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """The next setpoint of the joints."""

    q: Array  # positions, shape (5,), [rad]
    qd: Array  # velocities, shape (5,), [rad/s]
    qdd: Array  # accelerations, shape (5,), [rad/s^2]
    share: float  # share of the task velocity that is granted, 0 to 1


class _Approached(NamedTuple):
    """A pair of bodies or a torque limit that the arm may approach."""

    left: float  # distance that is left [m], or share of the torque limit
    gradient: Array  # derivative of ``left`` by each joint, shape (5,)
    what: ClosePair | TorqueReserve | str  # the pair or joint, or a description of it


class _Room(NamedTuple):
    """Bounds of the joint velocities in a step."""

    lower: Array  # smallest velocities, shape (5,), [rad/s]
    upper: Array  # largest velocities, shape (5,), [rad/s]
    # gradients of the room of each near pair [m/rad] and each loaded joint [1/rad], shape (k, 5)
    G: Array
    b: Array  # smallest rate of change of each, shape (k,), [m/s], [1/s]
    against: Sequence[_Approached]  # these pairs and joints

    def has(self, qd: Array) -> bool:
        """Whether velocities keep all bounds."""
        if any((qd < self.lower).tolist()) or any((qd > self.upper).tolist()):
            return False
        return not any((self.G @ qd < self.b).tolist())


class Servo:
    """Moves the arm towards targets, step by step. Belongs to one thread.

    A joint that starts outside its limits may stay there; bodies that are too close at the start
    may only move apart, and joints that are overloaded there may only get less load. Nothing moves
    while the arm is in a surface, of which nobody knows how deep.

    ``frame``, of the gripper, moves to the target, from rest at ``q_start``. ``collision`` and
    ``load`` (None not to check it) are used by this servo alone; ``q`` and ``qd`` are the present
    setpoint.
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
        load: Load | None = None,
        neighbours: Neighbours | None = None,
    ) -> None:
        self.neighbours, self._arm_near = neighbours, ""
        self.q, self.qd = frozen_array(q_start, (5,)), np.zeros(5)
        self._before = self.q
        self._q_unfiltered, self._qd_unfiltered, self._braking_time = self.q, self.qd, 0.0
        self._filter = MovingAverage(self.q, limits, dt)
        self._model, self._limits, self._dt = model, limits, dt
        self._q_jaw = 0.0
        self._task, self._qp = TaskControl(model, limits, dt, frame), ServoQp()
        self._lower, self._upper = _range_with(model, self.q)
        self._last: tuple[TaskVelocity, _Room] | None = None
        self.keep_off(collision, load)

    def keep_off(self, collision: CollisionModel, load: Load | None) -> None:
        """Check with these from the next step on; any thread may call. Arguments as above."""
        guard = Guard(collision, lambda: self._q_jaw, load)
        # With an acceleration a, a path bends by a t^2 / 8 from the straight line over a time t.
        bend = float(self._limits.acceleration @ collision.reach) / 8.0
        every = max(1, math.floor(math.sqrt(BENT * guard.margin / bend) / self._dt))
        self._checked_by = guard, every  # replaced whole

    def path_to_rest(self) -> Array:
        """Setpoints if the arm stops now, step by step, shape (m, 5), [rad].

        The first is that of the last step, the second the present one.
        """
        braking = self._braking(self._q_unfiltered, self._qd_unfiltered, self._braking_time)
        ahead = self._filter.ahead(braking[1:] if len(braking) > 1 else braking)
        return np.concatenate((self._before[None], self.q[None], ahead))

    def step(self, target: Target, q_jaw: float = 0.0) -> Step:
        """Move on by one step towards a target, or brake."""
        self._q_jaw, q, time = q_jaw, self._q_unfiltered, self._braking_time
        rest = q + 0.5 * time * self._qd_unfiltered
        wanted = self._task.velocity(target, q, rest - self._lower, self._upper - rest)
        brake = self._qd_unfiltered
        if time > 0.0:
            brake = brake * max(0.0, 1.0 - self._dt / time)
        if not any(wanted.qd.tolist()):
            self._last = None
            return self._taken(brake, 1.0)
        room = self._room(self._approached(q), brake)
        qd, share = wanted.qd, 1.0
        if not room.has(qd):
            share = self._attainable(qd)
            qd = share * qd
        if room.has(qd):
            self._task.grant(share)
        else:
            qd, granted = self._qp.solve(wanted.J, qd, *room[:4])
            share *= granted
            self._task.refuse()
        if not self._can_stop(qd):
            qd, share = brake, 0.0
            self._task.refuse()
        self._last = (wanted, room)
        return self._taken(qd, share)

    def held_by(self) -> tuple[str, ...]:
        """Reasons that limited the task velocity of the last step, for messages.

        Such as ``"elbow_flex at its upper limit"`` or ``"the jaw close to the floor"``; joints that
        only gain speed are not mentioned.
        """
        if self._last is None:
            return ()
        wanted, room = self._last
        if self._guard.stuck:
            return self._guard.stuck
        reasons = [word for i in range(5) if (word := self._limit_of(i, wanted.qd[i]))]
        for each, gain, least in zip(room.against, room.G @ wanted.qd, room.b, strict=True):
            if gain < least:
                reasons.append(self._guard.words(each.what))
        if wanted.is_damped:
            reasons.append("the arm nearly straight, or over its own base")
        if self._arm_near:
            reasons.append(self._arm_near)
        return tuple(dict.fromkeys(reasons))

    @property
    def _guard(self) -> Guard:
        return self._checked_by[0]

    def _approached(self, q: Array) -> Sequence[_Approached]:
        """Torque limits, then bodies, that the arm is nearest to at ``q``, shape (5,), [rad].

        Bodies of other arms count from where the arm is, and are put into words at once: the next
        step overwrites them.
        """
        found = [_Approached(room_of(each), each.gradient, each) for each in self._guard.look(q)]
        if self.neighbours is None:
            return found[:ROWS]
        for arm in self.neighbours.near():
            for k, row in enumerate(arm.bounds):
                left = float(row[-1] + row[:5] @ (q - self.q))
                found.append(_Approached(left, row[:5], arm.words(k)))
        found.sort(key=lambda each: -np.inf if isinstance(each.what, TorqueReserve) else each.left)
        return found[:ROWS]

    def _room(self, against: Sequence[_Approached], brake: Array) -> _Room:
        """Bounds of the velocities that leave enough room to brake, also after this step."""
        # The joints may become a step's worth faster, and would brake as much longer.
        time = 1.5 * self._dt + 0.5 * self._braking_time
        below = (self._lower - self._q_unfiltered) / time
        above = (self._upper - self._q_unfiltered) / time
        G = np.array([each.gradient for each in against]).reshape(-1, 5)
        b = np.array([GAP - each.left for each in against]) / time
        gain = G @ brake
        late = b - 0.5 * GAP / time  # a smaller violation does not endanger the proof
        change, top = self._limits.acceleration * self._dt, self._limits.velocity
        is_late = any(((late > gain) & (gain < 0.0)).tolist())
        if is_late or any((below > brake).tolist()) or any((above < brake).tolist()):
            # Something needs full braking now. The other joints go on if they can brake in time.
            left = max(0.0, self._braking_time - self._dt)
            top = np.minimum(top, self._limits.acceleration * left)
        lower = np.maximum(np.maximum(self._qd_unfiltered - change, -top), below)
        upper = np.minimum(np.minimum(self._qd_unfiltered + change, top), above)
        # Braking is always among them.
        return _Room(
            np.minimum(lower, brake), np.maximum(upper, brake), G, np.minimum(b, gain), against
        )

    def _attainable(self, wanted: Array) -> float:
        """The share of a task velocity that speed and acceleration limits allow now.

        Its direction is kept; a joint that has to turn round gets no more than from rest.
        """
        size, limits = np.abs(wanted), self._limits
        change = limits.acceleration * self._dt
        along = np.maximum(np.sign(wanted) * self._qd_unfiltered, 0.0) + change
        moves = size > SAME
        return min(1.0, float((np.minimum(along, limits.velocity)[moves] / size[moves]).min()))

    def _can_stop(self, qd: Array) -> bool:
        """Whether a step of the unfiltered reference leaves a free, bearable path to rest."""
        self._arm_near = ""
        braking = self._braking(self._q_unfiltered + self._dt * qd, qd, self._time_to_brake(qd))
        end = braking[-1]
        if any((end < self._lower - SAME).tolist()) or any((end > self._upper + SAME).tolist()):
            return False
        ahead = self._filter.ahead(braking)
        guard, every = self._checked_by
        path = np.concatenate((self.q[None], ahead[every - 1 : -1 : every], ahead[-1:]))
        if not guard.admits(path):
            return False
        if self.neighbours is None or self.neighbours.admits(ahead, self._dt):
            return True
        self._arm_near = self.neighbours.against
        return False

    def _braking(self, q: Array, qd: Array, time: float) -> Array:
        """Positions of a reference that brakes for ``time`` [s] from ``q``, step by step.

        All joints brake in proportion, along a straight line; the first position is ``q``.
        """
        k = np.arange(math.floor(time / self._dt) + 1.0)
        lost = 0.5 * self._dt * k * (k + 1.0) / time if time > 0.0 else k
        return np.asarray(q + (self._dt * (k - lost))[:, None] * qd)

    def _taken(self, qd_unfiltered: Array, share: float) -> Step:
        self._q_unfiltered = self._q_unfiltered + self._dt * qd_unfiltered
        self._qd_unfiltered = qd_unfiltered
        self._braking_time = self._time_to_brake(qd_unfiltered)
        q = self._filter.step(self._q_unfiltered)
        qd = (q - self.q) / self._dt
        qdd = (qd - self.qd) / self._dt
        self._before, self.q, self.qd = self.q, q, qd
        return Step(q=q, qd=qd, qdd=qdd, share=share)

    def _time_to_brake(self, qd: Array) -> float:
        return float((np.abs(qd) / self._limits.acceleration).max())

    def _limit_of(self, i: int, wanted: float) -> str | None:
        """The limit that keeps a joint from a velocity, for messages; None if none does."""
        up, speed = wanted > 0.0, abs(wanted)
        rest = self._q_unfiltered[i] + 0.5 * self._braking_time * self._qd_unfiltered[i]
        left = self._upper[i] - rest if up else rest - self._lower[i]
        if left < CLOSE and speed > 0.5 * left / self._dt:
            limit = self._model.upper[i] if up else self._model.lower[i]
            if abs(limit - self._q_unfiltered[i]) > 2.0 * CLOSE:
                return "the arm stretched out"
            return f"{ARM_JOINTS[i]} at its {'upper' if up else 'lower'} limit"
        if speed > self._limits.velocity[i]:
            return f"{ARM_JOINTS[i]} at its top speed"
        return None


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
