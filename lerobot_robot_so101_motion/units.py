"""Convert between the joint values of LeRobot and ours; see ``tasks/datasets/units.py``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.tasks.datasets.replay import calibration_of
from so101_motion.tasks.datasets.units import DEGREES, RANGE, units_of

JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)  # LeRobot's names of the six motors are ours, in order
KEYS = tuple(f"{joint}.pos" for joint in JOINTS)  # the keys of an action and of an observation


class JointUnits:
    """Converts joint values of one arm, whose servos are ready."""

    def __init__(self, rig: HardwareRig, *, use_degrees: bool = True) -> None:
        self._units = units_of(DEGREES if use_degrees else RANGE, calibration_of(rig))

    def to_lerobot(self, q: Sequence[float] | Array, aperture: float) -> dict[str, float]:
        """LeRobot's values of joint angles, shape (5,), [rad], and an aperture, 0 to 1."""
        return dict(zip(KEYS, self._units.numbers(np.asarray(q), aperture), strict=True))

    def from_lerobot(self, values: Mapping[str, float]) -> tuple[Array, float]:
        """Joint angles, shape (5,), [rad], and aperture, 0 to 1, of LeRobot's values."""
        x = np.array([float(values[key]) for key in KEYS])
        return self._units.to_model(x)[:5], float(x[5]) / 100.0


def is_number(value: object) -> bool:
    """Whether ``value`` is a finite number, or a tensor of one."""
    try:
        return math.isfinite(float(value))  # type: ignore[arg-type]  # that is the question
    except (TypeError, ValueError):
        return False
