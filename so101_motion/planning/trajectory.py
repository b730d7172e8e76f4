"""A trajectory: a path with time, as evenly spaced samples.

Every maker of trajectories (toppra with bounded jerk, ruckig) ends in the same form, so one
verifier judges them all and the executor knows one thing to play. The executor's period is the
sample period: what was verified is, sample for sample, what is sent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from so101_motion.geometry import Array, frozen_array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setpoint:
    """Where a trajectory wants the joints at one instant; shapes (n,), SI."""

    q: Array
    qd: Array
    qdd: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectory:
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
        object.__setattr__(self, "q", frozen_array(self.q, (-1, -1)))
        for name in ("qd", "qdd"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), self.q.shape))

    def __len__(self) -> int:
        return len(self.q)

    @property
    def n(self) -> int:
        """How many joints."""
        return self.q.shape[1]

    @property
    def t(self) -> Array:
        """The times of the samples, shape (N,), [s]."""
        return np.arange(len(self.q)) * self.dt

    def sample(self, t: float) -> Setpoint:
        """The setpoint at time ``t`` [s]; before the start the first, after the end the last.

        Between samples it follows the cubic that agrees with position and velocity at both.
        """
        last = len(self.q) - 1
        position = t / self.dt
        k = round(position)
        if abs(position - k) < 1e-6 or k <= 0 >= position or position >= last:
            k = min(max(k, 0), last)
            return Setpoint(q=self.q[k], qd=self.qd[k], qdd=self.qdd[k])
        k = int(position)
        u, h = position - k, self.dt
        q0, q1, v0, v1 = self.q[k], self.q[k + 1], self.qd[k], self.qd[k + 1]
        rise = q1 - q0
        c2 = 3.0 * rise - h * (2.0 * v0 + v1)
        c3 = -2.0 * rise + h * (v0 + v1)
        return Setpoint(
            q=q0 + u * (h * v0 + u * (c2 + u * c3)),
            qd=v0 + u * (2.0 * c2 + 3.0 * u * c3) / h,
            qdd=(2.0 * c2 + 6.0 * u * c3) / (h * h),
        )
