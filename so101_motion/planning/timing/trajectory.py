"""Trajectories: evenly spaced samples of position, velocity and acceleration.

All planners of trajectories (toppra with bounded jerk, ruckig) return this form, so one verifier
checks them all and the executor plays one kind. The executor's period is the sample period: exactly
the verified samples are sent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.geometry import Array, freeze
from so101_motion.common.public import Public


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setpoint:
    """A trajectory at one instant.

    Attributes:
        q: Position, shape (n,), [rad].
        qd: Velocity, shape (n,), [rad/s].
        qdd: Acceleration, shape (n,), [rad/s^2].
    """

    q: Array
    qd: Array
    qdd: Array

    @classmethod
    def at_rest(cls, q: Array) -> Setpoint:
        """A setpoint at rest at a copy of ``q``, shape (n,), [rad]."""
        zeros = np.zeros(len(q))
        return cls(q=np.array(q, dtype=np.float64), qd=zeros, qdd=zeros)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Trajectory(Public):
    """Joint motion over time, at rest at the end and usually at the start.

    Attributes:
        dt: Time between samples [s].
        q: Positions, shape (N, n), [rad].
        qd: Velocities, shape (N, n), [rad/s].
        qdd: Accelerations, shape (N, n), [rad/s^2].
        duration: When the goal is reached [s]; at most ``dt`` before the last sample.
    """

    dt: float
    q: Array
    qd: Array
    qdd: Array
    duration: float

    def __post_init__(self) -> None:
        freeze(self, q=(-1, -1))
        freeze(self, qd=self.q.shape, qdd=self.q.shape)

    def __len__(self) -> int:
        return len(self.q)

    def __repr__(self) -> str:
        samples = f"{len(self)} samples, {1e3 * self.dt:g} ms apart"
        return f"<Trajectory of {self.duration:.2f} s: {samples}>"

    @property
    def n(self) -> int:
        """How many joints."""
        return int(self.q.shape[1])

    @property
    def t(self) -> Array:
        """The times of the samples, shape (N,), [s]."""
        return np.asarray(np.arange(len(self.q)) * self.dt)

    def sample(self, t: float) -> Setpoint:
        """The setpoint at time ``t`` [s]; before the start the first, after the end the last.

        Between samples it is interpolated like :meth:`at`.
        """
        position = t / self.dt
        k = min(max(round(position), 0), len(self.q) - 1)
        if abs(position - k) < 1e-6 or not 0.0 < position < len(self.q) - 1:
            return Setpoint(q=self.q[k], qd=self.qd[k], qdd=self.qdd[k])
        q, qd, qdd = self.at([t])
        return Setpoint(q=q[0], qd=qd[0], qdd=qdd[0])

    def since(self, k: int) -> Trajectory:
        """The part from sample ``k`` on."""
        left = max(0.0, self.duration - k * self.dt)
        return Trajectory(dt=self.dt, q=self.q[k:], qd=self.qd[k:], qdd=self.qdd[k:], duration=left)

    def then(self, k: int, rest: Trajectory) -> Trajectory:
        """This motion, of which ``rest`` takes the place from sample ``k`` on."""
        q, qd, qdd = (
            np.concatenate((getattr(self, name)[:k], getattr(rest, name)))
            for name in ("q", "qd", "qdd")
        )
        return Trajectory(dt=self.dt, q=q, qd=qd, qdd=qdd, duration=k * self.dt + rest.duration)

    def with_rest(self, *, before: int = 0, after: int = 0) -> Trajectory:
        """The same motion with so many samples of rest around it."""
        if not before and not after:
            return self
        rests = ((before, after), (0, 0))
        ended = (len(self) - 1 + after) * self.dt if after else self.duration
        return Trajectory(
            dt=self.dt,
            q=np.pad(self.q, rests, mode="edge"),
            qd=np.pad(self.qd, rests),
            qdd=np.pad(self.qdd, rests),
            duration=ended + before * self.dt,
        )

    def at(self, t: ArrayLike) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations at times ``t`` (m,) [s], each (m, n).

        Between samples it follows the quintic that agrees with all three at both ends, so all
        three are continuous; before the start it is the first sample, after the end the last.

        Only the samples are sent, and they keep the caps. Between them the interpolation exceeds
        caps a little: with an arm's own caps, 10 ms apart, speed stays within 1.001 of its cap,
        acceleration within 1.02, and jerk, by differences at 1 kHz, within 1.25 on paths around
        something and 1.35 on straight moves and lines of the tool.
        """
        h, last = self.dt, len(self.q) - 1
        position = np.clip(np.asarray(t, dtype=np.float64) / h, 0.0, last)
        k = position.astype(np.intp)
        following = np.minimum(k + 1, last)
        u = (position - k)[:, None]
        q0, v0, a0 = self.q[k], self.qd[k] * h, self.qdd[k] * (0.5 * h * h)
        # The missing change of position, velocity and acceleration beyond the parabola.
        dq = self.q[following] - q0 - v0 - a0
        dv = self.qd[following] * h - v0 - 2.0 * a0
        da = self.qdd[following] * (0.5 * h * h) - a0
        c3 = 10.0 * dq - 4.0 * dv + da
        c4 = -15.0 * dq + 7.0 * dv - 2.0 * da
        c5 = 6.0 * dq - 3.0 * dv + da
        return (
            q0 + u * (v0 + u * (a0 + u * (c3 + u * (c4 + u * c5)))),
            (v0 + u * (2.0 * a0 + u * (3.0 * c3 + u * (4.0 * c4 + u * (5.0 * c5))))) / h,
            (2.0 * a0 + u * (6.0 * c3 + u * (12.0 * c4 + u * (20.0 * c5)))) / (h * h),
        )


def joined(pieces: Sequence[Trajectory]) -> Trajectory:
    """One motion of several that each start at rest where the one before ended at rest."""
    first, *others = pieces
    q, qd, qdd = (
        np.concatenate([getattr(first, name), *(getattr(piece, name)[1:] for piece in others)])
        for name in ("q", "qd", "qdd")
    )
    duration = sum(len(piece) - 1 for piece in pieces[:-1]) * first.dt + pieces[-1].duration
    return Trajectory(dt=first.dt, q=q, qd=qd, qdd=qdd, duration=duration)
