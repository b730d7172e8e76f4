"""Convert between the joint values of LeRobot and ours.

LeRobot's value of an arm joint is in degrees from the middle of its recorded travel, with 4095
ticks a turn, or -100 to 100 over that travel; the jaw is 0 to 100. Ours are radians from the
model's zero, and an aperture from 0 to 1. Both are computed from the same ticks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.drivers.bus.ticks import TICKS_PER_RAD
from so101_motion.rig.joint_setup import JointSetup

JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)
"""LeRobot's names of the six motors are ours, in the same order."""

KEYS = tuple(f"{joint}.pos" for joint in JOINTS)
"""The keys of an action and of an observation."""

_LEROBOT_TURN = 4095
"""LeRobot's number of ticks a turn; a servo has 4096."""


@dataclass(frozen=True, slots=True)
class _Scale:
    """``value = (q - middle) * factor``, for one arm joint."""

    middle: float
    factor: float


class JointUnits:
    """Converts joint values of one arm.

    Args:
        setups: Its joints, with their calibration.
        use_degrees: Whether LeRobot's values are degrees, else -100 to 100.
    """

    def __init__(self, setups: Mapping[str, JointSetup], *, use_degrees: bool = True) -> None:
        self._scales = [_scale(setups[joint], use_degrees) for joint in ARM_JOINTS]

    def to_lerobot(self, q: Sequence[float] | Array, aperture: float) -> dict[str, float]:
        """LeRobot's values of joint angles, shape (5,), [rad], and an aperture, 0 to 1."""
        values = [(float(at) - s.middle) * s.factor for at, s in zip(q, self._scales, strict=True)]
        return dict(zip(KEYS, [*values, 100.0 * aperture], strict=True))

    def from_lerobot(self, values: Mapping[str, float]) -> tuple[Array, float]:
        """Joint angles, shape (5,), [rad], and aperture, 0 to 1, of LeRobot's values."""
        q = [values[k] / s.factor + s.middle for k, s in zip(KEYS, self._scales, strict=False)]
        return np.array(q), values[KEYS[5]] / 100.0


def _scale(setup: JointSetup, use_degrees: bool) -> _Scale:
    joint, entry = setup.map, setup.calibration
    middle_ticks = (entry.range_min + entry.range_max) / 2.0
    middle = joint.direction * (middle_ticks - joint.zero_ticks) / TICKS_PER_RAD
    if use_degrees:  # LeRobot ignores drive_mode here
        return _Scale(middle, joint.direction * TICKS_PER_RAD * 360.0 / _LEROBOT_TURN)
    return _Scale(middle, 200.0 * TICKS_PER_RAD / (entry.range_max - entry.range_min))


def is_number(value: object) -> bool:
    """Whether ``value`` is a finite number, or a tensor of one."""
    try:
        return math.isfinite(float(value))  # type: ignore[arg-type]  # that is the question
    except (TypeError, ValueError):
        return False
