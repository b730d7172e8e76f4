"""Model the supply voltage, motor currents and temperatures.

The total current of all six servos lowers the supply voltage, and below the voltage their
regulators need they switch off. A motor's loss warms its servo with one time constant.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from so101_motion.drivers.emulator.joint_figures import TICKS_PER_RAD
from so101_motion.drivers.servo_types import ServoType

ROOM_C = 25.0
"""Default ambient temperature [degC]."""

HEATING = 13.8
"""Temperature rise by lost power [K/W]. A published endurance test holds 1.47 N m at 48 degC, which
takes the fitted servo 1.7 W."""

WARMING_TIME = 150.0
"""Time constant of the temperature [s]; chosen so that a gripper that squeezes hard reaches 50 degC
in 30-60 s, as users report."""

BROWN_OUT = 4.0
"""Servos switch off below this voltage [V]; chosen, somewhat above what their regulator needs."""

_IDLE_CURRENT = 0.03  # [A] of the electronics, chosen


class Supply:
    """A power supply of ``volts`` without load.

    ``resistance`` is that of supply and leads together [ohm]; chosen: 0.6 V less at the 5 A of the
    usual supply.
    """

    def __init__(self, volts: float, resistance: float = 0.12) -> None:
        self.volts = volts
        self.resistance = resistance

    def under(self, currents: Iterable[float]) -> float:
        """Voltage on the cable while the servos draw these currents [A]."""
        return max(self.volts - self.resistance * sum(currents), 0.0)


class Motor:
    """Current, signed like the duty [A], and temperature of one servo [degC].

    ``ambient`` is what it cools down to [degC].
    """

    def __init__(self, kind: ServoType) -> None:
        self.kind = kind
        self.current = 0.0
        self.temperature = self.ambient = ROOM_C

    def advance(self, dt: float, *, duty: float, volts: float, velocity: float) -> None:
        """Update after ``dt`` [s] at ``duty``, -1 to 1, ``volts`` and ``velocity`` [tick/s]."""
        kind = self.kind
        emf = kind.back_emf * velocity / TICKS_PER_RAD
        winding = (duty * volts - emf) / kind.resistance if duty else 0.0
        # The shunt sees the winding's current during the on-time only.
        self.current = math.copysign(max(duty * winding, 0.0), duty) if duty else 0.0
        warm = self.ambient + HEATING * kind.resistance * winding * winding
        self.temperature = warm + (self.temperature - warm) * math.exp(-dt / WARMING_TIME)

    @property
    def drawn(self) -> float:
        """Current taken from the cable [A]."""
        return abs(self.current) + _IDLE_CURRENT
