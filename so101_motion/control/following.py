"""Follow targets that arrive while the joints move.

In every control cycle the I/O thread takes one period of the fastest motion to the newest target
(``pursuit.py``), so velocity, acceleration and jerk are bounded whatever the targets do.

*Room to stop.* A setpoint is taken only if the joints can still stop from it, as hard as a stop
brakes, inside their limits, below the speed cap and, with a guard, without touching anything.
Otherwise they brake along the path to rest of the setpoint before, which was found free; so does a
stop from outside. The guard replaces a target that cannot be reached by the nearest one that seems
free, so the joints slow down before they have to brake, and slide along the obstacle.

*Speed.* Until every joint is within ``gate`` of a first target, or of one after a rest, the caps
are those of the approach; then they rise to the full ones within ``EASE``. Joints that an obstacle
keeps farther away than ``gate`` also move that slowly, and catch up as the caps rise again.

*No target.* When none comes for ``stale_after``, or ``hold`` is called, the joints slow to rest and
wait; the following goes on.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.attributes import checked_number
from so101_motion.common.errors import ConfigError, MotionError, PlanningError, in_series
from so101_motion.common.geometry import Array, frozen_array, is_finite, joint_angles
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import angles_deg, to_deg, to_rad
from so101_motion.control.motion_source import MotionSource, OpenEndedMotion, PlannedMotion
from so101_motion.native.library import quick, shown
from so101_motion.planning.collision.course import STEP, Neighbours
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits, checked_limits
from so101_motion.planning.timing.pursuit import FORESIGHT, Arrival, Pursuit
from so101_motion.planning.timing.stop_paths import JOINTS, StopPaths
from so101_motion.planning.timing.trajectory import Setpoint, Trajectory

if TYPE_CHECKING:  # it brings Pinocchio along, which an unguarded following has no use for
    from so101_motion.planning.differential.guard import Guard


GATE = to_rad(5.0)
"""Within this distance of its target a joint follows at full speed [rad]; from the published
module's later gate for teleoperation."""

EASE = 0.5
"""How long the caps take to rise from those of the approach to the full ones [s]; chosen."""

CATCH_UP = 1.0
"""How long the caps take to rise again once nothing holds the joints back [s]; chosen: the target
moves on meanwhile and does not have to wait for them."""

APPROACH = MotionLimits.uniform(velocity=to_rad(30.0), acceleration=to_rad(100.0), jerk=50.0)
"""Caps of the approach; chosen."""


class Approach:
    """Chooses the caps of a following: low until the target is near, then rising to full.

    Args:
        full: Caps once the target is near.
        slow: Caps of the approach; None for ``full``.
        gate: A target is near when every joint is closer to it than this [rad].

    Attributes:
        is_under_way: Whether the target has not been near yet.
    """

    def __init__(self, full: MotionLimits, slow: MotionLimits | None, gate: float = GATE) -> None:
        self._full, self._gate, self._t_near, self._t_held = full, gate, -math.inf, math.inf
        self._slow = None if slow is None else slow.lowered_to(full.velocity, full.acceleration)
        self.is_under_way = slow is not None

    def begin(self) -> None:
        self.is_under_way, self._t_held = self._slow is not None, math.inf

    def caps(self, t: float, off: Array, *, is_held: bool = False) -> MotionLimits:
        """The caps to use at ``t`` [s], for joints that are ``off`` [rad], shape (n,).

        If something holds them back farther off than the gate (``is_held``), they get the caps of
        the approach, which rise within ``CATCH_UP`` afterwards.
        """
        if self._slow is None:
            return self._full
        if max(map(abs, off.tolist())) > self._gate:
            if is_held and (not self.is_under_way or self._t_held < math.inf):
                self.is_under_way, self._t_held = True, t
        elif self.is_under_way:
            self.is_under_way, self._t_near, self._t_held = False, t, math.inf
        if self.is_under_way:
            return self._slow.eased_to(self._full, (t - self._t_held) / CATCH_UP)
        return self._slow.eased_to(self._full, (t - self._t_near) / EASE)


_ROW = ctypes.c_double * JOINTS
_TOO_FAST, _NO_ROOM, _NO_STOP = -1, -2, -3  # as in following.c
_ROUNDING = 1e-9
_THERE = 1e-7  # [rad], [rad/s]: closer and slower is there, at rest


