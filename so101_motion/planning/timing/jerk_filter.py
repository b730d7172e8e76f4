"""Bound the jerk of a motion by a moving average over time (an FIR filter).

A time-optimal motion jumps from full acceleration to full braking. Its average over a sliding
window of width ``w`` does not: an acceleration step of ``da`` becomes a ramp of slope ``da / w``.
Averaging only mixes values of the motion itself, so no joint goes faster, accelerates harder or
leaves its range; the motion leaves the path by at most ``a w^2 / 24``, and takes ``w`` longer.

A window of varying width saves time. In the middle a joint may change from ``+a`` to ``-a`` and
needs ``w = 2 a / j``; at the ends, next to rest, the step is only ``a``, half the window is enough,
and only the widths at the two ends lengthen the motion. With varying ``w(t)`` the average is
``(Q(t + w/2) - Q(t - w/2)) / w``, where Q is the integral of the motion, and differentiating that
gives velocity and acceleration without approximation. A changing window distorts the average by
``w'``, so the width changes slowly, and the caller measures the result.

Arrays inside have joints first and time last: numpy is fast along a long last axis.

Source: L. Biagiotti, C. Melchiorri, FIR filters for online trajectory planning with time- and
frequency-domain specifications, 2012.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.planning.timing import verify
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Trajectory

CHECK_STEP = 1e-3
"""Time between the samples on which limits are measured [s]: 1 kHz."""
JERK_SHARE = 0.985
"""Largest share of the jerk limits with which a narrower window is accepted. Chosen: while the
window changes, a step of acceleration can cause a peak shorter than the samples."""
RAMP_WIDTHS = 2.5
"""Time in which the window changes, in window widths. Chosen: if it is faster, its own acceleration
costs what it saves; if slower, the next large step comes too soon. See benchmarks/."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """A motion made of quintic pieces in time, at rest before it begins and after it ends.

    Attributes:
        begins: When each piece begins, shape (K,), [s]; the first and the last piece are rest,
            the motion between them starts at 0.
        lengths: How long each lasts, shape (K,), [s]. Kept beside ``begins`` because differences
            of times would lose the last digits of an interval of a millisecond.
        integral: The integral of the joint angles, shape (7, n, K), [rad s]: on piece k it is
            ``sum_i integral[i, :, k] u^i`` with ``u = (t - begins[k]) / lengths[k]``.
        duration: When the motion ends [s].
    """

    begins: Array
    lengths: Array
    integral: Array
    duration: float

    def at(self, t: Array, orders: int) -> list[Array]:
        """Integral, position, velocity ... at ``t`` (m,): the first ``orders`` of them, (n, m)."""
        piece = np.maximum(np.searchsorted(self.begins, t, "right") - 1, 0)
        length = self.lengths[piece]
        u = (t - self.begins[piece]) / length
        found, coefficients = [], self.integral
        for order in range(orders):
            value = coefficients[-1].take(piece, axis=1)
            for coefficient in coefficients[-2::-1]:
                value *= u
                value += coefficient.take(piece, axis=1)
            found.append(value / length**order if order else value)
            coefficients = coefficients[1:] * np.arange(1, len(coefficients))[:, None, None]
        return found


def curve_through(
    steps: Array, q: Array, qd: Array, qdd_begin: Array, qdd_end: Array, rest: float
) -> Curve:
    """The motion with the given states at the ends of each piece.

    Args:
        steps: How long each piece takes, shape (K,), [s].
        q: Positions where pieces meet, shape (K + 1, n), [rad].
        qd: Velocities there, same shape, [rad/s]; zero first and last.
        qdd_begin: Acceleration at the beginning of each piece, shape (K, n), [rad/s^2].
        qdd_end: Acceleration at its end, same shape; it may jump from piece to piece.
        rest: How long it rests before and after [s].
    """
    h, q, qd = steps, q.T, qd.T
    q0, v0, a0 = q[:, :-1], qd[:, :-1] * h, qdd_begin.T * h**2
    v1, a1 = qd[:, 1:] * h, qdd_end.T * h**2
    # What the piece still has to gain in position, velocity and acceleration beyond the parabola.
    dq, dv, da = q[:, 1:] - q0 - v0 - a0 / 2.0, v1 - v0 - a0, a1 - a0
    c3 = 10.0 * dq - 4.0 * dv + da / 2.0
    c4 = -15.0 * dq + 7.0 * dv - da
    c5 = 6.0 * dq - 3.0 * dv + da / 2.0
    integral = np.zeros((7, len(q), len(steps) + 2))
    for power, c in enumerate((q0, v0, a0 / 2.0, c3, c4, c5), start=1):
        integral[power, :, 1:-1] = h * c / power
    integral[1, :, 0], integral[1, :, -1] = rest * q[:, 0], rest * q[:, -1]
    integral[0, :, 1:] = np.cumsum(integral[1:, :, :-1].sum(axis=0), axis=1)
    begins = np.concatenate(([-rest, 0.0], np.cumsum(steps)))
    lengths = np.concatenate(([rest], steps, [rest]))
    return Curve(begins=begins, lengths=lengths, integral=integral, duration=float(begins[-1]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """Width of the average over time: a middle width, narrower towards the two ends.

    Attributes:
        first: Width where the motion starts [s].
        middle: Width in the middle [s].
        last: Width where it ends [s].
        ramp: How long the width takes to change [s].
        duration: Duration of the motion that is averaged [s].
    """

    first: float
    middle: float
    last: float
    ramp: float
    duration: float

    @property
    def begin(self) -> float:
        """When the averaged motion starts [s], on the clock of the motion itself."""
        return -0.5 * self.first

    @property
    def end(self) -> float:
        """When the averaged motion ends [s]."""
        return self.duration + 0.5 * self.last

    def width(self, t: Array) -> tuple[Array, Array, Array]:
        """The width at ``t`` (m,) and its first two derivatives, each (m,).

        It grows only once the step from rest has left the window, along a quintic step.
        """
        w, w_t, w_tt = np.full_like(t, self.middle), np.zeros_like(t), np.zeros_like(t)
        for narrow, clock, sign in (
            (self.first, t - 0.5 * self.first, 1.0),
            (self.last, self.duration - 0.5 * self.last - t, -1.0),
        ):
            depth = self.middle - narrow
            if depth > 0.0:
                u = np.clip(clock / self.ramp, 0.0, 1.0)
                w -= depth * (1.0 - u**3 * (10.0 + u * (6.0 * u - 15.0)))
                w_t += sign * depth / self.ramp * 30.0 * (u * (1.0 - u)) ** 2
                w_tt += depth / self.ramp**2 * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)
        return w, w_t, w_tt


def averaged_positions(curve: Curve, window: Window, t: Array) -> Array:
    """Positions of the averaged motion at ``t`` (m,), shape (m, n), [rad]."""
    half = 0.5 * window.width(t)[0]
    (late,), (early,) = curve.at(t + half, 1), curve.at(t - half, 1)
    return np.asarray(((late - early) / (2.0 * half)).T)


def averaged_motion(curve: Curve, window: Window, t: Array) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration of the averaged motion at ``t`` (m,), each (m, n)."""
    w, w_t, w_tt = window.width(t)
    late, late_q, late_qd = curve.at(t + 0.5 * w, 3)
    early, early_q, early_qd = curve.at(t - 0.5 * w, 3)
    ahead, behind = 1.0 + 0.5 * w_t, 1.0 - 0.5 * w_t
    q = (late - early) / w
    qd = (late_q * ahead - early_q * behind - w_t * q) / w
    bend = late_qd * ahead**2 - early_qd * behind**2 + 0.5 * w_tt * (late_q + early_q)
    return q.T, qd.T, ((bend - w_tt * q - 2.0 * w_t * qd) / w).T


