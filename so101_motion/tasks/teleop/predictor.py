"""Predict where the guided leader will be a moment from now, with a Kalman filter per joint.

It makes up for the age of a measurement and the lag of the servos. A hand's acceleration changes at
random (``JERK``) and decays within ``LASTING``, as in Singer's model of a manoeuvring vehicle. A
joint that rests stays where it is (``WAVER``). One thread adds measurements, another asks.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad

N = 6  # the arm's five joints [rad], and the aperture of the jaw, 0 to 1

JERK = 120.0
"""Jerk of a hand that the filter expects [rad/s^3], root mean square. Chosen by trial on reaches of
up to 350 deg/s^2 with 0.08 deg of tremor: with more it follows the tremor, with less it lags."""

LASTING = 0.2  # time constant with which an acceleration decays [s]; chosen by trial as well
NOISE = to_rad(360.0 / 4096.0) / 12.0**0.5  # of a measurement [rad]: a tick, evenly distributed

WAVER = 1.6 * to_rad(360.0 / 4096.0)
"""A joint that stays within this [rad] for ``RESTING`` is at rest until it leaves it: an encoder
that wavers between two or three ticks is not motion. Chosen."""

RESTING = 0.15  # how long a joint must have stayed there [s]; chosen
LONGEST = 0.15  # how far ahead of a measurement a prediction goes at most [s]

JUMP = to_rad(15.0)
"""A joint farther than this from its prediction has jumped [rad]. A hand does not do that in 10 ms;
it was moved while it did not answer, or its calibration has changed. Chosen."""

USUAL = 0.1  # after a longer interval a joint may be farther from its prediction [s]; chosen


class Track(NamedTuple):
    """The estimated state of the leader."""

    t: float  # time of the last measurement [s]
    x: Array  # joint angles [rad] and aperture at that time, shape (6,)
    xd: Array  # their velocities, shape (6,)
    xdd: Array  # their accelerations, shape (6,)
    rest: Array  # where each rests, shape (6,); NaN for one that moves
    t_heard: float  # when all joints of the arm had answered last [s]
    jumps: int  # how often its angles have jumped


class Predictor:
    """Takes measurements of the leader and predicts its angles.

    After a silence of ``longest`` [s] the prediction starts again. ``track`` is replaced whole;
    None before the first measurement.
    """

    def __init__(self, longest: float = LONGEST) -> None:
        self._longest = longest
        self.track: Track | None = None
        self._heard = np.zeros(N)
        self._forget()

    def reset(self) -> None:
        self.track = None
        self._forget()

    # The thread that measures

    def take(self, t: float, x: Array, heard: Array) -> None:
        """Add a measurement at ``t`` [s]; an older one is ignored.

        ``x`` has the joint angles [rad] and the aperture, ``heard`` which of them were measured,
        shapes (6,).
        """
        last = self.track
        if last is None:
            if not heard[:5].all():
                return
            self._heard[:] = t
            self._begin(t, x, t, 0)
            return
        dt = t - last.t
        if dt <= 0.0:
            return
        self._heard[heard] = t
        t_heard = float(self._heard[:5].min())
        x_then, xd, xdd = _carried(last, dt)
        miss = np.where(heard, x - x_then, 0.0)
        if dt > self._longest or np.max(np.abs(miss[:5])) > JUMP * max(1.0, dt / USUAL):
            self._forget()
            self._begin(t, x, t_heard, last.jumps + 1)
            return
        gain, gain_d, gain_dd = self._gains(dt)
        x_now = x_then + gain * miss
        rest = self._resting(t, np.where(heard, x, x_now), last.rest)
        self.track = Track(
            t, x_now, xd + gain_d * miss, xdd + gain_dd * miss, rest, t_heard, last.jumps
        )

    def _begin(self, t: float, x: Array, t_heard: float, jumps: int) -> None:
        rest = np.zeros(N)
        self.track = Track(t, np.array(x), rest, rest, np.array(x), t_heard, jumps)

    def _resting(self, t: float, x: Array, rest: Array) -> Array:
        """Where each joint rests, NaN for one that moves, once ``x`` has been measured."""
        self._recent.append((t, x))
        while self._recent[0][0] < t - RESTING - 1e-9:
            self._recent.popleft()
        rest = np.where(np.abs(x - rest) <= WAVER, rest, np.nan)
        if np.isnan(rest).any() and t - self._recent[0][0] > 0.8 * RESTING:
            seen = np.array([each for _, each in self._recent])
            still = np.isnan(rest) & (np.ptp(seen, axis=0) <= WAVER)
            rest = np.where(still, seen.mean(axis=0), rest)
        return rest

    def lose(self) -> None:
        """Note that the leader does not answer any more, without waiting for a timeout."""
        if self.track is not None:
            self._heard[:] = -np.inf
            self.track = self.track._replace(t_heard=-np.inf)

    def _forget(self) -> None:
        self._p = np.diag([NOISE**2, 9.0, 9.0])  # covariance of angle, velocity, acceleration
        self._recent = deque[tuple[float, Array]]()  # measurements of the last RESTING

    def _gains(self, dt: float) -> Array:
        """How much of a miss is angle, velocity and acceleration: the textbook's Kalman filter."""
        left, rate, reach = _outlasting(dt)
        step = np.array([[1.0, dt, reach], [0.0, 1.0, rate], [0.0, 0.0, left]])
        noise = JERK * np.array([dt**3 / 6.0, dt**2 / 2.0, dt])
        p = step @ self._p @ step.T + np.outer(noise, noise)
        gains = p[:, 0] / (p[0, 0] + NOISE**2)
        self._p = p - np.outer(gains, p[0])
        return np.asarray(gains)

    # The thread that asks

    def at(self, t: float) -> tuple[Array, Array, Array] | None:
        """Angles, velocities and accelerations at ``t`` [s], shapes (6,); None if not known."""
        track = self.track
        if track is None:
            return None
        moves = np.isnan(track.rest)
        x, xd, xdd = _carried(track, min(max(t - track.t, 0.0), LONGEST))
        return np.where(moves, x, track.rest), np.where(moves, xd, 0.0), np.where(moves, xdd, 0.0)


def _carried(track: Track, dt: float) -> tuple[Array, Array, Array]:
    """Angles, velocities and accelerations ``dt`` [s] later."""
    left, rate, reach = _outlasting(dt)
    return (
        track.x + dt * track.xd + reach * track.xdd,
        track.xd + rate * track.xdd,
        left * track.xdd,
    )


def _outlasting(dt: float) -> tuple[float, float, float]:
    """What is left of an acceleration after ``dt`` [s], and its first and second integrals."""
    left = math.exp(-dt / LASTING)
    rate = LASTING * (1.0 - left)
    return left, rate, LASTING * (dt - rate)
