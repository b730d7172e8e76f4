"""Convert joint angles to those of the same arm under another calibration."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from so101_motion.arm.gripper import JAW_CLOSED
from so101_motion.calib.record.store import Stored
from so101_motion.calib.record.zero import in_force
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.bus.ticks import RAD_PER_TICK, JointMap
from so101_motion.rig.joint_setup import joint_map
from so101_motion.tasks.datasets.units import DEGREES, exact_units_of

_ROUNDING = 1e-4
"""Angles this far beyond a travel count as inside [rad], because files are rounded."""


@dataclass(frozen=True, kw_only=True)
class JointReading:
    """A conversion from recorded numbers to joint angles, with the joints' travels, as plain data.

    Attributes:
        factor: The angle of one unit, for five joints [rad].
        offset: The angles at 0 [rad].
        lower: The lowest angles that the arm goes to [rad].
        upper: The highest [rad].
    """

    factor: tuple[float, ...]
    offset: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def angles(self, x: Array) -> Array:
        """Convert numbers to joint angles [rad], shapes (n, 5)."""
        return np.asarray(x * np.array(self.factor) + np.array(self.offset))

    def beyond(self, q: Array) -> tuple[str, float] | None:
        """The joint that is farthest outside its travel, and by how much [rad]; None if none is.

        Args:
            q: Joint angles, shape (5,), [rad].
        """
        over = np.maximum(np.array(self.lower) - q, q - np.array(self.upper))
        worst = int(np.argmax(over))
        if over[worst] <= _ROUNDING:
            return None
        return ARM_JOINTS[worst], float(over[worst])


def as_lerobot(stored: Stored) -> JointReading:
    """The conversion of LeRobot's degrees for the arm of a calibration.

    Raises:
        ConfigError: The calibration lacks a joint.
    """
    units = exact_units_of(DEGREES, stored, option="calibration")
    columns = (units.factor, units.offset, units.lower, units.upper)
    factor, offset, lower, upper = (tuple(each[:5].tolist()) for each in columns)
    return JointReading(factor=factor, offset=offset, lower=lower, upper=upper)


def since(taught: Stored, now: Stored) -> JointReading:
    """The conversion from angles of an old calibration to those of a new one [rad].

    The same encoder counts mean different angles under the two calibrations.

    Raises:
        ConfigError: A calibration lacks a joint, or they count in different directions.
    """
    pairs = list(zip(_maps(taught), _maps(now), strict=True))
    offset = []
    for joint, (before, after) in zip(ARM_JOINTS, pairs, strict=True):
        if before.direction != after.direction:
            raise ConfigError(
                "calibration", joint, "counts the other way round than the one before"
            )
        ticks = _encoder_at_zero(before) - _encoder_at_zero(after)
        offset.append(math.remainder(after.direction * ticks * RAD_PER_TICK, 2.0 * math.pi))
    return JointReading(
        factor=(1.0,) * 5,
        offset=tuple(offset),
        lower=tuple(after.lower for _, after in pairs),
        upper=tuple(after.upper for _, after in pairs),
    )


def _maps(stored: Stored) -> Iterator[JointMap]:
    for joint in ARM_JOINTS:
        entry = stored.calibration.get(joint)
        if entry is None:
            raise ConfigError("calibration", str(stored.path), f"lacks {joint}")
        zero = in_force(stored.zeros.get(joint), None, entry, None)
        offset = entry.homing_offset
        yield joint_map(joint, entry, offset=offset, jaw_closed=JAW_CLOSED, zero=zero)


def _encoder_at_zero(joint: JointMap) -> float:
    return joint.zero_ticks + (joint.homing_offset or 0)
