"""Compare a calibration with what the servos hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from so101_motion.calib.record.record import JOINTS, Calibration, HeldCalibration
from so101_motion.drivers.bus.registers import TICKS_PER_TURN

FIELDS = ("homing_offset", "range_min", "range_max")
"""The fields of a calibration that servos hold, in registers 31, 9 and 11."""

TOLERANCE = 1
"""Differences up to this mean nothing [tick]: the published module gives a servo an offset that is
one tick off the one it writes to its file."""


LIMIT_TOLERANCE = 60
"""Limits up to so far apart may be two recordings of one arm's stops [tick]. Chosen: 5 degrees."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """One number of one joint, in the calibration and in the servo."""

    joint: str
    field: str  # one of ``FIELDS``
    filed: int  # the calibration's number [tick]
    held: int | None  # the servo's number [tick]; None if it is not known
    differs: bool  # whether they differ by more than the tolerance; False if ``held`` is not known

    @property
    def sentence(self) -> str:
        held = "is not known" if self.held is None else f"holds {self.held}"
        return f"{self.joint}: {self.field} is {self.filed} in the calibration, the servo {held}"


def diff(
    calibration: Calibration,
    held: Mapping[str, HeldCalibration],
    *,
    tolerance: int = TOLERANCE,
) -> tuple[Difference, ...]:
    """Compare each number with what servos hold, along the cable; ``held`` may lack joints."""
    return tuple(
        Difference(
            joint=joint,
            field=field,
            filed=(filed := getattr(calibration[joint], field)),
            held=(there := getattr(held.get(joint), field, None)),
            differs=there is not None and _apart(field, there, filed) > tolerance,
        )
        for joint in JOINTS
        if joint in calibration
        for field in FIELDS
    )


def conflicts(
    calibration: Calibration, held: Mapping[str, HeldCalibration]
) -> tuple[Difference, ...]:
    """The differences that show that the servos were not calibrated with this calibration.

    Limits that leave a servo no travel or its whole turn were never recorded: they say nothing, and
    without a homing offset the servo holds no calibration at all. Nor do limits that differ by no
    more than ``LIMIT_TOLERANCE``: other programs record the travels anew and keep the offsets.
    """
    offsets = (
        row
        for row in diff(calibration, held)
        if row.field == FIELDS[0] and row.differs and not held[row.joint].is_blank
    )
    limits = (
        row
        for row in diff(calibration, held, tolerance=LIMIT_TOLERANCE)
        if row.field != FIELDS[0] and row.differs and held[row.joint].has_travel
    )
    return tuple(sorted((*offsets, *limits), key=lambda row: JOINTS.index(row.joint)))


def agrees(calibration: Calibration, held: Mapping[str, HeldCalibration]) -> bool:
    """Whether the servos that answer were calibrated with this calibration, for all it tells.

    A loose plug does not matter. Servos that were never calibrated agree with nothing.
    """
    compared = [joint for joint in calibration if joint in held]
    return (
        any(held[joint].has_travel for joint in compared)
        and any(joint in calibration for joint in held)
        and not any(row.differs for row in diff(calibration, held))
    )


def _apart(field: str, there: int, filed: int) -> int:
    """The difference of two numbers; offsets that are a whole turn apart are the same."""
    away = abs(there - filed)
    return min(away, abs(TICKS_PER_TURN - away)) if field == FIELDS[0] else away
