"""The interface of everything that can be played, and a planned trajectory that fits it.

The executor plays every source in the same manner. Four fit: a trajectory that is known beforehand
(``PlannedMotion``), points that arrive while they are played (``Stream``), a jog
(``Jog``), and joints that follow targets (``Following``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from concurrent.futures import Future
from typing import NamedTuple, Protocol, Self, TypeVar

import numpy as np

from so101_motion.common.errors import SHUTDOWN, ArmClosed, Interrupted, MotionError
from so101_motion.common.geometry import Array
from so101_motion.common.public import Public
from so101_motion.control.request_queue import running_future
from so101_motion.planning.collision.course import stop_along
from so101_motion.planning.timing import online
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.time_scaling import (
    own_limits,
    shortest_pause,
    shortest_speedup,
)
from so101_motion.planning.timing.trajectory import Setpoint, Trajectory

FORESIGHT = 0.06
"""How far ahead the acceleration for the driver is averaged [s]: after its delay and its lag, a
servo does by then what it is sent now."""

ACTS = (0.06, 0.12)
"""When what is sent to a servo now makes it faster, from when to when [s]; chosen."""

SOON = 0.3
"""How far ahead a planned speed may be reached earlier than planned [s]; chosen: the time in which
the default acceleration reaches the default speed."""

LOOK_AHEAD = 60  # setpoints that are looked at for a stop; chosen, more than a stop needs


class MotionSource(Protocol):
    """A motion that can be played tick by tick. Only the I/O thread calls its methods."""

    @property
    def future(self) -> Future[None]:
        """Completes when the motion is over and the joints rest, or raises why it ended early."""

    @property
    def can_wait(self) -> bool:
        """Whether it may begin late, after joints have come inside their limits."""

    @property
    def start(self) -> Setpoint:
        """Where it begins."""

    def sample(self, k: int) -> Setpoint:
        """The setpoint of tick ``k``, counted from the first; ``MotionError`` if there is none."""

    @property
    def is_over(self) -> bool:
        """Whether the last sample was the last setpoint, at rest."""

    def brake(self, now: Setpoint, limits: MotionLimits) -> Trajectory:
        """A trajectory that comes to rest from the last setpoint, ``now``, within ``limits``."""


S = TypeVar("S", bound=MotionSource)

SEAM = 1e-6
"""How far position, velocity and acceleration of a continuation may be from those that it replaces
[rad, s]; chosen: rounding."""


class _Continuation(NamedTuple):
    """What is to be played from sample ``at`` of ``seen`` on."""

    seen: Trajectory
    since: int  # the sample of ``seen`` that ``whole`` begins with
    at: int
    whole: Trajectory
    taken: Future[bool]


def _highest(speeds: Array, first: int, last: int) -> Array:
    """The highest of each row's joints from ``first`` to ``last`` rows later, (n, joints)."""
    rows, n = np.pad(speeds, ((0, last), (0, 0))), len(speeds)
    highest: Array = np.max([rows[k : k + n] for k in range(first, last + 1)], axis=0)
    return highest


def rooms(qd: Array, dt: float) -> Array:
    """:attr:`PlannedMotion.room` at each sample of a trajectory with velocities ``qd`` [rad/s]."""
    acts, until, soon = (round(t / dt) for t in (*ACTS, SOON))
    speeds = np.abs(qd)
    then, later = _highest(speeds, acts, until), _highest(speeds, acts, soon)
    moves = then > 0.0
    shares = np.divide(later, then, out=np.full_like(then, np.inf), where=moves).min(axis=1) - 1.0
    return np.where(moves.any(axis=1), shares, 0.0)


