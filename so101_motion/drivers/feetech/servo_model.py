"""Model a position servo: the error that makes a torque, its friction, its lag and its play.

A position loop without integral makes torque only from an error: ``p_gain / 4`` thousandths of full
drive for each tick, and a constant that helps it over its friction. So a goal lies beyond the
wanted position by the error that makes the torque for load and friction and, at speed, overcomes
the voltage that the motor induces. How much torque full drive makes follows from the supply.

Dry friction opposes the motion and grows with what the gears carry, so a joint that is lifted needs
more than its weight and one that is lowered less. In between it rests wherever it has come to.

A joint whose load changes sides stands still until its motor has crossed the play of the gears
(``stray_in_play``). Until then nothing tells it from a joint that has met something: the encoder is
behind the gears, so both stand, and their error and duty grow alike. At 12 V and a P gain of 32 a
free motor gets 27 deg/s faster for each degree of error, 0.02 s later. So it crosses 1 deg of play
in 0.07 s at 10 deg/s and in 0.05 s at 15. To that come margins for friction and load, a reading
every 0.01 s, ticks of 0.09 deg, and the 0.1 to 0.2 deg by which an emulated wall gives way. So a
contact is seen after 0.11 to 0.13 s at 10 deg/s, and within 0.1 s from 15 deg/s on.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any

from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.drivers.feetech.lag_compensation import BRAKING
from so101_motion.drivers.servo_types import (
    AS_SOLD,
    START_DUTY,
    STS3215_12V,
    ServoFigures,
    ServoType,
)
from so101_motion.native.library import quick

LARGEST_SAG = 3.4
"""Torque beyond which an error cannot be the arm's weight [N m]: with 300 g in the jaws of the
stretched arm its shoulder takes 3.1 to be lifted. A 7.4 V servo makes 3.8 at full drive."""

_DEAD_ZONE = 1.0 * RAD_PER_TICK
"""Errors up to this count as none: registers 26 and 27 as delivered [rad]."""

_OF_ITS_KIND = (
    "torque_per_volt", "back_emf", "armature", "viscous", "coulomb", "load_external", "load_motor",
    "still_external", "still_motor", "stribeck_speed", "goal_delay", "loop_delay",
)  # fmt: skip


def full_drive_error(p_gain: int) -> float:
    """The position error at which a P gain alone makes full drive [rad]."""
    return 4000.0 / max(p_gain, 1) * RAD_PER_TICK


class ServoModel(ctypes.Structure):
    """Model of one servo: its type, and how it was found to differ from it; see ``servo_trim.c``.

    Attributes:
        kind: The type with its own figures.
        braking: How fast its set-point slows down [rad/s^2].
        full_drive_error: The position error at which it makes full drive [rad].
        volts: Its supply [V], measured if possible.
        most_drive: The largest share of full drive that its torque limit allows.
        is_known: 1 if an identification has found how it differs from its type, else 0.
    """

    _fields_ = [
        *((name, ctypes.c_double) for name in (*_OF_ITS_KIND, "over_shape", "play", "start_duty")),
        *((name, ctypes.c_double) for name in ("dead_zone", "braking", "full_drive_error")),
        *((name, ctypes.c_double) for name in ("volts", "most_drive", "largest_load", "is_known")),
    ]
    braking: float
    full_drive_error: float
    volts: float
    most_drive: float

    def __init__(
        self,
        sold_as: ServoType = STS3215_12V,
        p_gain: int = 32,
        braking: float = BRAKING[0],
        figures: ServoFigures = AS_SOLD,
    ) -> None:
        self.sold_as, self.p_gain, self.figures = sold_as, p_gain, figures
        self.kind, self._in_c, self._at = (
            figures.of(sold_as),
            quick(),
            ctypes.c_void_p(ctypes.addressof(self)),
        )
        own: dict[str, Any] = {name: getattr(self.kind, name) for name in _OF_ITS_KIND}
        super().__init__(
            **own, over_shape=1.0 / self.kind.duty_shape,
            play=math.nan if figures.play is None else figures.play, start_duty=START_DUTY,
            dead_zone=_DEAD_ZONE, braking=braking, full_drive_error=full_drive_error(p_gain),
            volts=sold_as.volts, most_drive=1.0, largest_load=LARGEST_SAG,
            is_known=figures != AS_SOLD,
        )  # fmt: skip

    @property
    def stiffness(self) -> float:
        """Approximate torque that the goal adds for each radian farther on [N m/rad]."""
        return float(self._in_c.so101_servo_stiffness(self._at))

    def distance(self, torque: float, speed: float = 0.0) -> float:
        """How far beyond its joint the goal must be [rad] for a torque [N m] at a speed [rad/s]."""
        return float(self._in_c.so101_servo_distance(self._at, torque, speed))

    def drive(self, distance: float) -> float:
        """The share of full drive that the servo makes of an error [rad], as it measures it."""
        return float(self._in_c.so101_servo_drive(self._at, distance))

    def stray_in_play(self, speed: float) -> float:
        """How far a joint falls behind at ``speed`` while its motor crosses the play [rad].

        A free motor accelerates by ``h`` times the error, ``late`` after the error. At speed v it
        has moved by v t + h v (t - late)^2 / 2 at time t; it has crossed the play when that equals
        the play.
        """
        return float(self._in_c.so101_servo_stray(self._at, speed))

    def error_for(self, torque: float) -> float:
        """The error that makes ``torque`` [N m], at most that of full drive [rad]."""
        return float(self._in_c.so101_servo_error_for(self._at, torque))

    def friction(self, load: float, way: float, speed: float = 0.0) -> float:
        """Friction that the motor must overcome [N m], zero or positive, at ``speed`` [rad/s].

        ``load`` holds the joint without friction [N m]; ``way`` is the direction in which friction
        is to be overcome, and how fully, -1 to 1.
        """
        return float(self._in_c.so101_servo_friction(self._at, load, way, speed))