def stoppable(limits: MotionLimits, stop: MotionLimits, *, with_jerk: bool) -> MotionLimits:
    """Lower the velocity and acceleration of ``limits`` to those of a stop.

    With more jerk than a stop has joints creep up on the end of their range. That only matters to a
    motion that is to end there, so jerk is lowered on request.
    """
    lowered = limits.lowered_to(stop.velocity, stop.acceleration)
    return gentle(lowered, stop) if with_jerk else lowered


@lru_cache(maxsize=8)
def gentle(limits: MotionLimits, stop: MotionLimits) -> MotionLimits:
    """Lower the jerk of ``limits`` to that of a stop."""
    return replace(limits, jerk=np.minimum(limits.jerk, stop.jerk))


class _Step(ctypes.Structure):
    """The next step of a following, for ``following.c``, with rows of a number for each joint."""

    _fields_ = [
        *((name, _ROW) for name in ("least", "most", "hardest", "stop_jerk", "fastest")),
        *((name, _ROW) for name in ("jerk", "now")),
        *((name, _ROW * n) for name, n in (("braked", 3), ("target", 2), ("next", 3))),
        *((name, ctypes.c_void_p) for name in ("given", "told")),
        *((name, ctypes.c_int) for name in ("n", "room")),
    ]


KNOWN_JERK = 200.0
"""How fast the reported acceleration may rise [rad/s^3]. Chosen by trial: the acceleration of a
hand is noisy."""

AHEAD = 0.5
"""The driver may be ahead for so long after it was last told an acceleration [s], because its
compensation fades slowly (``goal_compensation.py``); so it must still know how joints brake."""


class ExpectedAcceleration:
    """The acceleration that the driver is told in each period, to make up for servo lag.

    That drives servos ahead of their setpoints, so a wrong value must not drive them elsewhere. A
    target may claim any acceleration: the driver is told that a joint speeds up only as far as its
    setpoint does. It is told of braking before the setpoint brakes, because a servo needs time for
    it, but never so much that the joint would turn round. If a target does not say how it
    accelerates, the driver is told nothing and the servos lag.

    Attributes:
        qdd: How the joints accelerate, shape (n,), [rad/s^2]; None if it is not known.
    """

    def __init__(self, dt: float) -> None:
        self.qdd: Array | None = None
        self._dt, self._left = dt, 0.0

    @property
    def may_be_ahead(self) -> bool:
        """Whether the driver may still drive servos ahead of their setpoints."""
        return self._left > 0.0

    def beside(self, setpoint: Setpoint, qdd: Array) -> None:
        """The joints are sent to ``setpoint``, to accelerate by ``qdd``, shape (n,), [rad/s^2]."""
        self._left, step = AHEAD, KNOWN_JERK * self._dt
        before = setpoint.qdd if self.qdd is None else self.qdd
        known = np.clip(qdd, before - step, before + step)
        way = np.sign(setpoint.qd)
        faster, to_rest = np.maximum(way * setpoint.qdd, 0.0), -np.abs(setpoint.qd) / FORESIGHT
        self.qdd = way * np.clip(way * known, np.minimum(way * setpoint.qdd, to_rest), faster)

    def braking(self, now: Setpoint) -> None:
        self._left -= self._dt
        self.qdd = now.qdd if self._left > 0.0 else None

    def unknown(self) -> None:
        """The target does not say how it accelerates."""
        self._left -= self._dt
        self.qdd = None


STALE_AFTER = 0.1
"""How long a target counts without a newer one [s]; chosen: three periods of a 30 Hz source."""

LOOK_EVERY = 0.05
"""Time between two checks of a path to rest against joint limits [s]; chosen; a guard has more."""

SHORT_AFTER, NEARER = 0.5, to_rad(0.5)
"""Joints have stopped short when an obstacle has held them for so long [s] and they have come no
nearer to their target than this [rad]; chosen: creeping along an obstacle may take for ever."""

HELD_FOR = 0.1
"""An obstacle that held joints counts as holding them for so long afterwards [s]: from rest a step
may be so small that it is admitted, and only the next one is not. Chosen."""

GENTLE = 0.3
"""For so long after the guard has refused a step, jerk is capped to what a stop can undo [s]: after
a sudden step the path to rest is long, and near a table there may be no room for it. Chosen."""

CLOSE = 0.02
"""A joint is reported to be at its limit when it is this near to it [rad]; chosen."""

_SLOWER = 0.95  # a target's speed is clipped to this share of the caps, or joints never catch it


class FollowingSettings(TypedDict, total=False):
    """Options of a following; ``Following`` explains them."""

    approach: MotionLimits | None
    gate: float
    stale_after: float | None
    each: Callable[[Following], None] | None
    ends_there: bool