class PlannedMotion:
    """A trajectory as a source; a stop brakes along its path where that is possible.

    Attributes:
        played: What is played and which of its samples was the last; replaced whole in every tick.
    """

    can_wait = True

    def __init__(self, trajectory: Trajectory, future: Future[None] | None = None) -> None:
        self.future = future or running_future()
        self._trajectory, self._k, self._k_before = trajectory, 0, 0
        self._now: Setpoint | None = None
        self._passed = 0  # samples before the first that ``_trajectory`` still has
        self._own: MotionLimits | None = None  # of what was planned, once it has rested
        self._continuation: _Continuation | None = None
        self._changes: tuple[Trajectory | None, Array, Array] = None, np.zeros((0, 0)), np.zeros(0)
        self.played = trajectory, 0

    @property
    def start(self) -> Setpoint:
        first = self._trajectory
        return Setpoint(q=first.q[0], qd=first.qd[0], qdd=first.qdd[0])

    def sample(self, k: int) -> Setpoint:
        if self._continuation is not None:
            self._continue(*self._continuation)
        k, playing = k - self._passed, self._trajectory
        self._k_before, self._k, self.played = self._k, k, (playing, k)
        row = min(max(k, 0), len(playing.q) - 1)  # ticks may be missed at the end
        self._now = Setpoint(q=playing.q[row], qd=playing.qd[row], qdd=playing.qdd[row])
        return self._now

    def splice(
        self, seen: tuple[Trajectory, int], at: int, rest: Trajectory
    ) -> tuple[Trajectory, Future[bool]]:
        """Play ``rest`` from a later sample on; any thread may call it, one at a time.

        Args:
            seen: What ``played`` was.
            at: The sample of it that the first of ``rest`` replaces.
            rest: Begins in the state of that sample, and ends at rest; ``ValueError`` if it does
                not.

        Returns:
            What is played from now on, and whether it is, told in the next tick. It is not if that
            sample
            has passed, or something else is played by then: that goes on.
        """
        trajectory, k = seen
        pairs = ((getattr(trajectory, s)[at], getattr(rest, s)[0]) for s in ("q", "qd", "qdd"))
        if any(np.abs(was - becomes).max() > SEAM for was, becomes in pairs):
            raise ValueError("the continuation of a motion begins in another state")
        whole = trajectory.since(k).then(at - k, rest)
        taken: Future[bool] = running_future()
        self._continuation = _Continuation(trajectory, k, at, whole, taken)
        return whole, taken

    def _continue(
        self, seen: Trajectory, since: int, at: int, whole: Trajectory, taken: Future[bool]
    ) -> None:
        self._continuation = None
        is_in_time = seen is self._trajectory and self._k < at
        if is_in_time:
            self._trajectory, self._k, self._passed = whole, self._k - since, self._passed + since
            self._own = None
        taken.set_result(is_in_time)

    @property
    def acceleration(self) -> Array:
        """How the joints accelerate in ``FORESIGHT`` from now on, on average, (n,) [rad/s^2]."""
        changes = self._expected()[1]
        row: Array = changes[min(self._k, len(changes) - 1)]
        return row

    @property
    def room(self) -> float:
        """By which share it could be faster now without being faster than it is going to be soon.

        What is sent now acts ``ACTS`` later; no joint is then to be faster than it is planned to be
        within ``SOON``.
        """
        rooms = self._expected()[2]
        return float(rooms[min(self._k, len(rooms) - 1)])

    def _expected(self) -> tuple[Trajectory | None, Array, Array]:
        trajectory = self._trajectory
        if trajectory is not self._changes[0]:
            qd, dt = trajectory.qd, trajectory.dt
            ahead = round(FORESIGHT / dt)
            later = np.minimum(np.arange(len(qd)) + ahead, len(qd) - 1)
            self._changes = trajectory, (qd[later] - qd) / (ahead * dt), rooms(qd, dt)
        return self._changes

    @property
    def is_over(self) -> bool:
        return self._k >= len(self._trajectory.q) - 1

    @property
    def ahead(self) -> Array:
        """Joint angles of the next setpoints from the last one on, shape (m, n), [rad]."""
        k = min(self._k, len(self._trajectory) - 1)  # ticks may be missed at the end
        return self._trajectory.q[k : k + LOOK_AHEAD]

    def stop_ahead(self) -> tuple[Array, float]:
        """Joint angles while they stop on this path, (m, n), roughly, and the time step [s]."""
        return stop_along(self.ahead, self._trajectory.dt)

    def resumed(self) -> PlannedMotion | None:
        """The rest of the motion, from rest at the last setpoint; None if that cannot be."""
        t = self._k * self._trajectory.dt
        return self._anew(shortest_speedup(self._trajectory, t, self._as_planned()))

    def paused(self, limits: MotionLimits, rest: float) -> PlannedMotion | None:
        """The motion with a stop and a ``rest`` [s] from now on; None if that cannot be."""
        t = self._k * self._trajectory.dt
        return self._anew(shortest_pause(self._trajectory, t, limits, rest, self._as_planned()))

    def _as_planned(self) -> MotionLimits:
        """With what the motion goes on: stops that were put into it since were harder."""
        self._own = self._own or own_limits(self._trajectory)
        return self._own

    def _anew(self, trajectory: Trajectory | None) -> PlannedMotion | None:
        """This motion, with ``trajectory`` from its next tick on, which is then tick 0."""
        if trajectory is None:
            return None
        self._trajectory, self._k, self._k_before, self._passed = trajectory, 0, 0, 0
        return self

    def brake(self, now: Setpoint, limits: MotionLimits) -> Trajectory:
        """Brake along the trajectory's path if possible, else each joint by itself."""
        dt = self._trajectory.dt
        if now.qd.any():
            # The last sample may have been refused; then the joints are at the one before.
            k = self._k if self._now is None or now is self._now else self._k_before
            return online.stop_on_path(self._trajectory, k * dt, limits, dt)
        return online.stop(now.q, now.qd, now.qdd, limits, dt)


class EndsWithBlock(Public, ABC):
    """Ends a motion where its ``with`` block ends, waits, and raises why it ended early."""

    future: Future[None]
    _name: str  # what messages call it
    _closing: bool

    @abstractmethod
    def close(self) -> Future[None]: ...

    def __repr__(self) -> str:
        now = self._doing
        if self.future.done():
            error = self.future.exception()
            now = "over" if error is None else f"over: {error}"
        return f"<{type(self).__name__} {now}>"

    @property
    def _doing(self) -> str:
        return "under way"

    def _refuse_if_over(self) -> None:
        """Raise why it has ended, if it has."""
        if self.future.done():
            error = self.future.exception()
            if isinstance(error, Interrupted) and error.by == SHUTDOWN:
                raise ArmClosed
            if error is not None:
                raise error.with_traceback(None)  # else it grows with each call
            raise MotionError(f"the {self._name} is over; open a new one")
        if self._closing:
            raise MotionError(f"the {self._name} has been closed; open a new one")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if not self.future.done():
            self.close()
        if kind is None:
            self.future.result()
        else:
            self.future.exception()


class OpenEndedMotion(EndsWithBlock):
    """A motion that goes on until it is closed, stopped, or cannot go on.

    Attributes:
        future: Completes when the joints are at rest after ``close``, or raises why it ended
            earlier.
    """

    def __init__(self, name: str) -> None:
        self.future: Future[None] = running_future()
        self._name, self._closing = name, False

    @property
    def keeps_apart(self) -> bool:
        """Whether it keeps off other arms of its cell by itself."""
        return False

    def close(self) -> Future[None]:
        """Slow to rest and end; may be called again."""
        self._closing = True
        return self.future
