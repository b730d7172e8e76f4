"""Measure how well the arm followed its setpoints during a motion.

A joint that only lags has an error in proportion to its speed, so the lag is the least-squares
fit of ``e = -lag * qd_ref`` over all joints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from so101_motion.common.geometry import Array, freeze
from so101_motion.common.state import JointState
from so101_motion.files.trajectory_export import Run

_MOST = 6000  # snapshots that are kept: three minutes of them; chosen

_FAST_ENOUGH = 0.05
"""The lag is computed only if some joint was to be faster than this [rad/s]; chosen."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracking:
    """The measured states of one motion."""

    t: Array  # since it began, shape (n,), [s]
    q: Array  # measured joint angles, shape (n, 5), [rad]
    error: Array  # the same minus the wanted ones, shape (n, 5), [rad]
    lag: float | None  # how late the joints were on the whole [s]; None when they hardly moved

    def __post_init__(self) -> None:
        freeze(self, t=(-1,))
        freeze(self, q=(len(self.t), 5), error=(len(self.t), 5))

    @property
    def run(self) -> Run:
        return Run(t=self.t, q_ref=self.q - self.error, q=self.q)

    @property
    def rms(self) -> Array:
        """Root mean square of each joint's error, shape (5,), [rad]."""
        return np.asarray(np.sqrt(np.mean(self.error**2, axis=0)))

    @property
    def worst(self) -> Array:
        """Each joint's largest error, without its sign, shape (5,), [rad]."""
        return np.asarray(np.max(np.abs(self.error), axis=0))


class MotionTracker:
    """Measures one motion after the other, whatever moves the arm.

    Attributes:
        newest: The newest motion that has ended; None before.
        began: When the motion under way, or the last one, was first seen [s]; None before.
    """

    def __init__(self) -> None:
        self.newest: Tracking | None = None
        self.newest_name = ""
        self.began: float | None = None
        self._states: list[JointState] = []
        self._called = ""

    def take(self, state: JointState, name: str) -> bool:
        """Record ``state`` if it is new; return whether a motion has just ended.

        A motion that begins now is called ``name``.
        """
        states = self._states
        if state.arm_moving:
            if not states:
                self.began, self._called = state.t, name
            if not states or (state.t > states[-1].t and len(states) < _MOST):
                states.append(state)
            return False
        self._states = []
        if len(states) > 1:
            self.newest, self.newest_name = _tracking(states), self._called
        return bool(states)


def _tracking(states: list[JointState]) -> Tracking:
    t = np.array([state.t for state in states])
    q = np.array([state.q for state in states])
    error = q - np.array([state.q_ref for state in states])
    qd_ref = np.array([state.qd_ref for state in states])
    lag = None
    if np.max(np.abs(qd_ref)) > _FAST_ENOUGH:
        lag = max(-float(np.sum(error * qd_ref) / np.sum(qd_ref**2)), 0.0)
    return Tracking(t=t - t[0], q=q, error=error, lag=lag)