class _Aim(NamedTuple):
    """A target, clipped to the range, and how far outside it was asked for; shapes (n,)."""

    q: Array  # [rad]
    qd: Array  # [rad/s]
    qdd: Array | None  # [rad/s^2]; None if it is not known
    outside: Array  # [rad]


class Following(OpenEndedMotion):
    """Takes targets and hands out setpoints; made by ``Arm.follow``.

    Args:
        q_start: Where it begins, at rest, shape (n,), [rad].
        lower: Lower joint limits, shape (n,), [rad].
        upper: Upper joint limits, shape (n,), [rad].
        limits: Caps of the motion; lowered to those of a stop where they are above.
        stop_limits: How hard a stop brakes.
        dt: The period [s].
        approach: Caps while the target is far; None for ``limits``.
        gate: ``limits`` count once every joint is this near to its target [rad].
        stale_after: How long a target counts without a newer one [s]; None for ever.
        guard: Keeps the joints clear of obstacles; None to check nothing. Only the thread of this
            following may use it.
        neighbours: Other arms to keep off; None if there are none.
        share: Says in every period what share of the caps may be used, 0 to 1.
        each: Called on the I/O thread before every setpoint; may aim. Must be brief.
        ends_there: Whether it ends when it has reached its target, or cannot.

    Attributes:
        now: The last setpoint.
        expected_acceleration: How the joints are expected to accelerate, for the driver.
        guard: As given; any thread may set another one whose ``look_every`` is no smaller.
    """

    can_wait = True

    def __init__(
        self,
        *,
        q_start: ArrayLike,
        lower: ArrayLike,
        upper: ArrayLike,
        limits: MotionLimits,
        stop_limits: MotionLimits,
        dt: float,
        approach: MotionLimits | None = None,
        gate: float = GATE,
        stale_after: float | None = STALE_AFTER,
        guard: Guard | None = None,
        neighbours: Neighbours | None = None,
        share: Callable[[], float] = lambda: 1.0,
        each: Callable[[Following], None] | None = None,
        ends_there: bool = False,
    ) -> None:
        super().__init__("following")
        n = len(limits.velocity)
        if n > JOINTS:
            raise ValueError(f"a following has at most {JOINTS} joints, got {n}")
        self.limits = limits = stoppable(limits, stop_limits, with_jerk=ends_there)
        self._lower, self._upper = frozen_array(lower, (n,)), frozen_array(upper, (n,))
        self._range = list(zip(self._lower.tolist(), self._upper.tolist(), strict=True))
        self._farthest = max(abs(end) for ends in self._range for end in ends)
        gate = checked_number("gate", gate, lower=0.0, unit="rad")
        approach = checked_limits(approach, n, "approach")
        self._approach, self._share = Approach(limits, approach, gate), share
        self._stop_limits, self._dt = stop_limits, dt
        self._stale_after = math.inf
        if stale_after is not None:
            self._stale_after = checked_number("stale_after", stale_after, lower=0.0, unit="s")
        self.guard, self._neighbours = guard, neighbours
        self._each, self._ends_there = each, ends_there
        looks = LOOK_EVERY if neighbours is None else STEP
        looks = looks if guard is None else min(guard.look_every, looks)
        self._stops, self._pursuit = StopPaths(stop_limits, dt, looks), Pursuit(n, dt)
        self.expected_acceleration = ExpectedAcceleration(dt)
        self._aimed: _Aim | None = None
        self._briefly = False
        self._seen: _Aim | None = None
        self._t = self._t_seen = self._t_nearest = 0.0
        self._nearest = math.inf
        self._held: tuple[str, ...] = ()
        self._stopped_by: tuple[str, ...] = ()  # while it held last
        self._t_gentle = self._t_held = -math.inf
        self._step = _Step(given=self._stops.given_at, n=n)
        rows = (("now", 1), ("braked", 3), ("target", 2), ("next", 3))
        self._c_now, self._c_braked, self._c_target, self._c_next = (
            shown(self._step, name, count, JOINTS)[:, :n] for name, count in rows
        )
        self._caps: MotionLimits | None = None  # those that ``_step`` has the jerk of
        self._in_c, self._step_at = quick(), ctypes.addressof(self._step)
        self._slowing: PlannedMotion | None = None
        self._k = 0  # of the next setpoint of what is slowing
        self._still = frozen_array(np.zeros(n))
        self._begin_at(Setpoint(q=frozen_array(q_start, (n,)), qd=self._still, qdd=self._still))

    # Any thread

    def aim(
        self,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        qdd: ArrayLike | None = None,
        *,
        most: float = 2.0 * math.pi,
    ) -> Array:
        """Go to joint angles, from the next control cycle on; never waits.

        Args:
            q: Where the joints shall be, shape (n,), [rad].
            qd: Velocity of the target, shape (n,), [rad/s]; the target is taken to move on with it
                until the next one. None for a target that stands still.
            qdd: Acceleration of the target, shape (n,), [rad/s^2]; None if it is not known. With
                it the joints follow more closely, because the driver makes up for their lag.
            most: Farther angles are taken for degrees and refused [rad]; ``math.inf`` for targets
                that may be anywhere, such as a policy's, whose unit is known.

        Returns:
            The target as it was taken, within the range, shape (n,), [rad].

        Raises:
            ConfigError: These are not ``n`` finite numbers, or an angle is beyond ``most``; the
                target before stays.
            So101Error: The following has ended; the error says why.
        """
        self._refuse_if_over()
        is_inside = self._is_inside(q) and self._farthest <= most  # so it is finite, too
        wanted = frozen_array(q) if is_inside else self._checked("q", q, most)
        rate = self._still if qd is None else self._checked("qd", qd)
        change = None if qdd is None else self._checked("qdd", qdd)
        taken, outside = wanted, self._still
        if not is_inside and not self._is_inside(wanted):
            taken = frozen_array(np.clip(wanted, self._lower, self._upper))
            outside = frozen_array(wanted - taken)
            within = outside == 0.0
            rate, change = rate * within, None if change is None else change * within
        self._aimed, self._briefly = _Aim(taken, rate, change, outside), False
        return taken

    def hold(self, *, briefly: bool = False) -> None:
        """Slow down and wait for the next target; if ``briefly``, go on at the pace of before."""
        self._aimed, self._briefly = None, briefly

    @property
    def target(self) -> Array | None:
        """The newest target as it was taken, shape (n,), [rad]; None if there is none."""
        aimed = self._aimed
        return None if aimed is None else aimed.q

    @property
    def _doing(self) -> str:
        target, held = self.target, in_series(self.held_by)
        where = "without a target" if target is None else f"to {angles_deg(target)}"
        return f"{where}{held and f', held by {held}'}"

    @property
    def outside(self) -> Array:
        """How far the newest target was asked for beyond the range, shape (n,), [rad]."""
        aimed = self._aimed
        return np.zeros(len(self._lower)) if aimed is None else aimed.outside

    @property
    def held_by(self) -> tuple[str, ...]:
        """What keeps the joints from where they are wanted.

        Joints at their limits, close bodies (``"the jaw close to the floor"``), overloaded joints.
        """
        aimed, q = self._aimed, self.now.q
        if aimed is None or len(q) != len(ARM_JOINTS):
            return self._held
        at_limits = [
            f"{joint} at its {'upper' if out > 0.0 else 'lower'} limit"
            for joint, out, at, to in zip(ARM_JOINTS, aimed.outside, q, aimed.q, strict=True)
            if out != 0.0 and abs(at - to) < CLOSE
        ]
        return (*at_limits, *self._held)

    @property
    def is_held(self) -> bool:
        """Whether something in the way holds the joints back; their limits do not count."""
        return bool(self._held)

    @property
    def is_approaching(self) -> bool:
        """Whether it goes at the pace of the approach."""
        return self._approach.is_under_way

    @property
    def keeps_apart(self) -> bool:
        """Whether it keeps off other arms of its cell by itself."""
        return self._neighbours is not None and self._slowing is None

    @property
    def is_guarded(self) -> bool:
        """Whether every setpoint of it has a free path to rest."""
        return self.guard is not None and self._slowing is None

    # The I/O thread

    @property
    def start(self) -> Setpoint:
        return self._start

    def take_over(self, now: Setpoint, previous: MotionSource | None, brakes: MotionLimits) -> None:
        """Begin at the last setpoint of another motion, without a stop in between.

        A guarded following first lets an unguarded motion come to rest on that motion's own path,
        because only that path is known to be free.

        Args:
            now: The last setpoint.
            previous: The motion that made it; None for joints that rest.
            brakes: How hard that motion may brake.
        """
        self._slowing = None
        guarded = isinstance(previous, Following) and previous.is_guarded
        if isinstance(previous, Following):
            self.expected_acceleration = previous.expected_acceleration
        if self.guard is not None and previous is not None and not guarded:
            self._slowing, self._k = PlannedMotion(previous.brake(now, brakes)), 1
        self._begin_at(now)

    @property
    def is_over(self) -> bool:
        now = self.now
        if self._slowing is not None or any(now.qd.tolist()) or any(now.qdd.tolist()):
            return False
        if self._ends_there and not self._closing:
            aimed = self._aimed
            return aimed is not None and np.array_equal(self.now.q, aimed.q)
        return self._closing

    def sample(self, k: int) -> Setpoint:
        """The setpoint of the next tick; ``k`` is ignored.

        Raises:
            MotionError: It was to end at its target and an obstacle holds it short of it.
        """
        self._t += self._dt
        self._ask()
        aim = self._current()
        if self._slowing is not None:
            self.now = self._slowing.sample(self._k)
            self._k += 1
            if self._slowing.is_over:
                self._slowing = None
            self._take(self.now, np.array((self.now.q, self.now.qd, self.now.qdd)))
            self.expected_acceleration.braking(self.now)
            return self.now
        if aim is None:
            self._held = ()
            if not self._briefly:
                self._approach.begin()
            self._brake()
        else:
            self._lead(aim)
            self._refuse_short(aim)
        return self.now

    def brake(self, now: Setpoint, limits: MotionLimits) -> Trajectory:
        """Brake every joint by itself; every setpoint has left room for that."""
        if self._slowing is not None:
            return self._slowing.brake(now, limits)
        return online.stop(now.q, now.qd, now.qdd, limits, self._dt)

    # How

    def _begin_at(self, now: Setpoint) -> None:
        self._start = self.now = now
        # Joints that begin a little outside may stay there, and come in.
        self._least, self._most = np.minimum(self._lower, now.q), np.maximum(self._upper, now.q)
        self._bound(now)
        self._take(now)

    def _bound(self, now: Setpoint) -> None:
        """Keep joints that begin at ``now`` where they can stop in their range and below their cap.

        Joints that are faster there may be as fast.
        """
        limits, stop = self.limits, self._stop_limits
        there = np.abs(now.qd + 0.5 * now.qdd * np.abs(now.qdd) / stop.jerk)
        fastest = np.maximum(limits.velocity, there) + _ROUNDING
        least, most, hardest = (
            self._least - _ROUNDING, self._most + _ROUNDING, limits.acceleration + _ROUNDING,
        )  # fmt: skip
        rows = shown(self._step, "least", 5, JOINTS)[:, : self._step.n]
        rows[:] = least, most, hardest, stop.jerk, fastest

    def _take(self, now: Setpoint, braked: Array | None = None) -> None:
        """Go to ``now``; if the joints brake then, they are ``braked`` a period later, (3, n).

        That is their position, velocity and acceleration; as a stop brakes if it is None.
        """
        if braked is None:
            after = self._stops.to_rest(now).after
            braked = np.array((after.q, after.qd, after.qdd))
        self.now, self._c_now[0], self._c_braked[:] = now, now.q, braked

    def _is_inside(self, q: ArrayLike) -> bool:
        """Whether ``q`` are joint angles within the range."""
        if type(q) is not np.ndarray or q.shape != self._lower.shape:
            return False
        pairs = zip(self._range, q.tolist(), strict=True)
        return all([lower <= at <= upper for (lower, upper), at in pairs])

    def _checked(self, name: str, values: ArrayLike, most: float = math.inf) -> Array:
        found = joint_angles(name, values, self._lower.shape, most=most)
        if not is_finite(found):
            raise ConfigError(name, values, f"must be {len(self._lower)} finite numbers")
        return found

    def _current(self) -> _Aim | None:
        """The newest target as it is at the end of the coming period; None if there is none."""
        aimed = self._aimed
        if aimed is not self._seen:
            self._seen, self._t_seen = aimed, self._t
        age = self._t - self._t_seen
        if aimed is None or self._closing or age > self._stale_after + _ROUNDING:
            return None
        if age == 0.0 or not any(aimed.qd.tolist()):
            return aimed
        moved = aimed.q + age * aimed.qd
        q = np.clip(moved, self._lower, self._upper)
        qdd = None if aimed.qdd is None else np.zeros_like(q)
        return aimed._replace(q=q, qd=np.where(q == moved, aimed.qd, 0.0), qdd=qdd)

    def _ask(self) -> None:
        if self._each is None or self._closing:
            return
        try:
            self._each(self)
        except Exception as error:
            if not self._closing:  # by another thread, just now
                raise MotionError(f"the program that sends targets failed: {error}") from error

    def _brake(self) -> None:
        """Take the next step of the path to rest that the last setpoint has left free."""
        q, qd, qdd = frozen_array(self._c_braked)
        self._take(Setpoint(q=q, qd=qd, qdd=qdd))
        self.expected_acceleration.braking(self.now)

    def _lead(self, aim: _Aim) -> None:
        """Take a step towards a target, or brake if that step is refused."""
        off = aim.q - self.now.q
        limits = self._approach.caps(self._t, off, is_held=self.is_held).eased(self._share())
        if is_gentle := self._t < self._t_gentle:
            limits = gentle(limits, self._stop_limits)
        q, qd, qdd = aim.q, aim.qd, None if self.is_approaching else aim.qdd
        if is_moving := any(qd.tolist()):
            qd = np.clip(qd, -_SLOWER * limits.velocity, _SLOWER * limits.velocity)
        if qdd is not None:
            qdd = np.clip(qdd, -limits.acceleration, limits.acceleration)
        self._held = ()
        if (guard := self.guard) is not None:
            others = () if self._neighbours is None else self._neighbours.near()
            allowed = guard.within_reach(self.now.q, q, others)
            if allowed is not q:
                q = np.minimum(np.maximum(allowed, self._least), self._most)
                qd, qdd, is_moving = self._still, None, False
            self._held = guard.against
        arrival: Arrival = "each"
        if not is_moving and (is_gentle or self._ends_there or self.is_approaching):
            # From rest close to things, joints that do not set off together come closer first.
            arrival = "straight" if is_gentle else "together"
        try:
            samples, onward = self._offer((q, qd, qdd), limits, arrival)
        except PlanningError:  # ruckig gives up on a few states in a million; the next is another
            return self._brake()
        if samples == _NO_STOP:
            return self._brake()
        stops = self._stops
        path = stops.along[: 1 + samples]
        ahead = qdd is not None or self.expected_acceleration.may_be_ahead
        if guard is not None and not guard.admits(path, ahead=ahead):
            self._held = self._held or ("too little room to brake",)
            self._t_gentle = self._t + GENTLE
            return self._brake()
        neighbours = self._neighbours
        if neighbours is not None and not neighbours.admits(path[1:].copy(), stops.step):
            self._held = (*self._held, neighbours.against)
            return self._brake()
        q, qd, qdd = frozen_array(self._c_next)
        setpoint = Setpoint(q=q, qd=qd, qdd=qdd)
        self._take(setpoint, stops.after)
        if aim.qdd is None:
            self.expected_acceleration.unknown()
        else:
            self.expected_acceleration.beside(setpoint, setpoint.qdd if onward is None else onward)

    def _offer(
        self, target: tuple[Array, Array, Array | None], limits: MotionLimits, arrival: Arrival
    ) -> tuple[int, Array | None]:
        """Compute the next step towards a target, with joints braking that could not stop in time.

        Returns how many samples the path to rest from there has, or ``_NO_STOP``; and the
        acceleration that is expected from there on if that of the target is known.
        """
        step, is_hasty = self._step, False
        while True:
            setpoint, onward = self._pursuit.step(self.now, target, limits, arrival)
            rows = self._c_next
            rows[0], rows[1], rows[2] = setpoint.q, setpoint.qd, setpoint.qdd
            self._c_target[0], self._c_target[1], _ = target
            if limits is not self._caps:
                self._caps, step.jerk[: step.n] = limits, limits.jerk.tolist()
            step.told, step.room = self._stops.told_at, self._stops.room
            found = self._in_c.so101_following_step(self._step_at, _THERE, is_hasty)
            if found == _TOO_FAST:  # speed up no harder than a stop can take back in time
                limits, is_hasty = gentle(limits, self._stop_limits), True
            elif found == _NO_ROOM:
                self._stops.make_room(2 * self._stops.room)
            else:
                return found, onward

    def _refuse_short(self, aim: _Aim) -> None:
        if not self._ends_there:
            return
        off = float(np.max(np.abs(aim.q - self.now.q)))
        if self._held:
            self._t_held, self._stopped_by = self._t, self._held
        if off < self._nearest - NEARER or self._t - self._t_held > HELD_FOR:
            self._nearest, self._t_nearest = off, self._t
        elif self._t - self._t_nearest > SHORT_AFTER:
            raise MotionError(
                f"the arm stopped {to_deg(off):.1f} deg short of where it was sent, with"
                f" {' and '.join(self._stopped_by)}; send it elsewhere, or plan a move around it"
            )
