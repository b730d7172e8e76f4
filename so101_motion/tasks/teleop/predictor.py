"""Predict where the guided leader will be a moment from now, with a Kalman filter per joint.

The follower's servos are some 70 ms behind goals that nobody knows beforehand, a measurement is up
to a period old when it is used, and it takes time to tell motion from noise. Most of that is made
up for by aiming at where the leader will be instead of where it was.

A Kalman filter per joint holds angle and velocity, driven by white acceleration; the velocity times
the time ahead is what is added. Two things keep noise from being foretold as well. A slow joint is
not predicted at all (``SLOW``, ``FAST``): half a degree a second is no motion but an encoder that
cannot decide. And ``ACCELERATION`` is chosen so small that the trembling of a hand at 8 Hz, which
the follower could not show anyway, passes only weakly.

One thread takes measurements, another asks: what was learnt is replaced whole.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad

N = 6
"""The arm's five joints [rad], and the aperture of the jaw, 0 to 1."""

ACCELERATION = 2.0
"""What the filter expects of a hand [rad/s^2], root mean square. Chosen by trial on reaches of up
to 350 deg/s^2 with 0.08 deg of tremor: more follows the tremor, less lags behind in the reaches."""

NOISE = to_rad(360.0 / 4096.0) / 12.0**0.5
"""What a measurement is off [rad]: an encoder tick, evenly spread."""

SLOW, FAST = to_rad(1.0), to_rad(5.0)
"""Below the first speed nothing is predicted, above the second all of it [rad/s]; chosen."""

LONGEST = 0.15
"""How far ahead of a measurement a prediction goes at most [s]."""

JUMP = to_rad(15.0)
"""How far a joint may be from where it was expected [rad]. Nobody does that in 10 ms; it was put
down elsewhere while nobody looked, or its calibration has changed. Chosen."""


USUAL = 0.1
"""What is asked less often may be further from where it was expected [s]; chosen."""


class Track(NamedTuple):
    """What the predictor knows of the leader.

    Attributes:
        t: When [s].
        x: Joint angles [rad] and aperture then, shape (6,).
        xd: How fast they changed, shape (6,).
        t_heard: When all joints of the arm had answered last [s].
        jumps: How often it was suddenly elsewhere.
    """

    t: float
    x: Array
    xd: Array
    t_heard: float
    jumps: int


class Predictor:
    """Takes measurements of the leader and predicts its angles.

    Args:
        longest: After how long a silence the leader may be anywhere [s].

    Attributes:
        track: What is known; None before the first measurement. Replaced whole.
    """

    def __init__(self, longest: float = LONGEST) -> None:
        self._longest = longest
        self.track: Track | None = None
        self._heard = np.zeros(N)
        self._forget()

    def reset(self) -> None:
        """Forget all measurements."""
        self.track = None
        self._forget()

    # The thread that measures

    def take(self, t: float, x: Array, heard: Array) -> None:
        """Add a measurement.

        Args:
            t: When it was made [s]; later than the one before, or it is ignored.
            x: Joint angles [rad] and aperture, shape (6,).
            heard: Which of them have been measured, shape (6,); the others are what they were.
        """
        last = self.track
        if last is None:
            if not heard[:5].all():
                return
            self._heard[:] = t
            self.track = Track(t, np.array(x), np.zeros(N), t, 0)
            return
        dt = t - last.t
        if dt <= 0.0:
            return
        self._heard[heard] = t
        t_heard = float(self._heard[:5].min())
        expected = last.x + dt * last.xd
        miss = np.where(heard, x - expected, 0.0)
        if dt > self._longest or np.max(np.abs(miss[:5])) > JUMP * max(1.0, dt / USUAL):
            self._forget()
            self.track = Track(t, np.array(x), np.zeros(N), t_heard, last.jumps + 1)
            return
        gain, gain_rate = self._gains(dt)
        self.track = Track(
            t, expected + gain * miss, last.xd + gain_rate * miss, t_heard, last.jumps
        )

    def lose(self) -> None:
        """Note that the leader does not answer any more, without waiting for a timeout."""
        if self.track is not None:
            self._heard[:] = -np.inf
            self.track = self.track._replace(t_heard=-np.inf)

    def _forget(self) -> None:
        self._p = (NOISE**2, 0.0, 1.0)  # variances and covariance of angle and velocity

    def _gains(self, dt: float) -> tuple[float, float]:
        """How much of a miss is angle, and how much velocity; textbook Kalman, written out."""
        p_xx, p_xv, p_vv = self._p
        q = ACCELERATION**2
        p_xx += dt * (2.0 * p_xv + dt * p_vv) + q * dt**4 / 4.0
        p_xv += dt * p_vv + q * dt**3 / 2.0
        p_vv += q * dt**2
        s = p_xx + NOISE**2
        gain, gain_rate = p_xx / s, p_xv / s
        self._p = ((1.0 - gain) * p_xx, (1.0 - gain) * p_xv, p_vv - gain_rate * p_xv)
        return gain, gain_rate

    # The thread that asks

    def at(self, t: float) -> tuple[Array, Array] | None:
        """Where the leader will be at ``t`` [s] and how fast, shapes (6,); None if never seen."""
        track = self.track
        if track is None:
            return None
        ahead = min(max(t - track.t, 0.0), LONGEST)
        u = np.clip((np.abs(track.xd) - SLOW) / (FAST - SLOW), 0.0, 1.0)
        xd = u * u * (3.0 - 2.0 * u) * track.xd
        return track.x + ahead * xd, xd
