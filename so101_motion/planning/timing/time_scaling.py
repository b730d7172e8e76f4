"""Stop on a motion's own path by slowing down its time, and go on after a pause by speeding it up.

A motion that is stopped is played with its own time ``tau(t)``, whose rate falls from 1 to 0 within
a duration D. Positions are those of the motion, ``q(tau)``; by the chain rule the joints have

    velocity      q' r
    acceleration  q'' r^2 + q' r'
    jerk          q''' r^3 + 3 q'' r r' + q' r''

with ``r = tau'``. The rate falls along a ramp: its slope grows over the first part of D, stays
constant, and shrinks over the last part, so jerk is bounded and acceleration continuous at both
ends. A few shapes of ramp times a few durations are tried at once; where the motion is already
braking hard, slow beginnings fit, elsewhere quick ones. Going on is the same in reverse.

Source: J. M. Hollerbach, Dynamic Scaling of Manipulator Trajectories, 1984, for scaling time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Setpoint, Trajectory, joined

SHAPES = ((0.3, 0.3), (0.15, 0.15), (0.8, 0.15))
"""Parts of a ramp over which its slope grows and shrinks. Chosen: benchmarks/ compares the stops
they give with the shortest possible; two more shapes gained 2 %."""
POINTS = 24  # at which a ramp is tried; the one taken is measured in full
COARSE, FINE = 8, 4  # number of durations tried over the whole range, then between the last two
SHORTEST, LONGEST = 0.5, 6.0  # durations, relative to full braking; chosen
ATTEMPTS = 6  # most stops measured within a control tick; chosen, mostly one
SLOWEST = 40.0  # longest speed-up, relative to full braking; chosen
RATES = np.array([1.0, 0.85, 0.7])  # of time after a speed-up; chosen
_NONE = 1e-3  # a smaller motion counts as none, in units of radians and seconds
JERK_TOLERANCE = 0.02  # relative; chosen: samples show jerk no better


class Ramp(NamedTuple):
    """A falling rate of time over ``x = t / D`` from 0 to 1."""

    advance: Array  # how far the motion's own time has advanced, as a share of D
    rate: Array  # the rate of time, from 1 to 0
    slope: Array  # its derivative by x
    bend: Array  # its second derivative


def ramp(shape: tuple[float, float], x: Array) -> Ramp:
    """The ramp whose slope grows over the first and shrinks over the last part of D."""
    grow, shrink = shape
    steepest = 1.0 / (1.0 - 0.5 * (grow + shrink))
    # Counted from either end the formulas are the same: a quadratic, and a line beyond it.
    early, late = np.minimum(x, grow), np.minimum(1.0 - x, shrink)
    middle = np.clip(x - grow, 0.0, 1.0 - grow - shrink)
    fall = steepest * (early**2 / (2.0 * grow) + middle)
    fall += steepest * (shrink**2 - late**2) / (2.0 * shrink)
    lost = steepest * (early**3 / (6.0 * grow) + 0.5 * middle * (grow + middle))
    tail = np.maximum(x - (1.0 - shrink), 0.0)
    lost += tail - steepest * (shrink**3 - late**3) / (6.0 * shrink)
    slope = steepest * np.minimum(np.minimum(early / grow, late / shrink), 1.0)
    bend = steepest * ((x < grow) / grow - (x > 1.0 - shrink) / shrink)
    return Ramp(advance=x - lost, rate=1.0 - fall, slope=-slope, bend=-bend)


_TRIED = Ramp(
    *(
        np.stack(rows)
        for rows in zip(*(ramp(s, np.linspace(0.0, 1.0, POINTS)) for s in SHAPES), strict=True)
    )
)


def shortest_pause(
    trajectory: Trajectory, t: float, limits: MotionLimits, rest: float, own: MotionLimits
) -> Trajectory | None:
    """The shortest stop from ``t`` on, ``rest`` [s], and what is left; None as below.

    ``limits`` are those of the stop, ``own`` those with which it goes on.
    """
    dt, now = trajectory.dt, trajectory.sample(t)
    ticks = round(rest / dt)
    if not now.qd.any() and not now.qdd.any():
        return _played_out(trajectory, t, dt).with_rest(before=ticks)
    found = shortest_slowdown(trajectory, t, limits, dt, at_sample=True)
    resumed = None if found is None else shortest_speedup(trajectory, found[1], own)
    if found is None or resumed is None:
        return None
    return joined([found[0].with_rest(after=ticks), resumed])


def shortest_slowdown(
    trajectory: Trajectory, t: float, limits: MotionLimits, dt: float, *, at_sample: bool = False
) -> tuple[Trajectory, float] | None:
    """The shortest stop along a motion from time ``t`` [s] on; None if none tried keeps the limits.

    Playing the motion to its end is one of them, if that is near. Also returns the time on the
    motion's clock where it ends [s]; with ``at_sample`` a sample of the motion, if ``t`` is one.
    """
    longest = LONGEST * (_braking_time(trajectory.sample(t), limits) + 2.0 * trajectory.dt)
    durations = longest * np.geomspace(SHORTEST / LONGEST, 1.0, COARSE)
    candidates = _allowed(trajectory, t, limits, durations)
    if candidates and candidates[0][0] > durations[0]:
        last = int(np.searchsorted(durations, candidates[0][0]))
        between = np.geomspace(durations[last - 1], durations[last], FINE + 1)[1:-1]
        candidates = _allowed(trajectory, t, limits, between) + candidates
    left = trajectory.duration - t
    for duration, shape in candidates[:ATTEMPTS]:
        share = float(ramp(shape, np.ones(1)).advance[0])
        if at_sample:
            duration = math.ceil(duration * share / dt - 1e-9) * dt / share
        if left <= duration:
            break
        stopped = _slowed(trajectory, t, duration, shape, dt)
        if _keeps(stopped, limits):
            return stopped, t + duration * share
    return (_played_out(trajectory, t, dt), t + left) if left <= longest else None


def own_limits(trajectory: Trajectory) -> MotionLimits:
    """The largest speeds, accelerations and jerks of a motion."""
    return MotionLimits(
        velocity=_largest(trajectory.qd),
        acceleration=_largest(trajectory.qdd),
        jerk=_largest(np.diff(trajectory.qdd, axis=0) / trajectory.dt),
    )


def shortest_speedup(trajectory: Trajectory, t: float, limits: MotionLimits) -> Trajectory | None:
    """The shortest continuation of a motion from rest at its time ``t`` [s], to its end.

    Where the limits allow no more, its time runs slower to the end than it did; None if none tried
    keeps them.
    """
    dt = trajectory.dt
    shortest = max(_braking_time(trajectory.sample(t), limits), 2.0 * dt)
    # With an even number of ticks it goes on through the motion's own samples.
    ticks = 2 * np.ceil(0.5 * shortest / dt * np.geomspace(1.0, SLOWEST, 2 * ATTEMPTS))
    lost = 0.5 * ticks[:, None] * dt + (1.0 / RATES - 1.0) * (trajectory.duration - t)
    for i, j in zip(*np.unravel_index(np.argsort(lost, axis=None), lost.shape), strict=True):
        resumed = _sped_up(trajectory, t, int(ticks[i]), float(RATES[j]))
        if _keeps(resumed, limits):
            return resumed
    return None


def _largest(values: Array) -> Array:
    """The largest magnitude of each column, at least ``_NONE``."""
    return np.asarray(np.abs(values).max(axis=0, initial=_NONE))


def _braking_time(now: Setpoint, limits: MotionLimits) -> float:
    """Approximate time in which the slowest joint comes to rest [s]."""
    speed, bend = np.abs(now.qd), np.abs(now.qdd)
    a, j = limits.acceleration, limits.jerk
    # Slower than a^2 / j, a joint stands before it ever brakes in full.
    from_speed = np.where(speed * j < a**2, 2.0 * np.sqrt(speed / j), speed / a + a / j)
    return float(np.max(from_speed + bend / j))


def _allowed(
    trajectory: Trajectory, t: float, limits: MotionLimits, durations: Array
) -> list[tuple[float, tuple[float, float]]]:
    """Durations and shapes that keep the limits at the points tried, shortest first."""
    dt, last = trajectory.dt, len(trajectory) - 1
    position = np.minimum((t + durations[:, None, None] * _TRIED.advance).ravel() / dt, last)
    k = position.astype(np.intp)
    following = np.minimum(k + 1, last)
    u = (position - k)[:, None]
    # Linear interpolation between samples: an estimate is enough here, at a third of the work.
    qd = trajectory.qd[k] + u * (trajectory.qd[following] - trajectory.qd[k])
    change = trajectory.qdd[following] - trajectory.qdd[k]
    qdd = trajectory.qdd[k] + u * change
    qddd = change / dt
    per_time = (1.0 / durations)[:, None, None]
    rate = np.broadcast_to(_TRIED.rate, (len(durations), *_TRIED.rate.shape)).reshape(-1, 1)
    slope = (_TRIED.slope * per_time).reshape(-1, 1)
    bend = (_TRIED.bend * per_time**2).reshape(-1, 1)
    most = (1.0 + verify.TOLERANCE) * limits.acceleration, (1.0 + JERK_TOLERANCE) * limits.jerk
    fits = np.abs(qdd * rate**2 + qd * slope) <= most[0]
    fits &= np.abs(qddd * rate**3 + 3.0 * qdd * rate * slope + qd * bend) <= most[1]
    everywhere = fits.reshape(len(durations), len(SHAPES), -1).all(axis=2)
    return [(float(durations[i]), SHAPES[j]) for i, j in np.argwhere(everywhere)]


def _slowed(
    trajectory: Trajectory, t: float, duration: float, shape: tuple[float, float], dt: float
) -> Trajectory:
    """The motion from ``t`` on, its time slowed to rest within ``duration`` [s]."""
    count = math.ceil(duration / dt - 1e-9) + 1
    falling = ramp(shape, np.minimum(np.arange(count) * (dt / duration), 1.0))
    q, qd, qdd = trajectory.at(t + duration * falling.advance)
    rate, slope = falling.rate[:, None], falling.slope[:, None] / duration
    qdd = qdd * rate**2 + qd * slope
    qd = qd * rate
    qd[-1] = qdd[-1] = 0.0
    return Trajectory(dt=dt, q=q, qd=qd, qdd=qdd, duration=duration)


def _sped_up(trajectory: Trajectory, t: float, ticks: int, most: float) -> Trajectory:
    """The motion from ``t`` to its end; its time stands at first, then runs at ``most``."""
    dt, duration = trajectory.dt, ticks * trajectory.dt
    falling = ramp(SHAPES[0], 1.0 - np.arange(ticks + 1) / ticks)
    advance = most * duration * (falling.advance[0] - falling.advance)
    left = ((len(trajectory) - 1) * dt - t - advance[-1]) / most
    running = np.arange(1, max(0, math.ceil(left / dt - 1e-9)) + 1) * dt
    q, qd, qdd = trajectory.at(t + np.concatenate([advance, advance[-1] + most * running]))
    rate, slope = np.full((len(q), 1), most), np.zeros((len(q), 1))
    rate[: ticks + 1, 0] = most * falling.rate
    slope[: ticks + 1, 0] = -most * falling.slope / duration
    qdd = qdd * rate**2 + qd * slope
    qd = qd * rate
    qd[[0, -1]] = qdd[[0, -1]] = 0.0  # not nearly
    return Trajectory(dt=dt, q=q, qd=qd, qdd=qdd, duration=duration + max(left, 0.0))


def _played_out(trajectory: Trajectory, t: float, dt: float) -> Trajectory:
    """The rest of the motion from ``t`` on, to its last sample."""
    left = max(0.0, (len(trajectory) - 1) * trajectory.dt - t)
    count = math.ceil(left / dt - 1e-9) + 1
    q, qd, qdd = trajectory.at(t + np.arange(count) * dt)
    return Trajectory(dt=dt, q=q, qd=qd, qdd=qdd, duration=left)


def _keeps(stopped: Trajectory, limits: MotionLimits) -> bool:
    """Whether accelerations and jerks keep their limits; speeds do, because time only slows."""
    report = verify.limit_report(stopped, limits)
    return bool(
        report.acceleration.max() <= 1.0 + verify.TOLERANCE
        and report.jerk.max() <= 1.0 + JERK_TOLERANCE
    )
