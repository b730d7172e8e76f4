"""Figures of the emulated hardware: two kinds of STS3215 and the joints of one SO-101.

What was fitted on recordings, measured on arms, printed in a datasheet or chosen is told apart row
by row. No emulated figure has been compared with an SO-101 of our own.
Angles are in the frame of the arm's model [rad]; a joint's servo was put on at the factory, so
``zero_ticks`` and ``direction`` say what its encoder reads at joint angle zero and which way it
counts. That is the truth a calibration has to find.
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
class ServoType:
    """A motor with its gears and its reaction times, all seen at the output shaft.

    The dry friction has the form of model M5 of Rhoban's bam: ``coulomb`` without load, and a part
    that grows with what the gears carry from either side, more so near rest.

    Attributes:
        name: Order code.
        volts: Supply it is made for [V].
        torque_per_volt: Of the blocked motor [N m/V].
        back_emf: Voltage that its speed induces [V s/rad].
        resistance: Of the winding [ohm].
        armature: Inertia of rotor and gears [kg m^2].
        viscous: Damping of the gears [N m s/rad].
        coulomb: Dry friction without load [N m].
        load_external: Friction per torque of the world on the output [1].
        load_motor: Friction per torque of the motor [1].
        still_external: What is added to ``load_external`` at rest [1].
        still_motor: What is added to ``load_motor`` at rest [1].
        stribeck_speed: Speed at which the additions have fallen to 1/e [rad/s].
        speed_limit: Of the set-point on its way to a goal [rad/s].
        goal_delay: From a goal on the wire to the set-point that follows it [s].
        loop_delay: From a measured position to the duty it causes [s].
        duty_shape: Exponent from demanded duty to motor voltage; below 1 small duties do more.
        max_voltage_raw: Factory value of register 14 [0.1 V].
    """

    name: str
    volts: float
    torque_per_volt: float
    back_emf: float
    resistance: float
    armature: float
    viscous: float
    coulomb: float
    load_external: float
    load_motor: float
    still_external: float
    still_motor: float
    stribeck_speed: float
    speed_limit: float
    goal_delay: float
    loop_delay: float
    duty_shape: float
    max_voltage_raw: int

    @property
    def break_away(self) -> float:
        """Smallest torque from outside that moves the limp output [N m]."""
        return self.coulomb / (1.0 - self.load_external - self.still_external)


STS3215_12V = ServoType(
    name="STS3215-C018", volts=12.0, torque_per_volt=0.563, back_emf=2.291, resistance=4.07,
    armature=0.02212, viscous=0.01514, coulomb=0.1259, load_external=0.175, load_motor=0.01768,
    still_external=0.1084, still_motor=0.09638, stribeck_speed=0.6412, speed_limit=5.087,
    goal_delay=0.02189, loop_delay=0.004017, duty_shape=0.961, max_voltage_raw=140,
)  # fmt: skip
"""Fitted by ``benchmarks.fit_servo`` on 480 recordings of one servo on a pendulum (kscalelabs,
March 2025); ``docs/emulator.md`` says how well. ``resistance`` follows from the other two: torque
and back-EMF have the same constant. ``goal_delay`` includes what the recorder's own loop took."""

DATASHEET_12V = ServoType(
    name="STS3215-C018", volts=12.0, torque_per_volt=2.94 / 12.0, back_emf=12.0 / 5.05,
    resistance=12.0 / 2.7, armature=0.028, viscous=0.03, coulomb=0.05, load_external=0.0,
    load_motor=0.0, still_external=0.0, still_motor=0.0, stribeck_speed=1.0, speed_limit=math.inf,
    goal_delay=0.0, loop_delay=0.0, duty_shape=1.0, max_voltage_raw=140,
)  # fmt: skip
"""The same servo as its datasheet has it (30 kg.cm, 2.7 A, 45 rpm without load), with the friction
of the official robot description and no delays: 0.084 rad off the recordings where the fit is
0.0125. An emulated arm has these servos until the driver has been tuned on the fitted ones."""

STS3215_7V4 = ServoType(
    name="STS3215-C001", volts=7.4, torque_per_volt=1.265 / 2.45, back_emf=1.265, resistance=2.45,
    armature=0.0235, viscous=0.031, coulomb=0.053, load_external=0.212, load_motor=0.212,
    still_external=0.0, still_motor=0.0, stribeck_speed=1.0, speed_limit=5.087, goal_delay=0.0049,
    loop_delay=0.0, duty_shape=1.0, max_voltage_raw=80,
)  # fmt: skip
"""Published by Rhoban (bam, Apache-2.0); the speed limit is that of the 12 V type."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """One joint and how its servo sits in it.

    Attributes:
        name: The joint.
        lower: Mechanical stop [rad].
        upper: Mechanical stop [rad].
        inertia: Of the links it turns, an average, chosen [kg m^2]; rotor and gears come on top.
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
    _timed(_joint("shoulder_pan", -115.2, 123.4, 0.012), 127.6, 533.0, 7099.0),
    _timed(_joint("shoulder_lift", -105.5, 102.6, 0.014), 89.3, 329.0, 5282.0),
    _timed(_joint("elbow_flex", -102.4, 90.8, 0.007), 108.2, 296.0, 7140.0),
    _joint("wrist_flex", -103.2, 102.0, 0.002),
    _joint("wrist_roll", -164.9, 171.3, 0.001),
    _joint("gripper", -11.5, 117.0, 0.001),
)
"""The follower arm. Stops: first contact of the official solids, agreeing with public
calibrations. Acceleration: measured on joints 1-3 of one arm (12 V, firmware 3.10, by the authors
of viam-devrel/so-101); the others get the mean of the three. Lash: 0.8-0.9 deg measured
(robonine), 0.5 specified."""
