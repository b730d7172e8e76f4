"""What an arm will do if nothing else is decided: where its joints are, and when."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from so101_motion.common.geometry import SE3, Array, frozen_array
from so101_motion.planning.collision.scene import Attached

STEP = 0.02
"""Time between the samples at which two courses are held against each other [s]. Chosen: a joint
that accelerates at 10 rad/s^2 is then within 0.2 mm of the straight line between."""


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
    """The joints of an arm over time; at rest at the end, and where it begins before that.

    Attributes:
        t: When the first sample is [s].
        dt: Time between the samples [s]; the joints go straight from one to the next.
        q: The five joints and the jaw at each, shape (n, 6), n >= 1, [rad].
    """

    t: float
    dt: float
    q: Array

    def __post_init__(self) -> None:
        if self.q.flags.writeable:  # else it is taken as it is: one is made in every control cycle
            object.__setattr__(self, "q", frozen_array(self.q, (-1, 6)))

    @classmethod
    def stop(cls, q: Array, q_jaw: float, *, t: float, dt: float) -> Course:
        """Of an arm that goes through ``q``, shape (n, 5), with the jaw at ``q_jaw`` [rad]."""
        path = np.empty((len(q), 6))
        path[:, :5], path[:, 5] = q, q_jaw
        path.setflags(write=False)
        return cls(t=t, dt=dt, q=path)

    @classmethod
    def resting(cls, q: Array, q_jaw: float) -> Course:
        """Of an arm that stays at ``q``, shape (5,), with the jaw at ``q_jaw`` [rad]."""
        return cls.stop(q[None], q_jaw, t=0.0, dt=1.0)

    @classmethod
    def along(cls, motion: Samples, q_jaw: float, *, t: float = 0.0) -> Course:
        """Of an arm that begins a motion at ``t`` [s] with the jaw at ``q_jaw`` [rad]."""
        return cls.stop(motion.q, q_jaw, t=t, dt=motion.dt)

    @property
    def end(self) -> float:
        """When it comes to rest [s]."""
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
        """What is left of it at ``t`` [s], on a clock that shows 0 then."""
        if t >= self.end:
            return Course(t=0.0, dt=self.dt, q=self.q[-1:])
        if t <= self.t:
            return replace(self, t=self.t - t)
        count = int(np.ceil((self.end - t) / self.dt - 1e-9)) + 1
        return Course(t=0.0, dt=self.dt, q=self.at(t + self.dt * np.arange(count)))


HARDEST, AT_LEAST = 5.0, 0.1
"""A stop takes so long [s] at least, and longer by the fastest joint's speed over so much
[rad/s^2]. Chosen: stops along their path took 0.22 to 0.28 s from 1.2 rad/s, which this exceeds."""

_PLACES = 10
"""At so many places a stop is looked at."""


def stop_along(q: Array, dt: float) -> tuple[Array, float]:
    """A stop along the way that joints are on.

    Args:
        q: Where they would be, from now on, shape (n, k), [rad].
        dt: Time between these [s].

    Returns:
        Where they are while they slow down, shape (m, k), and the time between these [s].
    """
    speed = float(np.abs(q[min(1, len(q) - 1), :5] - q[0, :5]).max()) / dt
    duration = speed / HARDEST + AT_LEAST
    passed = np.linspace(0.0, duration, _PLACES)
    place = np.minimum((passed - passed**2 / (2.0 * duration)) / dt, len(q) - 1.0)
    k = place.astype(np.intp)
    following = np.minimum(k + 1, len(q) - 1)
    return q[k] + (place - k)[:, None] * (q[following] - q[k]), float(passed[1])


def stopping(course: Course, t: float) -> Course:
    """A course that slows down from ``t`` [s] on, along its own way, until it rests."""
    left = course.since(t)
    if left.t > 0.0:  # it has not begun
        return Course(t=t, dt=course.dt, q=left.q[:1])
    q, dt = stop_along(left.q, left.dt)
    return Course(t=t, dt=dt, q=q)


class NearArms(NamedTuple):
    """Bodies of an arm that are near those of another one, and how the joints bring them nearer.

    Attributes:
        bounds: Of a step that brings them no nearer than they may come, shape (n, 7); see
            ``nearest_within.py``.
        words: Which they are, by number, such as ``"the jaw close to left's wrist"``.
    """

    bounds: Array
    words: Callable[[int], str]


class Neighbours(Protocol):
    """The other arms of a cell, as the control loop of one arm has to mind them."""

    def near(self) -> Sequence[NearArms]:
        """What was near of each other arm when ``admits`` was asked last.

        It is a guess, for what to aim at: what may be done ``admits`` says.
        """

    def admits(self, q: Array, dt: float) -> bool:
        """Whether the arm may go on so that it could stop along ``q``; if so, others go by that.

        Args:
            q: Where the arm is now, and where it would be while it stops, shape (n, 5), [rad].
            dt: Time between these [s].
        """

    def commit(self, q: Array, dt: float) -> None:
        """The arm stops along ``q``, whatever is there; see ``admits``."""

    @property
    def against(self) -> str:
        """What stood against what was not admitted last, such as ``"the jaw close to left"``."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtherArm:
    """Another arm that shares the space, as a plan has to know it.

    Attributes:
        name: What messages call it.
        T_base_other: Where its base is in that of the arm that is planned for.
        course: What it is about to do; 0 is when the planned motion may begin at the earliest.
        attached: What it holds; what is passed to anybody is passed to the arm that is planned for.
    """

    name: str
    T_base_other: SE3
    course: Course
    attached: tuple[Attached, ...] = ()
