"""Figures of the emulated hardware: two kinds of STS3215 and the joints of one SO-101.

What was measured on arms, what a datasheet says and what was chosen is told apart row by row.
Angles are in the frame of the arm's model [rad]; a joint's servo was put on at the factory, so
``zero_ticks`` and ``direction`` say what its encoder reads at joint angle zero and which way it
counts. That is the truth a calibration has to find.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from so101_motion.drivers.emulator.registers import TICKS_PER_TURN
from so101_motion.state import ARM_JOINTS, GRIPPER_JOINT

TICKS_PER_RAD = TICKS_PER_TURN / math.tau
JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)
"""Along the cable, from the base: servo ids 1 to 6 of a finished arm."""

FRICTION = 0.05
"""Dry friction at the output shaft [N m]. 0.052 in the manufacturer-independent identifications
(SO-101 MJCF; Rhoban bam, sts3215 m1-m6: 0.053-0.056); the spread of the measured standing errors
(0.6 deg at P 16) gives 0.04."""

VISCOUS = 0.03
"""Mechanical damping [N m s/rad]. Rhoban bam m3: 0.031; with FRICTION it gives the no-load current
of the datasheet."""

MAX_DUTY = 0.97
"""Largest PWM duty (firmware: 970 of 1000)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoType:
    """An electric motor with its gears.

    Attributes:
        name: Order code.
        volts: Supply the other figures are for [V].
        stall_torque: At full duty, shaft blocked [N m].
        stall_current: Likewise [A].
        free_speed: Where back-EMF balances the supply, without any friction [rad/s].
        max_voltage_raw: Factory value of register 14 [0.1 V].
    """

    name: str
    volts: float
    stall_torque: float
    stall_current: float
    free_speed: float
    max_voltage_raw: int

    @property
    def resistance(self) -> float:
        """Winding resistance [ohm]."""
        return self.volts / self.stall_current


STS3215_12V = ServoType(
    name="STS3215-C018", volts=12.0, stall_torque=2.94, stall_current=2.7, free_speed=5.05,
    max_voltage_raw=140,
)  # fmt: skip
"""Datasheet: 30 kg.cm, 2.7 A; without load 45 rpm and 0.18 A, hence 5.05 rad/s without friction."""

STS3215_7V4 = ServoType(
    name="STS3215-C001", volts=7.4, stall_torque=1.91, stall_current=2.0, free_speed=5.88,
    max_voltage_raw=80,
)  # fmt: skip
"""Datasheet: 19.5 kg.cm, 2.0 A, 52 rpm and 0.15 A without load."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """One joint and how its servo sits in it.

    Attributes:
        name: The joint.
        lower: Mechanical stop [rad].
        upper: Mechanical stop [rad].
        inertia: Everything that turns, seen at the output shaft [kg m^2]. The rotor behind its
            1:345 gears is most of it (0.028, SO-101 MJCF); the links are an average, chosen.
        acceleration_slope: Profile acceleration per unit of register 41 [tick/s^2].
        acceleration_offset: Profile acceleration at register 41 = 0, extrapolated [tick/s^2].
        acceleration_ceiling: The profile gets no faster, with register 85 as delivered [tick/s^2].
        lash: Play between gears and output shaft [rad].
        zero_ticks: Encoder reading at joint angle zero, homing offset not applied.
        direction: +1 if the encoder counts up with the joint angle, else -1.
    """

    name: str
    lower: float
    upper: float
    inertia: float
    acceleration_slope: float = 108.4
    acceleration_offset: float = 386.0
    acceleration_ceiling: float = 6507.0
    lash: float = math.radians(0.85)
    zero_ticks: int = 2048
    direction: int = 1


def _joint(name: str, lower_deg: float, upper_deg: float, inertia: float) -> Joint:
    lower, upper = math.radians(lower_deg), math.radians(upper_deg)
    return Joint(name=name, lower=lower, upper=upper, inertia=inertia)


def _timed(joint: Joint, slope: float, offset: float, ceiling: float) -> Joint:
    """A joint whose acceleration was measured."""
    return replace(
        joint,
        acceleration_slope=slope,
        acceleration_offset=offset,
        acceleration_ceiling=ceiling,
    )


SO101 = (
    _timed(_joint("shoulder_pan", -115.2, 123.4, 0.040), 127.6, 533.0, 7099.0),
    _timed(_joint("shoulder_lift", -105.5, 102.6, 0.042), 89.3, 329.0, 5282.0),
    _timed(_joint("elbow_flex", -102.4, 90.8, 0.035), 108.2, 296.0, 7140.0),
    _joint("wrist_flex", -103.2, 102.0, 0.030),
    _joint("wrist_roll", -164.9, 171.3, 0.029),
    _joint("gripper", -11.5, 117.0, 0.029),
)
"""The follower arm. Stops: first contact of the official solids, agreeing with public
calibrations. Acceleration: measured on joints 1-3 of one arm (12 V, firmware 3.10, by the authors
of viam-devrel/so-101); the others get the mean of the three. Lash: 0.8-0.9 deg measured
(robonine), 0.5 specified."""
