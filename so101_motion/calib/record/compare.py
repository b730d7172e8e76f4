"""Compare a calibration with what the servos hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from so101_motion.calib.record.record import JOINTS, Calibration

FIELDS = ("homing_offset", "range_min", "range_max")
"""The fields of a calibration that servos hold, in registers 31, 9 and 11."""

TOLERANCE = 1
"""Differences up to this mean nothing [tick]: the published module gives a servo an offset that is
one tick off the one it writes to its file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """One number of one joint, in the calibration and in the servo.

    Attributes:
        field: One of ``FIELDS``.
        filed: The calibration's number [tick].
        held: The servo's number [tick]; None if it is not known.
        differs: Whether they differ by more than the tolerance; False if ``held`` is not known.
    """

    joint: str
    field: str
    filed: int
    held: int | None
    differs: bool

    @property
    def sentence(self) -> str:
        """The difference as a sentence."""
        held = "is not known" if self.held is None else f"holds {self.held}"
        return f"{self.joint}: {self.field} is {self.filed} in the calibration, the servo {held}"


def diff(
    calibration: Calibration,
    held: Mapping[str, Mapping[str, int]],
    *,
    tolerance: int = TOLERANCE,
) -> tuple[Difference, ...]:
    """Compare each number of a calibration with what the servos hold, along the cable.

    Args:
        calibration: Of some or all joints.
        held: What the servos of joints hold, by joint and by the names of ``FIELDS``; may lack
            joints that did not answer.
        tolerance: Largest difference that means nothing [tick].
    """
    return tuple(
        Difference(
            joint=joint,
            field=field,
            filed=(filed := getattr(calibration[joint], field)),
            held=(there := held.get(joint, {}).get(field)),
            differs=there is not None and abs(there - filed) > tolerance,
        )
        for joint in JOINTS
        if joint in calibration
        for field in FIELDS
    )


def as_held(calibration: Calibration) -> dict[str, dict[str, int]]:
    """A calibration in the form that ``diff`` takes for servos."""
    return {
        joint: {field: getattr(entry, field) for field in FIELDS}
        for joint, entry in calibration.items()
    }
