"""Fit the pose between the bases of two arms from points that their tips have touched.

Both arms are guided by hand so that the tips of their jaws meet, at five points or more that are
well spread. Each touch gives the same point in both base frames; the pose between the frames that
fits them best is found by least squares, and the residuals show how good it is.

Source: W. Kabsch, A solution for the best rotation to relate two sets of vectors, Acta
Crystallographica A 1976.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from so101_motion.common.errors import CalibrationError
from so101_motion.common.geometry import SE3, Array, freeze, frozen_array
from so101_motion.common.units import to_mm

if TYPE_CHECKING:
    from so101_motion.arm.arm import Arm

FEWEST = 5  # fewest touches: three fix a pose, two more show how well they agree. Chosen

SPREAD = 0.02
"""How far touches must be from one line, root mean square [m]; chosen: with six of them, errors of
a millimetre then turn the base about that line by about one degree."""

WORST = 0.006
"""Largest residual of a touch [m]. Chosen: tips of 3 mm that are held together by hand, and a
calibration that is off by half a degree at 300 mm."""

TIP = 0.0063
"""How far the tip of the fixed jaw is beyond the frame ``jaw_tip`` [m]; see ``urdf/README.md``."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BaseFit:
    """A fitted pose between two bases, and its residuals."""

    T_first_second: SE3  # pose of the second arm's base in that of the first
    residuals: Array  # how far the tips would be apart at each touch, shape (n,), [m]

    def __post_init__(self) -> None:
        freeze(self, residuals=(-1,))

    @property
    def rms(self) -> float:
        """Root mean square of the residuals [m]."""
        return float(np.sqrt(np.mean(self.residuals**2)))


def fit_base(p_first: Array, p_second: Array) -> BaseFit:
    """Fit the pose between two bases to touches in both base frames, shapes (n, 3), [m]."""
    p_first, p_second = frozen_array(p_first, (-1, 3)), frozen_array(p_second, (-1, 3))
    if p_first.shape != p_second.shape:
        raise ValueError(f"{len(p_first)} places of one arm and {len(p_second)} of the other")
    count = len(p_first)
    if count < FEWEST:
        raise CalibrationError(
            None, f"{count} touches are too few", f"let the tips touch at {FEWEST} places or more"
        )
    for places in (p_first, p_second):
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False) / np.sqrt(count)
        if spread[1] < SPREAD:
            raise CalibrationError(
                None,
                f"all touches are within {to_mm(float(spread[1])):.0f} mm of one line",
                f"spread them, {to_mm(SPREAD):.0f} mm or more to the side as well",
            )
    mean_first, mean_second = p_first.mean(axis=0), p_second.mean(axis=0)
    U, _, Vt = np.linalg.svd((p_second - mean_second).T @ (p_first - mean_first))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))])
    R = Vt.T @ turn @ U.T
    T = SE3(R, mean_first - R @ mean_second)
    residuals = np.linalg.norm(p_second @ R.T + T.p - p_first, axis=1)
    worst = int(np.argmax(residuals))
    if residuals[worst] > WORST:
        raise CalibrationError(
            None,
            f"touch {worst + 1} of {count} does not fit the others by"
            f" {to_mm(float(residuals[worst])):.1f} mm ({to_mm(WORST):.0f} mm at most)",
            "repeat it; if another one is off then, calibrate both arms first",
        )
    return BaseFit(T_first_second=T, residuals=residuals)


def measure_bases(
    arms: Mapping[str, Arm], count: int, touch: Callable[[str, str, int], object]
) -> dict[str, BaseFit]:
    """Measure the poses of arms' bases from touches by hand.

    All arms are in manual mode meanwhile and are held again in the end.

    Args:
        arms: The arms by name; the base of the first is known.
        count: How many touches of each other arm with the first.
        touch: Called for each touch with the first arm's name, the other's, and the number of the
            touch, from 1; returns when the user has let the tips meet.

    Returns:
        The fit for each arm but the first.
    """
    first, *others = arms
    fits = {}
    try:
        for arm in arms.values():
            arm.set_manual(True, replace(arm.compliance, wall=0.0))  # the tips shall touch
        for other in others:
            met = []
            for number in range(1, count + 1):
                touch(first, other, number)
                met.append((tip_of(arms[first]), tip_of(arms[other])))
            p_first, p_second = (np.array(each) for each in zip(*met, strict=True))
            fits[other] = fit_base(p_first, p_second)
    finally:
        for arm in arms.values():
            arm.set_manual(False)
    return fits


def tip_of(arm: Arm) -> Array:
    """Where the tip of the fixed jaw is in the arm's base frame, as measured, shape (3,), [m]."""
    T_base_jaw_tip = arm.T_base("jaw_tip")
    return frozen_array(T_base_jaw_tip @ np.array([0.0, 0.0, TIP]), (3,))
