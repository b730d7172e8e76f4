"""Compute one step of a jog: joint velocities that keep limits and clearance, and can always stop.

A step is computed in ``native/jog.c``, all but the quadratic program and the proof.

*The task velocity.* A twist, a pose or a point becomes joint velocities. Position comes first,
orientation as far as five joints can. Near a singular configuration, directions that would need
unbounded speeds are damped (Y. Nakamura, H. Hanafusa, Inverse Kinematic Solutions With Singularity
Robustness for Robot Manipulator Control, 1986). A twist is integrated to a reference pose to which
the frame is pulled back, so that a long straight jog stays straight. The reference moves on by the
granted share of the twist, and starts anew where an obstacle turns the frame aside. A pose or a
point is approached as fast as the joints can still come to rest there.

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

import ctypes
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.geometry import SE3, Array, frozen_array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.native.library import quick, shown
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.collision.course import Neighbours
from so101_motion.planning.collision.following_apart import GAP
from so101_motion.planning.differential.guard import Guard
from so101_motion.planning.differential.servo_qp import ROWS, ServoQp
from so101_motion.planning.differential.targets import STILL, Target, Twist
from so101_motion.planning.kinematics.geometry_from_model import measure_structure
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.torque import Load

DAMPING = 0.01
"""Damping [m/rad]: a direction with this gain of the frame per joint motion is followed at half
speed, one with three times that at nine tenths. Chosen: a quarter of all configurations have a gain
below 0.035; a tool that passes full stretch at 0.05 m/s needs at most 2.5 rad/s of the joints."""

CLOSING = 0.1  # damping near a pose, as a share of its distance
EASE = 0.2  # damping of rotation by joint motions that leave the position alone [rad/rad]. Chosen
LOST = 0.1  # share of speed lost to damping that is reported; chosen
PULL = 5.0  # gain with which the frame is pulled back to its reference [1/s]. Chosen
SLACK = (0.005, 0.1)  # largest distance of the reference from the frame [m], [rad]. Chosen
BRAKING = 0.8  # share of the acceleration used to arrive at a pose; chosen
FAR = (0.1, 0.5)  # farther poses count as this far [m], [rad]; chosen: nearly linear
SPARED = 0.15  # joints nearer to a limit move less [rad]; chosen
SAME = 1e-9  # joint angles closer than this count as equal [rad]

STRAIGHT = 0.05
"""Smallest bend of the elbow, on the side where it was at the start [rad]. Beyond straight the same
motion leads back again, and joints that cannot turn round at once would swing to and fro. Chosen:
it costs 0.1 mm of reach."""

BENT = 0.5  # share of the margin by which a path to rest may bend; chosen
CLOSE = 0.02  # a joint is reported at its limit when it would come to rest so near it [rad]. Chosen

SHORT, SLOW = 1e-3, 5e-3
"""A frame is at the end of its reach if, farther off its target than this [m], it approaches
slower than this [m/s]; a motion that begins needs ``BEGINNING`` [s] to be faster. Chosen."""
BEGINNING, _FAST, _REACH = 0.5, "at its top speed", "the end of its reach"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """The next setpoint of the joints."""

    q: Array  # positions, shape (5,), [rad]
    qd: Array  # velocities, shape (5,), [rad/s]
    qdd: Array  # accelerations, shape (5,), [rad/s^2]
    share: float  # share of the task velocity that is granted, 0 to 1


_POSE, _POINT, _TWIST = 0.0, 1.0, 2.0
_FIVE = ctypes.c_double * 5


class _Jog(ctypes.Structure):
    """A jog in the form of ``jog.c``."""

    _fields_ = [
        *((name, ctypes.c_double) for name in ("damping", "closing", "ease", "lost", "pull")),
        ("slack", ctypes.c_double * 2),
        ("braking", ctypes.c_double),
        ("far", ctypes.c_double * 2),
        *((name, ctypes.c_double) for name in ("spared", "same", "gap", "dt")),
        *((name, _FIVE) for name in ("acceleration", "velocity", "lower", "upper")),
        ("placement", ctypes.c_double * 12),
        *((name, ctypes.c_double) for name in ("kind", "in_tool")),
        ("target", ctypes.c_double * 12),
        ("goes_on", ctypes.c_double),
        ("reference", ctypes.c_double * 12),
        *((name, _FIVE) for name in ("q_unfiltered", "qd_unfiltered")),
        ("braking_time", ctypes.c_double),
        *((name, _FIVE) for name in ("before", "q", "qd", "qdd")),
        ("J", _FIVE * 6),
        ("wanted", _FIVE),
        ("is_damped", ctypes.c_double),
        *((name, _FIVE) for name in ("brake", "least", "most")),
        *((name, kind * ROWS) for name, kind in (("G", _FIVE), ("b", ctypes.c_double))),
        ("chosen", _FIVE),
        ("share", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("trail", "passed", "path")),
        *((name, ctypes.c_int) for name in ("steps", "room", "every", "count")),
        ("near", ctypes.c_int * ROWS),
    ]


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
        self._model, self._limits, self._dt = model, limits, dt
        self._frame, self._steps = frame, 0  # steps towards about the same point
        self._q_jaw = 0.0
        self._target: Target = STILL
        self._lower, self._upper = _range_with(model, self.q)
        # A window of this length bounds the jerk of a moving average, see above.
        window = 2.0 * float((limits.acceleration / limits.jerk).max())
        steps = max(1, math.ceil(window / dt - 1e-9))
        room = 3 + math.ceil(float((limits.velocity / limits.acceleration).max()) / dt)
        self._trail, self._passed = np.tile(self.q, (steps, 1)), np.zeros((2 * steps + room, 5))
        self._path = np.zeros((2 * (steps + room + 2), 5))
        self._jog = jog = _Jog(
            damping=DAMPING, closing=CLOSING, ease=EASE, lost=LOST, pull=PULL, slack=SLACK,
            braking=BRAKING, far=FAR, spared=SPARED, same=SAME, gap=GAP, dt=dt, kind=_TWIST,
            trail=self._trail.ctypes.data, passed=self._passed.ctypes.data,
            path=self._path.ctypes.data, steps=steps, room=room,
        )  # fmt: skip
        for name, five in (
            ("acceleration", limits.acceleration), ("velocity", limits.velocity),
            ("lower", self._lower), ("upper", self._upper),
            ("q_unfiltered", self.q), ("before", self.q), ("q", self.q),
        ):  # fmt: skip
            shown(jog, name, 5)[:] = five
        jog.placement[:] = model.on_last_joint(frame).tolist()
        self._in_c, self._at, self._few = quick(), ctypes.addressof(jog), ctypes.c_int()
        names = ("wanted", "chosen", "least", "most")
        self._wanted, self._chosen, *self._bounds = (shown(jog, name, 5) for name in names)
        self._J, self._G = shown(jog, "J", 6, 5), shown(jog, "G", ROWS, 5)
        self._b = shown(jog, "b", ROWS)
        self._q_unfiltered, self._setpoint = shown(jog, "q_unfiltered", 5), shown(jog, "q", 3, 5)
        self._qp = ServoQp()
        self._last: tuple[Guard, Sequence[str] | None] | None = None
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
        return self._path[: self._in_c.so101_jog_to_rest(self._at)].copy()

    def step(self, target: Target, q_jaw: float = 0.0) -> Step:
        """Move on by one step towards a target, or brake."""
        self._q_jaw, self._arm_near, in_c, jog = q_jaw, "", self._in_c, self._jog
        guard, jog.every = self._checked_by
        if target is not self._target:
            self._aim(target)
        self._steps += 1
        if not in_c.so101_jog_want(self._at, guard.scene):
            self._last = None
            return self._taken(0.0)
        rows, n, words = self._near(guard)
        self._last, granted = (guard, words), 1.0
        is_granted = in_c.so101_jog_choose(self._at, rows, n, words is not None)
        if not is_granted:
            least, most, n = *self._bounds, jog.count
            qd, granted = self._qp.solve(
                self._J, self._chosen, least, most, self._G[:n], self._b[:n]
            )
            self._chosen[:] = qd
            jog.share *= granted
        if not self._can_stop(guard):
            jog.chosen, jog.share, is_granted = jog.brake, 0.0, False
        return self._taken(jog.share if is_granted else 0.0)

    def held_by(self) -> tuple[str, ...]:
        """Reasons that limited the task velocity of the last step, for messages.

        Such as ``"elbow_flex at its upper limit"`` or ``"the jaw close to the floor"``; joints that
        only gain speed are not mentioned.
        """
        is_short = self.is_short
        if self._last is None:
            return (_REACH,) if is_short else ()
        (guard, words), jog, wanted = self._last, self._jog, self._wanted
        if guard.stuck:
            return guard.stuck
        reasons = [word for i in range(5) if (word := self._limit_of(i, wanted[i]))]
        for k in range(jog.count):
            if self._G[k] @ wanted < self._b[k]:
                row = jog.near[k]
                reasons.append(guard.close_to(row) if words is None else words[row])
        if jog.is_damped:
            reasons.append("the arm nearly straight, or over its own base")
        if self._arm_near:
            reasons.append(self._arm_near)
        if is_short:
            reasons = [each for each in reasons if not each.endswith(_FAST)] or [_REACH]
        return tuple(dict.fromkeys(reasons))

    @property
    def is_short(self) -> bool:
        """Whether the frame hardly comes nearer to a pose or point that it has not reached."""
        jog, span = self._jog, self._dt * (len(self._trail) - 1)
        if jog.kind == _TWIST or self._steps * self._dt < max(BEGINNING, span):
            return False
        ends = (self._model.frame(q, self._frame).p for q in (self._trail[0], self._trail[-1]))
        before, now = (float(np.linalg.norm(p - jog.target[9:])) for p in ends)
        return now > SHORT and before - now < SLOW * span

    def _aim(self, target: Target) -> None:
        jog, self._target = self._jog, target
        before, was, jog.goes_on = jog.target[9:], jog.kind, 0.0
        if isinstance(target, Twist):
            jog.kind, jog.in_tool = _TWIST, target.in_tool
            jog.target[:6] = [*target.linear.tolist(), *target.angular.tolist()]
        elif isinstance(target, SE3):
            jog.kind, jog.target[:] = _POSE, [*target.R.ravel().tolist(), *target.p.tolist()]
        else:
            jog.kind, jog.target[9:] = _POINT, target.tolist()
        if _TWIST in (was, jog.kind) or math.dist(before, jog.target[9:]) > SHORT:
            self._steps = 0

    def _near(self, guard: Guard) -> tuple[int, int, Sequence[str] | None]:
        """Bounds that the arm is near to: their address, their number, and words for them.

        Without words they are those that the guard has seen, in any order. Otherwise these are
        torque limits, then bodies, those of other arms included; they count from where the arm is.
        """
        q = self._q_unfiltered
        heavy = guard.see(q)
        if not heavy and self.neighbours is None:
            return guard.bounds_at, len(guard.bounds), None
        found = [([*each.gradient, 0.0, each.left], guard.words(each)) for each in heavy]
        near = [(row, guard.close_to(k)) for k, row in enumerate(guard.bounds.tolist())]
        for arm in () if self.neighbours is None else self.neighbours.near():
            for k, row in enumerate(arm.bounds):
                left = float(row[-1] + row[:5] @ (q - self.q))
                near.append(([*row[:5].tolist(), 0.0, left], arm.words(k)))
        found = [*found, *sorted(near, key=lambda each: each[0][-1])][:ROWS]
        self._few_rows = np.array([row for row, _ in found])  # it must last
        return self._few_rows.ctypes.data, len(found), [words for _, words in found]

    def _can_stop(self, guard: Guard) -> bool:
        """Whether a step of the unfiltered reference leaves a free, bearable path to rest."""
        n = self._in_c.so101_jog_ahead(self._at, ctypes.byref(self._few))
        if not n or not guard.admits(self._path[n + 1 :][: self._few.value]):
            return False
        ahead, neighbours = self._path[1 : n + 1].copy(), self.neighbours
        if neighbours is None or neighbours.admits(ahead, self._dt):
            return True
        self._arm_near = neighbours.against
        return False

    def _taken(self, granted: float) -> Step:
        """Take the step; a twist's reference moves on by the share that is granted of it."""
        self._in_c.so101_jog_take(self._at, granted)
        q, qd, qdd = frozen_array(self._setpoint)
        self.q, self.qd = q, qd
        return Step(q=q, qd=qd, qdd=qdd, share=self._jog.share)

    def _limit_of(self, i: int, wanted: float) -> str | None:
        """The limit that keeps a joint from a velocity, for messages; None if none does."""
        up, speed = wanted > 0.0, abs(wanted)
        jog, q = self._jog, self._jog.q_unfiltered[i]
        rest = q + 0.5 * jog.braking_time * jog.qd_unfiltered[i]
        left = self._upper[i] - rest if up else rest - self._lower[i]
        if left < CLOSE and speed > 0.5 * left / self._dt:
            limit = self._model.upper[i] if up else self._model.lower[i]
            if abs(limit - q) > 2.0 * CLOSE:
                return "the arm stretched out"
            return f"{ARM_JOINTS[i]} at its {'upper' if up else 'lower'} limit"
        if speed > self._limits.velocity[i]:
            return f"{ARM_JOINTS[i]} {_FAST}"
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
