"""Compute how far ahead of a joint its servo's goal must be, so that the joint does not lag.

A servo does not jump to a goal. It moves an internal set-point there, which is never too fast to
stop in time: behind a goal that moves at speed v it stays v^2 / 2a, 12 deg at 120 deg/s. That lag
is quadratic, so joints of different speeds lag differently, and together they leave the path that
was checked for collisions.

So the goal is not the commanded angle but the angle at which the joint would come to rest from
there, braking as hard as the servo can. The servo's set-point then moves with the command. Two lags
in proportion to the speed remain and are compensated too: a goal acts late (``DELAY`` and the
servo's own delay), and the motor works against the voltage it induces (``lead`` in
``servo_goals.c``). If the next goal does not come, the joint comes to rest that much later.

These two are compensated only in motions with a known acceleration: planned ones, and those that
follow a target with a given acceleration. The acceleration of other targets changes at any moment,
and joints driven ahead would overshoot at every turn: 1,150 deg/s^2 where 600 were commanded. In
teleoperation ``predictor.py`` estimates it.
"""

from __future__ import annotations

from so101_motion.common.units import to_rad
from so101_motion.drivers.bus.ticks import TOP_ACCELERATION_UNITS

BRAKING = tuple(to_rad(each) for each in (624.0, 464.0, 627.0, 572.0, 572.0, 572.0))
"""How fast each servo's set-point slows down with register 85 as new [rad/s^2], whatever register
41 says above 60. Measured by the authors of the published module on the first three joints of one
arm; the others get their mean."""

DELAY = 0.0065
"""Average delay from a setpoint to the servo's set-point, beyond the servo's own [s]: half a
period, and the rounding of the emulated servo to milliseconds. Chosen by trial."""

_FULL = to_rad(980.0)
"""Largest braking with a larger register 85 [rad/s^2]: 100 units of register 41 by the measured
slope. It was never measured with a larger register 85; LeRobot writes 254."""


def braking(i: int, top_units: int) -> float:
    """How fast joint ``i``'s servo slows down [rad/s^2] with ``top_units`` in register 85."""
    return min(BRAKING[i] * max(top_units / TOP_ACCELERATION_UNITS, 1.0), _FULL)
