"""Verify that a trajectory keeps its limits, or say which joint breaks which limit by how much.

Velocity, acceleration and jerk are measured on the samples that are sent: the first, second and
third differences of positions. The velocities and accelerations that a trajectory gives for its
samples are checked too; the larger value counts. A difference of exact samples is a mean of the
true value around it, so a motion that keeps its limits always passes, and at 1 kHz nothing that a
servo could notice is missed.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from so101_motion.common.errors import OutsideLimits
from so101_motion.common.geometry import Array, freeze
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import range_deg, to_deg
from so101_motion.native.library import native
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.planning.timing.trajectory import Trajectory

TOLERANCE = 1e-3  # of a limit, relative; chosen above the effect of sampling
POSITION_TOLERANCE = 1e-6  # the same for positions [rad]. Chosen: a servo tick is 1.5e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LimitReport:
    """Share of each limit that a motion uses, joint by joint; 1 is all of it."""

    velocity: Array  # largest speed over its limit, shape (n,)
    acceleration: Array  # largest acceleration over its limit, shape (n,)
    jerk: Array  # largest jerk over its limit, shape (n,)
    outside: Array  # furthest excursion beyond the position limits, shape (n,), [rad]; 0 inside
    effort: float = 0.0  # largest torque of any joint over its servo's limit; 0 if not checked

    def __post_init__(self) -> None:
        freeze(self, velocity=(-1,), acceleration=(-1,), jerk=(-1,), outside=(-1,))

    @property
    def worst(self) -> float:
        """The largest share of any velocity, acceleration or jerk limit."""
        return float(max(self.velocity.max(), self.acceleration.max(), self.jerk.max()))

    @property
    def stretch(self) -> float:
        """The factor by which the motion would have to be slowed to use its limits exactly."""
        roots = (self.velocity.max(), self.acceleration.max() ** 0.5, self.jerk.max() ** (1 / 3))
        return float(max(roots))


def limit_report(
    trajectory: Trajectory,
    limits: MotionLimits,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
) -> LimitReport:
    """Measure a trajectory against its limits.

    Args:
        trajectory: The trajectory.
        lower: Smallest joint angles, shape (n,), [rad]; None for no bound.
        upper: Largest joint angles, shape (n,), [rad]; None for no bound.
    """
    if len(limits.velocity) != trajectory.n:
        raise ValueError(f"limits for {len(limits.velocity)} joints, a motion of {trajectory.n}")
    motion = [np.ascontiguousarray(each) for each in (trajectory.q, trajectory.qd, trajectory.qdd)]
    peaks = np.empty((5, trajectory.n))
    native().library.so101_peaks(
        *(ctypes.c_void_p(each.ctypes.data) for each in motion),
        len(trajectory),
        trajectory.n,
        ctypes.c_double(trajectory.dt),
        ctypes.c_void_p(peaks.ctypes.data),
    )
    velocity, acceleration, jerk, least, most = peaks
    outside = np.zeros(trajectory.n)
    if lower is not None:
        outside = np.maximum(outside, np.asarray(lower) - least)
    if upper is not None:
        outside = np.maximum(outside, most - np.asarray(upper))
    return LimitReport(
        velocity=velocity / limits.velocity,
        acceleration=acceleration / limits.acceleration,
        jerk=jerk / limits.jerk,
        outside=outside,
    )


def check(
    trajectory: Trajectory,
    limits: MotionLimits,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
) -> LimitReport:
    """Measure like :func:`limit_report`, and refuse a trajectory that breaks a limit.

    Raises:
        OutsideLimits: Names the joint that is furthest off, its value and its limit.
        ValueError: The numbers of joints differ.
    """
    report = limit_report(trajectory, limits, lower, upper)
    if report.outside.max() > POSITION_TOLERANCE:
        raise _out_of_range(trajectory, report, lower, upper)
    for quantity, unit, shares, caps in (
        ("speed", "deg/s", report.velocity, limits.velocity),
        ("acceleration", "deg/s^2", report.acceleration, limits.acceleration),
        ("jerk", "deg/s^3", report.jerk, limits.jerk),
    ):
        i = int(np.argmax(shares))
        if shares[i] > 1.0 + TOLERANCE:
            joint, cap, value = _joint(i, trajectory.n), float(caps[i]), float(shares[i] * caps[i])
            raise OutsideLimits(
                f"{joint} would need {to_deg(value):.5g} {unit} of {quantity}, its limit is"
                f" {to_deg(cap):.5g} ({100.0 * (shares[i] - 1.0):.3g} % over);"
                " move more slowly or raise the limit",
                joint=joint,
                value=value,
                lower=-cap,
                upper=cap,
            )
    return report


def _out_of_range(
    trajectory: Trajectory,
    report: LimitReport,
    lower: ArrayLike | None,
    upper: ArrayLike | None,
) -> OutsideLimits:
    i = int(np.argmax(report.outside))
    floor = -np.inf if lower is None else float(np.asarray(lower)[i])
    ceiling = np.inf if upper is None else float(np.asarray(upper)[i])
    low, high = float(trajectory.q[:, i].min()), float(trajectory.q[:, i].max())
    value = high if high - ceiling > floor - low else low
    return OutsideLimits(
        f"{_joint(i, trajectory.n)} would go to {to_deg(value):.2f} deg, its limits are"
        f" {range_deg(floor, ceiling)} deg; choose a path or a goal inside them",
        joint=_joint(i, trajectory.n),
        value=value,
        lower=floor,
        upper=ceiling,
    )


def _joint(i: int, n: int) -> str:
    names: Sequence[str] = ARM_JOINTS
    return names[i] if n == len(names) else f"joint {i + 1}"
