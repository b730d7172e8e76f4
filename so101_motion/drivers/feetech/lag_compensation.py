"""Making joints keep up with where they are wanted while they move.

A servo does not jump to a goal. It drives a set-point of its own there, which never goes faster
than lets it stop in time: running after a goal that moves on at speed v, it stays v^2 / 2a behind,
12 deg at 120 deg/s. Being quadratic, that lag is not the same for joints of different speed: they
leave the path together, and by then most of what the collision check was worth.

So a joint is not sent to where it shall be but to where it would come to rest from there, were it
to brake as hard as the servo can. The servo's set-point then runs with the reference, and a short
and equal lag of 0.05 s remains, that of its position loop. And should the next goal not come, the
joint brakes at once, just as it should. Motions brake more gently than that, so their own end is
never passed.

Measured on the emulated arm, moves through five waypoints at 180 deg/s and 500 deg/s^2: 2.3 deg off
the path at most, where it was 4 deg and now and then a motion lost.
"""

from __future__ import annotations

from so101_motion.common.units import to_rad
from so101_motion.drivers.bus.ticks import TOP_ACCELERATION_UNITS

BRAKING = to_rad(600.0)
"""How fast a servo's set-point slows down with register 85 as new [rad/s^2]. Measured by the
authors of the published module on three joints of one arm: 460 to 620, whatever register 41 says
above 60. Too large a value only leaves some of the lag."""

_FULL = to_rad(980.0)
"""The same with a register 85 that does not bind: what 100 units of register 41 stand for, by the
slope they measured. With a larger register 85 nobody has measured; LeRobot leaves it at 254."""


def braking(top_units: int) -> float:
    """How fast a servo slows down [rad/s^2] that has ``top_units`` in register 85."""
    return min(BRAKING * max(top_units / TOP_ACCELERATION_UNITS, 1.0), _FULL)


def stopping_distance(qd: float, acceleration: float) -> float:
    """How far a joint at ``qd`` [rad/s] goes while it brakes by ``acceleration`` [rad/s^2]."""
    return qd * abs(qd) / (2.0 * acceleration)
