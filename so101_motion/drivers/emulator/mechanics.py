"""Model the mechanics of one joint: motor, gears, friction, play and stops.

The rotor behind its gears has nearly all the inertia, so each joint is one mass and joints do not
move each other; gravity, contacts and a hand act as torque on the output shaft. A load presses the
output against one side of the play between rotor and output; an unloaded output is dragged along
and lies anywhere in between. The encoder sits on the output.

Dry friction grows with what the gears carry, from the motor's side and from the world's. Lifting a
weight therefore takes more torque than holding it, lowering it takes less, and between the two the
joint stands still: where it rests depends on where it came from.

Integration is semi-implicit at 1 ms, so neither damping nor dry friction can add energy. Dry
friction holds a resting shaft against any smaller torque bit for bit, so that the emulator can stop
computing it.

Source: Rhoban's bam, model M5, for the form of the friction; ``servo_types.py`` for the figures.
"""

from __future__ import annotations

import functools
import math

from so101_motion.drivers.emulator.joint_figures import TICKS_PER_RAD
from so101_motion.drivers.emulator.motion import DT
from so101_motion.drivers.servo_types import ServoType

STOP_STIFFNESS = 150.0
"""Stiffness of a stop [N m/rad]; chosen, a stalled servo presses it in by about a degree."""

_STOP_DAMPING = 2.0  # [N m s/rad], chosen: an arm that falls on its stop does not bounce
_PLAY_FRICTION = 0.01  # [N m], chosen: smaller loads do not move the output through the play
_PLAY_SPEED = 1.5  # [tick/ms], chosen: how fast a load takes the output through the play
_SPEED_STEP = 8.0  # [tick/s], of the table of the Stribeck curve
_SPEEDS = 1000  # in that table; beyond them the curve stays as it is


class Shaft:
    """Output shaft of one servo, in encoder ticks counted from an arbitrary turn.

    Attributes:
        output: Where the output is [tick].
        rotor: Where the motor is, counted at the output [tick]; the play lies between the two.
        velocity: How fast the rotor moves [tick/s] at the output.
        lower: A stop [tick]; ``lower_stiffness`` is its stiffness [N m/rad].
        upper: The other one, likewise.
    """

    __slots__ = (
        "_braked", "_braking_torque", "_coasting", "_drive", "_friction", "_half_play", "_push",
        "_stands_under", "_stribeck", "lower", "lower_stiffness", "output", "rotor", "upper",
        "upper_stiffness", "velocity",
    )  # fmt: skip

    def __init__(
        self, kind: ServoType, *, inertia: float, lower: float, upper: float, at: float
    ) -> None:
        self.put(at)
        self.lower, self.upper = lower, upper
        self.lower_stiffness = self.upper_stiffness = STOP_STIFFNESS
        self._half_play = kind.play * TICKS_PER_RAD / 2.0
        mass = inertia + kind.armature
        self._push = DT * TICKS_PER_RAD / mass  # speed a torque of 1 N m gives in one step
        self._drive = kind.torque_per_volt
        damping = kind.viscous * DT / mass
        self._coasting = 1.0 + damping  # what divides the speed in each step
        self._braked = 1.0 + (damping + kind.torque_per_volt * kind.back_emf * DT / mass)
        self._braking_torque = kind.torque_per_volt * kind.back_emf / TICKS_PER_RAD
        self._friction = (
            kind.coulomb, kind.load_external, kind.load_motor, kind.still_external,
            kind.still_motor,
        )  # fmt: skip
        self._stribeck = _stribeck_table(kind)

    def put(self, position: float) -> None:
        self.output = self.rotor = position
        self.velocity = 0.0
        self._stands_under: tuple[float, bool, float] | None = None

    def step(self, volts: float, *, bridge: bool, load: float) -> None:
        """Advance by 1 ms with a mean voltage ``volts`` across the motor.

        Without a ``bridge`` between the motor's ends there is no back-EMF brake. ``load`` is the
        torque of the world on the output, positive towards higher ticks [N m].
        """
        output, velocity = self.output, self.velocity
        if not self.lower <= output <= self.upper:
            load += self._stop(output)
        if load > _PLAY_FRICTION:
            side, external = 1.0, load
        elif load < -_PLAY_FRICTION:
            side, external = -1.0, load
        else:
            side = external = 0.0
        inputs = (volts, bridge, load)
        if velocity == 0.0 and inputs == self._stands_under:
            return  # it stood still under exactly these before
        motor = self._drive * volts
        # Dry friction grows with what the gears carry, from the motor's side and from the world's.
        carried = motor - self._braking_torque * velocity if bridge else motor
        coulomb, load_external, load_motor, still_external, still_motor = self._friction
        row = int(abs(velocity) / _SPEED_STEP)
        friction = (
            coulomb
            + abs(load_external * external - load_motor * carried)
            + self._stribeck[row if row < _SPEEDS else -1]
            * abs(still_external * external - still_motor * carried)
        )
        slip = self._push * friction
        speed = velocity + (motor + external) * self._push
        if -slip <= speed <= slip:
            stands, velocity = velocity == 0.0, 0.0
        else:
            stands = False
            speed = speed - slip if speed > 0.0 else speed + slip
            velocity = speed / (self._braked if bridge else self._coasting)
            self.rotor += velocity * DT
        self.velocity = velocity
        # The output lies at the loaded side of the play, or is dragged by the play's edges.
        if side:
            output += velocity * DT + _PLAY_SPEED * side
        low, high = self.rotor - self._half_play, self.rotor + self._half_play
        output = low if output < low else high if output > high else output
        self._stands_under = inputs if stands and output == self.output else None
        self.output = output

    def _stop(self, output: float) -> float:
        if output > self.upper:
            depth, stiffness = output - self.upper, self.upper_stiffness
            outwards = max(self.velocity, 0.0)
            return -(stiffness * depth + _STOP_DAMPING * outwards) / TICKS_PER_RAD
        depth, stiffness = self.lower - output, self.lower_stiffness
        outwards = max(-self.velocity, 0.0)
        return (stiffness * depth + _STOP_DAMPING * outwards) / TICKS_PER_RAD


@functools.cache
def _stribeck_table(kind: ServoType) -> tuple[float, ...]:
    """Share of the friction at rest that is left, by speed in steps of ``_SPEED_STEP``."""
    speeds = (k * _SPEED_STEP / TICKS_PER_RAD for k in range(_SPEEDS))
    return tuple(math.exp(-w / kind.stribeck_speed) for w in speeds)
