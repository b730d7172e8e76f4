"""Play time-stamped joint positions that arrive in batches while the arm moves.

* Playing begins when the points reach ``LEAD`` ahead, or when the stream is finished earlier. *
Between points the joints run straight, and the result passes through two moving averages. The
first, long enough for the velocity steps of the points, bounds acceleration; the second bounds
jerk. Averages never exceed what goes into them, at the price of a short delay and of slightly
rounded corners. The first window is chosen once: evenly timed, dense points get a short one. Later
points that would need a longer one are refused. * The first point need not be exactly where the arm
is. The difference fades out along a smooth step, slowly enough to add at most a tenth to what the
limits allow.

A stop follows the points as far as they are known. If it would take longer, it ends at the last
one, or, if more are to come, each joint stops by itself. With a guard, the points ahead are looked
at in every tick. When they lead into contact, the stop begins early enough to end before it, as far
as servos need that stop inexactly. Points that pass closely by something are played: whoever
planned them may keep less distance than we do.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from so101_motion.common.errors import ConfigError, MotionError, OutsideLimits
from so101_motion.common.geometry import Array, is_finite, joint_angles
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_rad
from so101_motion.control.motion_source import LOOK_AHEAD, EndsWithBlock, PlannedMotion
from so101_motion.control.request_queue import running_future
from so101_motion.planning.collision.course import stop_along, stop_time
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint, Trajectory

if TYPE_CHECKING:  # it brings Pinocchio along, which an unguarded stream has no use for
    from so101_motion.planning.differential.guard import Guard

LEAD = 0.2
"""How far ahead the points must reach before playing begins [s]; rides out an uneven network.
Chosen."""

MOST_AHEAD = 600.0
"""How far ahead a point may be of what is played [s]. Chosen: longer than any motion that is sent
in one piece, and checked in 20 ms."""

START_GATE = to_rad(5.0)
"""How far the first point may be from where the arm is, per joint [rad]; the published module's."""

_BLEND_SHARE = 0.1  # of the velocity and acceleration limits, for the fading difference; chosen
_SHORTEST_WINDOW = 0.05  # first moving average [s]; chosen, evens out points 20 ms apart
_HARDER = (1.2, 1.5)
"""A stop can follow the points if it may accelerate and jerk so many times as hard as they do; see
``online.stop_on_path``."""
_SLACK = 1.01  # what rounding of the sender's times and angles may add to a figure; chosen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimedPoint:
    """A point of a stream.

    Attributes:
        t: When, after the stream began [s].
        q: Joint angles, shape (5,), [rad].
    """

    t: float
    q: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", joint_angles("q", self.q))
        if not (math.isfinite(self.t) and is_finite(self.q)):
            raise ValueError(f"a point must be finite, got t = {self.t}, q = {self.q}")


