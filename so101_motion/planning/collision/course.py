"""The courses of arms: joint angles over time, how an arm would stop, and its neighbours.

A course says where an arm will be, for those that must keep off it. A trajectory says how to get
there, for the loop that commands it. So a course has only what a comparison of two arms needs: the
time at which it begins, the jaw as a sixth joint, and straight lines between samples that may be
far apart. It has no velocities, keeps no limits, and goes on for ever: the arm rests before it and
after it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.geometry import SE3, Array, freeze
from so101_motion.planning.collision.scene import Attached

STEP = 0.02  # time between compared samples [s]; chosen: 0.2 mm from straight at most


class Samples(Protocol):
    """Joint angles over time, such as a ``Trajectory``."""

    @property
    def q(self) -> Array:
        """Shape (n, 5), [rad]."""

    @property
    def dt(self) -> float:
        """Time between them [s]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """Joint angles of an arm over time; at rest before the first sample and after the last."""

    t: float  # time of the first sample [s]
    dt: float  # time between the samples [s]; the joints go straight from one to the next
    q: Array  # the five joints and the jaw at each, shape (n, 6), n >= 1, [rad]

    def __post_init__(self) -> None:
        if self.q.flags.writeable:  # else it is taken as it is: one is made in every control cycle
            freeze(self, q=(-1, 6))

    @classmethod
    def through(cls, q: Array, q_jaw: float, *, t: float, dt: float) -> Course:
        """The course through ``q`` (n, 5) [rad] from ``t`` [s] on every ``dt``; the jaw stays."""
        path = np.empty((len(q), 6))
        path[:, :5], path[:, 5] = q, q_jaw
        path.setflags(write=False)
        return cls(t=t, dt=dt, q=path)

    @classmethod
    def resting(cls, q: Array, q_jaw: float) -> Course:
        """The course of an arm that stays at ``q``, shape (5,), with the jaw at ``q_jaw`` [rad]."""
        return cls.through(q[None], q_jaw, t=0.0, dt=1.0)

    @classmethod
    def along(cls, motion: Samples, q_jaw: float, *, t: float = 0.0) -> Course:
        """The course of an arm that starts a motion at ``t`` [s], the jaw at ``q_jaw`` [rad]."""
        return cls.through(motion.q, q_jaw, t=t, dt=motion.dt)

    @property
    def end(self) -> float:
        """The time at which the arm comes to rest [s]."""
        return self.t + self.dt * (len(self.q) - 1)

    def at(self, times: NDArray[np.floating[Any]]) -> Array:
        """Joints and jaw at some times, shape (m, 6), [rad]."""
        if len(self.q) == 1:
            return np.broadcast_to(self.q, (len(times), 6))
        place = np.clip((times - self.t) / self.dt, 0.0, len(self.q) - 1.0)
        k = np.minimum(place.astype(np.intp), len(self.q) - 2)
        share = (place - k)[:, None]
        return np.asarray(self.q[k] + share * (self.q[k + 1] - self.q[k]))

    def since(self, t: float) -> Course:
        """The rest of the course from ``t`` [s] on, with times counted from there."""
        if t >= self.end:
            return Course(t=0.0, dt=self.dt, q=self.q[-1:])
        if t <= self.t:
            return replace(self, t=self.t - t)
        count = int(np.ceil((self.end - t) / self.dt - 1e-9)) + 1
        return Course(t=0.0, dt=self.dt, q=self.at(t + self.dt * np.arange(count)))


HARDEST, AT_LEAST = 5.0, 0.1
"""A stop takes the second [s], plus the fastest joint's speed over the first [rad/s^2]. Chosen:
stops along their path took 0.22 to 0.28 s from 1.2 rad/s, which this exceeds."""

_PLACES = 10  # number of samples of a stop


def stop_time(q: Array, dt: float) -> float:
    """How long a stop takes from the beginning of a path [s]; arguments as for ``stop_along``."""
    speed = float(np.abs(q[min(1, len(q) - 1), :5] - q[0, :5]).max()) / dt
    return speed / HARDEST + AT_LEAST


def stop_along(q: Array, dt: float) -> tuple[Array, float]:
    """A stop along the path that joints follow, ``q`` (n, k) every ``dt`` from now on.

    Joint angles while they slow down, shape (m, k), [rad], and the time between them [s].
    """
    duration = stop_time(q, dt)
    passed = np.linspace(0.0, duration, _PLACES)
    place = np.minimum((passed - passed**2 / (2.0 * duration)) / dt, len(q) - 1.0)
    k = place.astype(np.intp)
    following = np.minimum(k + 1, len(q) - 1)
    return q[k] + (place - k)[:, None] * (q[following] - q[k]), float(passed[1])


def stopping(course: Course, t: float) -> Course:
    """A course that slows down from ``t`` [s] on, along its own path, until it rests."""
    left = course.since(t)
    if left.t > 0.0:  # it has not begun
        return Course(t=t, dt=course.dt, q=left.q[:1])
    q, dt = stop_along(left.q, left.dt)
    return Course(t=t, dt=dt, q=q)


class NearArms(NamedTuple):
    """Near pairs of bodies of two arms, with the gradients of their distances."""

    # bounds of a step that brings them no nearer than allowed, shape (n, 7); see ``guard.py``
    bounds: Array
    # a description of a pair by index, such as ``"the jaw close to left's wrist"``
    words: Callable[[int], str]


class Neighbours(Protocol):
    """The other arms of a cell, as the control loop of one arm sees them."""

    def near(self) -> Sequence[NearArms]:
        """The near bodies of each other arm at the last call of ``admits``.

        Only for choosing where to go: ``admits`` decides.
        """

    def near_at(self, q: Array) -> Sequence[NearArms]:
        """The near bodies of each other arm now, for an arm that rests at ``q``.

        Costs much less than ``admits``, which proves what somebody else decides here.
        """

    def admits(self, q: Array, dt: float) -> bool:
        """Whether the arm may go on and then stop along ``q``; if so, the others rely on it.

        ``q`` (n, 5) [rad] begins now; the arm would rest at its end.
        """

    def commit(self, q: Array, dt: float) -> None:
        """Publish that the arm stops along ``q``, without a check; see ``admits``."""

    @property
    def can_meet(self) -> bool:
        """Whether any of them stands near enough to meet this arm."""

    @property
    def against(self) -> str:
        """Why ``admits`` refused last, such as ``"the jaw close to left"``."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtherArm:
    """Another arm that shares the space, as part of a planning request."""

    name: str  # its name in messages
    T_base_other: SE3  # its base in the base frame of the planned arm
    course: Course  # its course; time 0 is the earliest start of the planned motion
    # the objects it holds; those with a ``passed_to`` are passed to the planned arm
    attached: tuple[Attached, ...] = ()
