"""Figures of the joints of an emulated SO-101: stops, inertia, acceleration and zeros.

No emulated figure has been compared with an SO-101 of our own; ``servo_types.py`` has those of the
servos. Angles are in the frame of the arm's model [rad]. ``zero_ticks`` and ``direction`` say what
a servo's encoder reads at joint angle zero and in which direction it counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.drivers.emulator.registers import TICKS_PER_TURN

TICKS_PER_RAD = TICKS_PER_TURN / math.tau
JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)
"""Along the cable, from the base: servo ids 1 to 6 of a finished arm."""

MAX_DUTY = 0.97
"""Largest PWM duty (firmware: 970 of 1000)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """One joint and how its servo sits in it."""

    name: str  # the joint
    lower: float  # mechanical stop [rad]
    upper: float  # mechanical stop [rad]
    # of the links it turns, an average, chosen [kg m^2]; rotor and gears come on top
    inertia: float
    acceleration_slope: float = 108.4  # profile acceleration per unit of register 41 [tick/s^2]
    # profile acceleration at register 41 = 0, extrapolated [tick/s^2]
    acceleration_offset: float = 386.0
    # largest profile acceleration, with register 85 as delivered [tick/s^2]
    acceleration_ceiling: float = 6507.0
    zero_ticks: int = 2048  # encoder reading at joint angle zero, homing offset not applied
    direction: int = 1  # +1 if the encoder counts up with the joint angle, else -1


def _joint(name: str, lower_deg: float, upper_deg: float, inertia: float) -> Joint:
    lower, upper = math.radians(lower_deg), math.radians(upper_deg)
    return Joint(name=name, lower=lower, upper=upper, inertia=inertia)


def _timed(joint: Joint, slope: float, offset: float, ceiling: float) -> Joint:
    return replace(
        joint,
        acceleration_slope=slope,
        acceleration_offset=offset,
        acceleration_ceiling=ceiling,
    )


SO101 = (
    _timed(_joint("shoulder_pan", -115.2, 123.4, 0.012), 127.6, 533.0, 7099.0),
    _timed(_joint("shoulder_lift", -105.5, 102.6, 0.014), 89.3, 329.0, 5282.0),
    _timed(_joint("elbow_flex", -102.4, 90.8, 0.007), 108.2, 296.0, 7140.0),
    _joint("wrist_flex", -103.2, 102.0, 0.002),
    _joint("wrist_roll", -164.9, 171.3, 0.001),
    _joint("gripper", -11.5, 117.0, 0.001),
)
"""The follower arm. Stops: first contact of the official solids, agreeing with public
calibrations. Acceleration: measured on joints 1-3 of one arm (12 V, firmware 3.10, by the authors
of viam-devrel/so-101); the others get the mean of the three."""