class Stream(EndsWithBlock):
    """Turns streamed points into setpoints; made by ``Arm.stream``. Leaving its block finishes it.

    Args:
        q_start: The arm's reference when the stream opens, shape (5,), [rad].
        limits: Caps of the motion.
        dt: The period of the setpoints [s].
        stop_limits: How hard each joint stops by itself, and a stop before contact where points can
            be followed with that; by default ``limits``.
        guard: Looks for contact; None to check nothing. Only the I/O thread may use it.
        check_range: Raises OutsideLimits for a path, shape (n, 5), that leaves the joint range.

    Attributes:
        future: Completes when the arm has arrived at the last point, or raises why it did not.
        guard: As given; any thread may set another one.
    """

    can_wait = False

    _name = "stream"

    def __init__(
        self,
        *,
        q_start: Array,
        limits: MotionLimits,
        dt: float,
        stop_limits: MotionLimits | None = None,
        guard: Guard | None = None,
        check_range: Callable[[Array], None] = lambda q: None,
    ) -> None:
        self.future: Future[None] = running_future()
        self.limits = limits
        self._q_start, self._dt, self._check_range = q_start, dt, check_range
        self.guard, self._stop_limits = guard, stop_limits or limits
        self._leads_into: tuple[str, str] | None = None  # the bodies for which it stops
        self._lock = threading.Lock()  # one push at a time
        self._knots: tuple[Array, Array] = (np.empty(0), np.empty((0, len(q_start))))
        self._closing = False
        self._kernel: Array | None = None  # of both averages, newest first; set when primed
        self._window = 0  # ticks of the first average
        self._t_played = self._t_before = 0.0  # on the stream's clock: of the last two samples
        self.start = self._now = Setpoint(
            q=q_start, qd=np.zeros(len(q_start)), qdd=np.zeros(len(q_start))
        )
        self._k = 0  # the tick of the last sample
        self._k_first: int | None = None  # the tick in which playing began
        self._tail: tuple[int, PlannedMotion] | None = None  # to the last point, since which tick
        self._offset, self._t_blend = np.zeros(len(q_start)), 1.0

    # Any thread

    def push(self, points: Sequence[TimedPoint]) -> None:
        """Add points, later than all before; the very first one is for time 0.

        Raises:
            ValueError: The times do not begin at 0, do not increase, or are ``MOST_AHEAD`` ahead.
            OutsideLimits: The first point is too far from the arm, a point is outside the arm's
                range, or the points are too fast or change their speed too quickly; nothing of
                the batch is taken.
            MotionError: The stream is over; when it failed, the error says why.
        """
        with self._lock:
            self._refuse_if_over()
            if not points:
                return
            if not isinstance(points, Sequence) or not isinstance(points[0], TimedPoint):
                what = f"must be a list of {TimedPoint.__module__}.TimedPoint(t=..., q=...)"
                raise ConfigError("points", points, what)
            t = np.array([point.t for point in points])
            q = np.array([point.q for point in points])
            t_all, q_all = self._knots
            if len(t_all) == 0:
                self._refuse_far_start(t[0], q[0])
            self._check_range(np.concatenate([self._q_start[None], q]))
            t_all, q_all = np.concatenate([t_all, t]), np.concatenate([q_all, q])
            new = slice(max(0, len(t_all) - len(t) - 1), None)
            if np.any(np.diff(t_all[new]) <= 0.0):
                raise ValueError("the times of a stream must increase from point to point")
            if t[-1] - self._t_played > MOST_AHEAD:
                raise ValueError(
                    f"the point for {t[-1]:g} s is more than {MOST_AHEAD:g} s ahead of what is"
                    " played; give times in seconds, and push later points later"
                )
            self._refuse_fast(t_all[new], q_all[new])
            if self._kernel is not None:
                figures = self._acceleration(t_all, q_all, t_all[new][0], self._window)
                i = int(np.argmax(figures / self.limits.acceleration))
                when = f"after {t_all[new][0]:.3f} s"
                limit = self.limits.acceleration
                self._refuse_over(i, float(figures[i]), limit, when, "deg/s^2")
            self._take(t_all, q_all)

    def finish(self) -> Future[None]:
        """Say that no more points will come; the arm moves to the last one and settles.

        Raises:
            MotionError: The stream is over, or it holds no points.
        """
        with self._lock:
            self._refuse_if_over()
            if len(self._knots[0]) == 0:
                raise MotionError("the stream holds no points; push some before finishing it")
            self._prime()
            self._closing = True
        return self.future

    def close(self) -> Future[None]:
        """Finish it if that is not done yet; without points the arm stays where it is."""
        if self.future.done() or self._closing:
            return self.future
        if not len(self._knots[0]):
            self.push([TimedPoint(t=0.0, q=self._q_start)])
        return self.finish()

    # The I/O thread

    @property
    def is_primed(self) -> bool:
        """Whether there are enough points to begin."""
        return self._kernel is not None

    @property
    def is_over(self) -> bool:
        return self._tail is not None and self._tail[1].is_over

    @property
    def t_last(self) -> float:
        """Time of the newest point [s]."""
        return float(self._knots[0][-1])

    @property
    def ahead(self) -> float:
        """How far the newest point is ahead of the point being played [s]."""
        t = self._knots[0]
        return float(t[-1]) - self._t_played if len(t) else 0.0

    def sample(self, k: int) -> Setpoint:
        """The setpoint of tick ``k``; the start until there are enough points.

        Raises:
            MotionError: The points have run out, or lead into contact.
        """
        if self._kernel is not None:
            self._k_first = k if self._k_first is None else self._k_first
            self._t_before = self._t_played
            self._now = self._next(k, (k - self._k_first) * self._dt)
            self._refuse_contact()
        self._k = k
        return self._now

    def stop_ahead(self) -> tuple[Array, float]:
        """Joint angles while they stop from the last sample, (m, n), and the time step [s]."""
        ahead = self._ahead(self._t_played)
        if self._tail is not None or len(ahead) > self._needed(ahead):
            return stop_along(ahead, self._dt)
        return self._to_rest(self._now, self._stop_limits).q, self._dt

    def brake(self, now: Setpoint, limits: MotionLimits) -> Trajectory:
        """Brake along the points; where too few are left or known, see ``_to_rest``."""
        if self._leads_into is not None:
            limits = self._softer(limits)
        if self._tail is not None:
            return self._tail[1].brake(now, limits)
        if not now.qd.any():
            return online.stop(now.q, now.qd, now.qdd, limits, self._dt)
        # ``now`` is the sample before the last one if that was refused.
        t = self._t_played if now is self._now else self._t_before
        q, dt = self._ahead(t - self._dt, LOOK_AHEAD + 2), self._dt
        if len(q) > 3:
            qd, qdd = (q[2:] - q[:-2]) / (2.0 * dt), np.diff(q, 2, axis=0) / dt**2
            known = Trajectory(dt=dt, q=q[1:-1], qd=qd, qdd=qdd, duration=(len(qd) - 1) * dt)
            stopped = online.stop_on_path(known, 0.0, limits, dt)
            if not stopped.qd[-1].any():  # else the points end before the joints rest
                return stopped
        return self._to_rest(now, limits)

    def _refuse_contact(self) -> None:
        """Refuse the last sample if the joints must have stopped by then to keep out of contact."""
        guard = self.guard
        if guard is None:
            return
        ahead = self._ahead(self._t_played)
        if len(ahead) < 2:
            return
        needed = self._needed(ahead)
        stays = self._tail is not None or len(ahead) > needed
        met = guard.contact(np.concatenate((ahead[:-1:2], ahead[-1:])))
        if met is None and stays:
            return
        stop = ahead[: needed + 1] if stays else self._to_rest(self._now, self._stop_limits).q
        if len(stop) < 2:
            return
        if met is None and self._closing:  # it goes to the last point in any case
            met = guard.contact(stop)
            if met is None:
                return
        elif guard.is_free(stop) if met else guard.keeps_clear(stop):
            return
        self._leads_into = met or guard.nearest(stop)
        first, second = self._leads_into
        if met is None:
            raise MotionError(
                f"the arm stopped, because a stop could bring {first} into contact with {second}:"
                f" the stream's points reach only {self.ahead:.2f} s ahead; send them further ahead"
            )
        raise MotionError(
            f"the arm stopped, because the stream leads {first} into contact with {second}; move"
            " that away, or send points that go around it"
        )

    def _ahead(self, t: float, most: int = LOOK_AHEAD) -> Array:
        """Joint angles of the setpoints from ``t`` [s] on, as far as they are known, (n, 5)."""
        if self._tail is not None:
            return self._tail[1].ahead
        if self._kernel is None:
            return self._now.q[None]
        return self._smoothed(t, max(1, min(most, int((self.t_last - t) / self._dt + 1e-9) + 1)))

    def _needed(self, ahead: Array) -> int:
        """How many of the ticks ahead a stop along them passes."""
        return math.ceil(0.5 * stop_time(ahead, self._dt) / self._dt)

    def _to_rest(self, now: Setpoint, limits: MotionLimits) -> Trajectory:
        """To the last point if it is known, which is near then; else each joint stops by itself."""
        if self._closing and self._leads_into is None:
            q_last = self._knots[1][-1]
            return online.from_state(now.q, now.qd, now.qdd, q_last, self.limits, self._dt)
        return online.stop(now.q, now.qd, now.qdd, limits, self._dt)

    def _softer(self, limits: MotionLimits) -> MotionLimits:
        """``limits``, no harder than a stop needs to be that follows the points."""
        own, soft = self.limits, self._stop_limits
        return MotionLimits(
            velocity=limits.velocity,
            acceleration=np.minimum(
                limits.acceleration, np.maximum(soft.acceleration, _HARDER[0] * own.acceleration)
            ),
            jerk=np.minimum(limits.jerk, np.maximum(soft.jerk, _HARDER[1] * own.jerk)),
        )

    def _next(self, k: int, t: float) -> Setpoint:
        if self._tail is None and t <= self.t_last:
            return self.at(t)
        if self._tail is None:
            if not self._closing:
                raise MotionError(
                    f"the stream ran dry: its last point was for {self.t_last:.3f} s and no newer"
                    " one came in time; send points further ahead, or finish the stream"
                )
            tail = self._to_rest(self._now, self.limits)
            self._tail = (self._k, PlannedMotion(tail, self.future))
        since, motion = self._tail
        return motion.sample(k - since)

    def at(self, t: float) -> Setpoint:
        """The smoothed joint angles at ``t`` [s]; the start, at rest, at time 0."""
        self._t_played = t
        if self._kernel is None:
            return self.start
        dt = self._dt
        q = self._smoothed(t - 2.0 * dt, 3)
        return Setpoint(q=q[2], qd=(q[2] - q[1]) / dt, qdd=(q[2] - 2.0 * q[1] + q[0]) / dt**2)

    # How

    def _smoothed(self, t: float, count: int) -> Array:
        """The averaged joint angles from ``t`` [s] on, one a tick, shape (count, 5)."""
        assert self._kernel is not None
        m = len(self._kernel)
        q_raw = self._straight(t + self._dt * np.arange(1.0 - m, count))
        columns = [np.convolve(each, self._kernel, "valid") for each in q_raw.T]
        return np.column_stack(columns)

    def _straight(self, t: Array) -> Array:
        """Straight lines between the points, from ``q_start`` on; shape (len(t), 5)."""
        t_all, q_all = self._knots
        q = np.column_stack([np.interp(t, t_all, q_all[:, i]) for i in range(q_all.shape[1])])
        u = np.clip(t / self._t_blend, 0.0, 1.0)
        fade = 1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u**2)  # at rest at both ends up to u''
        return np.asarray(q + fade[:, None] * self._offset)

    def _take(self, t_all: Array, q_all: Array) -> None:
        if len(self._knots[0]) == 0:
            self._offset = self._q_start - q_all[0]
            d = np.abs(self._offset)
            # The smooth step's greatest slope is 15/8, its greatest curvature 10/sqrt(3).
            by_speed = 1.875 * d / (_BLEND_SHARE * self.limits.velocity)
            by_acceleration = np.sqrt(5.774 * d / (_BLEND_SHARE * self.limits.acceleration))
            self._t_blend = max(self._dt, float(np.max([by_speed, by_acceleration])))
        self._knots = (t_all, q_all)
        if self._kernel is None:
            if self.t_last >= LEAD:
                self._prime()
            return
        past = self._t_played - (len(self._kernel) + 2) * self._dt
        first = max(0, int(np.searchsorted(t_all, past)) - 1)
        self._knots = (t_all[first:], q_all[first:])

    def _prime(self) -> None:
        if self._kernel is not None:
            return
        dt, limits = self._dt, self.limits
        # Speed may swing from +v to -v within the first window, acceleration within the second.
        longest = math.ceil(float(np.max(2.0 * limits.velocity / limits.acceleration)) / dt)
        m = max(1, round(_SHORTEST_WINDOW / dt))
        t_all, q_all = self._knots
        while m < longest and np.any(
            self._acceleration(t_all, q_all, 0.0, m) > limits.acceleration * _SLACK
        ):
            m = min(2 * m, longest)
        m_jerk = math.ceil(float(np.max(2.0 * limits.acceleration / limits.jerk)) / dt)
        self._window = m
        self._kernel = np.convolve(np.full(m, 1.0 / m), np.full(m_jerk, 1.0 / m_jerk))

    def _acceleration(self, t_all: Array, q_all: Array, t_from: float, m: int) -> Array:
        """Greatest acceleration per joint from ``t_from`` on, averaged over ``m`` ticks."""
        t = np.arange(t_from - (m + 2) * self._dt, t_all[-1] + 0.5 * self._dt, self._dt)
        q = np.column_stack([np.interp(t, t_all, q_all[:, i]) for i in range(q_all.shape[1])])
        qd = np.diff(q, axis=0) / self._dt
        return np.asarray(np.max(np.abs(qd[m:] - qd[:-m]), axis=0) / (m * self._dt))

    def _refuse_far_start(self, t: float, q: Array) -> None:
        if t != 0.0:
            raise ValueError(f"the first point of a stream must be for time 0, not {t:g} s")
        i = int(np.argmax(np.abs(q - self._q_start)))
        if abs(q[i] - self._q_start[i]) > START_GATE:
            here = float(self._q_start[i])
            raise OutsideLimits(
                f"{ARM_JOINTS[i]}: the first point of the stream is {to_deg(float(q[i])):.1f} deg,"
                f" but the arm is at {to_deg(here):.1f} deg, more than {to_deg(START_GATE):g} deg"
                " away; move there first or begin where the arm is",
                joint=ARM_JOINTS[i],
                value=float(q[i]),
                lower=here - START_GATE,
                upper=here + START_GATE,
            )

    def _refuse_fast(self, t: Array, q: Array) -> None:
        if len(t) < 2:
            return
        speed = np.abs(np.diff(q, axis=0)) / np.diff(t)[:, None]
        k, i = np.unravel_index(int(np.argmax(speed / self.limits.velocity)), speed.shape)
        self._refuse_over(
            int(i), float(speed[k, i]), self.limits.velocity, f"at {t[k]:.3f} s", "deg/s"
        )

    def _refuse_over(self, i: int, value: float, limit: Array, when: str, unit: str) -> None:
        if value > limit[i] * _SLACK:
            raise OutsideLimits(
                f"{ARM_JOINTS[i]}: the points ask for {to_deg(value):.1f} {unit} {when}, the limit"
                f" is {to_deg(float(limit[i])):.1f} {unit}; give the points more time",
                joint=ARM_JOINTS[i],
                value=value,
                lower=-float(limit[i]),
                upper=float(limit[i]),
            )