def fitting_window(curve: Curve, width: float, limits: MotionLimits) -> Window:
    """The shortest window that keeps the limits, judged at each end for itself.

    At an end half the width is enough, unless a large step of acceleration comes before the window
    has grown.
    """
    ramp, reach = RAMP_WIDTHS * width, (RAMP_WIDTHS + 2.0) * width
    even = Window(first=width, middle=width, last=width, ramp=ramp, duration=curve.duration)
    if curve.duration < 2.0 * reach:
        return even
    step = max(CHECK_STEP, width / 40.0)
    t = np.arange(-3.0 * step, reach + 3.0 * step, step)
    first, last = replace(even, first=0.5 * width), replace(even, last=0.5 * width)
    reports = (
        verify.measure(averaged_positions(curve, window, at), step, limits)
        for window, at in ((first, first.begin + t), (last, last.end - t[::-1]))
    )
    first_fits, last_fits = (
        report.acceleration.max() <= 1.0 and report.jerk.max() <= JERK_SHARE for report in reports
    )
    return replace(
        even, first=first.first if first_fits else width, last=last.last if last_fits else width
    )


def check_positions(curve: Curve, window: Window) -> Array:
    """The averaged motion every ``CHECK_STEP``, with some rest before and after, (m, n), [rad]."""
    margin = 4.0 * CHECK_STEP
    t = np.arange(window.begin - margin, window.end + margin, CHECK_STEP)
    return averaged_positions(curve, window, t)


def sampled(curve: Curve, window: Window, stretch: float, dt: float) -> Trajectory:
    """The averaged motion, ``stretch`` times slower, sampled every ``dt`` [s]."""
    duration = stretch * (window.end - window.begin)
    count = math.ceil(duration / dt - 1e-9) + 1
    t = np.minimum(window.begin + np.arange(count) * (dt / stretch), window.end)
    q, qd, qdd = (np.ascontiguousarray(values) for values in averaged_motion(curve, window, t))
    q[[0, -1]] = curve.at(np.array([0.0, curve.duration]), 2)[1].T
    qd[[0, -1]] = qdd[[0, -1]] = 0.0
    return Trajectory(dt=dt, q=q, qd=qd / stretch, qdd=qdd / stretch**2, duration=duration)
