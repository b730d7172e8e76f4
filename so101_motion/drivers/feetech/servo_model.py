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

import math

from so101_motion.common.units import to_rad
from so101_motion.drivers.bus.ticks import RAD_PER_TICK
from so101_motion.drivers.feetech.lag_compensation import BRAKING
from so101_motion.drivers.servo_types import (
    AS_SOLD,
    START_DUTY,
    STS3215_12V,
    ServoFigures,
    ServoType,
)

PLAY, PLAY_MARGIN = to_rad(1.0), 1.2
"""Largest play of gears that were not measured [rad]; safety factor for a measured play. Chosen:
an identification may find a tenth too little."""

FREED = 0.04
"""Friction that a motor must overcome alone once its load no longer helps [N m]. Chosen together
with ``CHANGED``."""

CHANGED = 0.045
"""Change of the load while the motor crosses the play [N m]. Chosen so that no emulated joint that
crosses its play seems to have hit something: ``test_servo_model.py`` lists how far such joints
fell behind, by type, P gain and speed."""

LARGEST_SAG = 3.4
"""Torque beyond which an error cannot be the arm's weight [N m]: with 300 g in the jaws of the
stretched arm its shoulder takes 3.1 to be lifted. A 7.4 V servo makes 3.8 at full drive."""

_DEAD_ZONE = 1.0 * RAD_PER_TICK
"""Errors up to this count as none: registers 26 and 27 as delivered [rad]."""


def full_drive_error(p_gain: int) -> float:
    """The position error at which a P gain alone makes full drive [rad]."""
    return 4000.0 / max(p_gain, 1) * RAD_PER_TICK


class ServoModel:
    """Model of one servo: its type, and how it was found to differ from it.

    ``braking`` is how fast its set-point slows down [rad/s^2].

    Attributes:
        is_known: Whether an identification has found how it differs from its type.
        kind: The type with its own figures.
        full_drive_error: The position error at which it makes full drive [rad].
        volts: Its supply [V], measured if possible.
        stiffness: Approximate torque that the goal adds for each radian farther on [N m/rad].
        largest_sag: The error that makes ``LARGEST_SAG`` [rad].
        most_drive: The largest share of full drive that its torque limit allows.
    """

    def __init__(
        self,
        sold_as: ServoType = STS3215_12V,
        p_gain: int = 32,
        braking: float = BRAKING[0],
        figures: ServoFigures = AS_SOLD,
    ) -> None:
        self.sold_as, self.p_gain, self.braking = sold_as, p_gain, braking
        self.figures, self.is_known = figures, figures != AS_SOLD
        self.kind, self.most_drive = figures.of(sold_as), 1.0
        self.full_drive_error = full_drive_error(p_gain)
        self._over_shape = 1.0 / self.kind.duty_shape
        self.volts = sold_as.volts

    @property
    def volts(self) -> float:
        return self._volts

    @volts.setter
    def volts(self, volts: float) -> None:
        kind, self._volts = self.kind, volts
        self._full_torque = volts * kind.torque_per_volt  # a dozen times in every cycle
        self.stiffness = self._full_torque / self.full_drive_error
        self.largest_sag = self.error_for(LARGEST_SAG)

    def distance(self, torque: float, speed: float = 0.0) -> float:
        """How far beyond its joint the goal must be [rad] for a torque [N m] at a speed [rad/s]."""
        kind = self.kind
        share = (torque / kind.torque_per_volt + kind.back_emf * speed) / self._volts
        duty: float = abs(share) ** self._over_shape - START_DUTY
        if duty <= 0.0:
            return 0.0
        error = duty * self.full_drive_error + _DEAD_ZONE
        return error if share > 0.0 else -error

    def drive(self, distance: float) -> float:
        """The share of full drive that the servo makes of an error [rad], as it measures it."""
        error = abs(distance) - _DEAD_ZONE
        return error / self.full_drive_error + START_DUTY if error > 0.0 else 0.0

    @property
    def lag(self) -> float:
        """How long a joint lags behind its setpoint without compensation [s]."""
        return self.kind.goal_delay + self.kind.back_emf / self.volts * self.full_drive_error

    def stray_in_play(self, speed: float) -> float:
        """How far a joint falls behind at ``speed`` while its motor crosses the play [rad].

        A free motor accelerates by ``h`` times the error, ``late`` after the error. At speed v it
        has moved by v t + h v (t - late)^2 / 2 at time t; it has crossed the play when that equals
        the play.
        """
        kind, play = self.kind, self.figures.play
        play = PLAY if play is None else PLAY_MARGIN * play
        if not speed:
            return play
        brake = kind.torque_per_volt * kind.back_emf
        stiffness = self.stiffness
        late = kind.loop_delay + kind.armature / (brake + kind.viscous)
        late += FREED / (stiffness * speed)
        h, more = stiffness / brake, max(play / speed - late, 0.0)
        through = late + (math.sqrt(1.0 + 2.0 * h * more) - 1.0) / h
        return min(speed * through, play) + CHANGED / stiffness

    def torque(self, distance: float) -> float:
        """Approximate torque [N m] that a further ``distance`` [rad] of the goal adds."""
        return distance * self.stiffness

    def error_for(self, torque: float) -> float:
        """The error that makes ``torque`` [N m], at most that of full drive [rad]."""
        return min(torque / self._full_torque, 1.0) * self.full_drive_error

    def friction(self, load: float, way: float, speed: float = 0.0) -> float:
        """Friction that the motor must overcome [N m], zero or positive, at ``speed`` [rad/s].

        ``load`` holds the joint without friction [N m]; ``way`` is the direction in which friction
        is to be overcome, and how fully, -1 to 1.
        """
        kind = self.kind
        still = math.exp(-abs(speed) / kind.stribeck_speed) if speed else 1.0
        world, world_still = kind.load_external * load, kind.still_external * load
        friction, motor = 0.0, load
        for _ in range(2):  # what the motor exerts depends on the friction, a little
            friction = (
                kind.coulomb
                + abs(world + kind.load_motor * motor)
                + still * abs(world_still + kind.still_motor * motor)
            )
            motor = load + way * friction
        return friction
