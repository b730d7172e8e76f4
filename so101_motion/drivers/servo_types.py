"""Figures of the two STS3215 types: motor, gears, friction and delays.

The emulated servos behave by them, and the driver compensates for them. Each emulated servo may
differ from its type (``emulator/emulator.py``), as each real one does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

START_DUTY = 0.016
"""Added in the direction of any demand: register 24 as delivered."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoType:
    """A motor with its gears and its reaction times, all seen at the output shaft.

    The dry friction has the form of model M5 of Rhoban's bam: ``coulomb`` without load, and a part
    that grows with what the gears carry from either side, more so near rest.
    """

    name: str  # order code
    volts: float  # rated supply [V]
    torque_per_volt: float  # of the blocked motor [N m/V]
    back_emf: float  # voltage that its speed induces [V s/rad]
    resistance: float  # of the winding [ohm]
    armature: float  # inertia of rotor and gears [kg m^2]
    viscous: float  # damping of the gears [N m s/rad]
    coulomb: float  # dry friction without load [N m]
    load_external: float  # friction per torque of the world on the output [1]
    load_motor: float  # friction per torque of the motor [1]
    still_external: float  # what is added to ``load_external`` at rest [1]
    still_motor: float  # what is added to ``load_motor`` at rest [1]
    stribeck_speed: float  # speed at which the additions have fallen to 1/e [rad/s]
    speed_limit: float  # of the set-point on its way to a goal [rad/s]
    goal_delay: float  # from a goal on the wire to the set-point that follows it [s]
    loop_delay: float  # from a measured position to the duty it causes [s]
    duty_shape: float  # exponent from demanded duty to motor voltage; below 1 small duties do more
    max_voltage_raw: int  # factory value of register 14 [0.1 V]
    play: float = math.radians(0.85)  # between gears and output [rad]

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
and back-EMF have the same constant. ``goal_delay`` includes what the recorder's own loop took.
Play: 0.8 to 0.9 deg measured on arms (robonine), 0.5 specified; a pendulum always loads its
gears."""

STS3215_7V4 = ServoType(
    name="STS3215-C001", volts=7.4, torque_per_volt=1.265 / 2.45, back_emf=1.265, resistance=2.45,
    armature=0.0131, viscous=0.003, coulomb=0.117, load_external=0.195, load_motor=0.1766,
    still_external=0.1476, still_motor=0.0, stribeck_speed=0.38, speed_limit=11.5, goal_delay=0.0,
    loop_delay=0.0, duty_shape=1.0, max_voltage_raw=80, play=0.006,
)  # fmt: skip
"""Motor: published by Rhoban (bam, Apache-2.0). Friction, inertia and play: fitted on recordings of
an arm (isaac-sim2real/sage, commit 4ffd2627, Apache-2.0); ``docs/emulator.md`` says how well. Its
set-points go at the speed of register 84 as delivered and without a delay: it answers sooner than
they would otherwise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoFigures:
    """How one servo differs from its type; shares of the type's figures, 1 where it does not.

    ``friction`` is of all friction, dry and viscous, ``dead_time`` of the delays of goals and of
    the loop; ``play`` lies between gears and output [rad] and is None if it is not known.
    """

    torque: float = 1.0
    friction: float = 1.0
    dead_time: float = 1.0
    play: float | None = None

    def of(self, kind: ServoType) -> ServoType:
        return replace(
            kind,
            coulomb=kind.coulomb * self.friction,
            viscous=kind.viscous * self.friction,
            load_external=kind.load_external * self.friction,
            load_motor=kind.load_motor * self.friction,
            still_external=kind.still_external * self.friction,
            still_motor=kind.still_motor * self.friction,
            torque_per_volt=kind.torque_per_volt * self.torque,
            goal_delay=kind.goal_delay * self.dead_time,
            loop_delay=kind.loop_delay * self.dead_time,
            play=kind.play if self.play is None else self.play,
        )


AS_SOLD = ServoFigures()
"""A servo that does not differ from its type, as far as is known."""


def type_of(volts: float) -> ServoType:
    """The type of a servo, by the supply that it measures [V].

    A supply beyond 9 V is too much for the one and one below too little for the other, which both
    report as a fault. Register 14, the limit that it has as new, can have been written.
    """
    return STS3215_7V4 if volts < 9.0 else STS3215_12V
