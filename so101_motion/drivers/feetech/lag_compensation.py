"""Compute where to send a servo so that its joint keeps up with where it is wanted.

A servo does not jump to a goal. It drives a set-point of its own there, which never goes faster
than lets it stop in time: running after a goal that moves on at speed v, it stays v^2 / 2a behind,
12 deg at 120 deg/s. Being quadratic, that lag is not the same for joints of different speed: they
leave the path together, and by then most of what the collision check was worth.

So a joint is not sent to where it shall be but to where it would come to rest from there, were it
to brake as hard as the servo can. The servo's set-point then runs with the reference. Two lags in
proportion to the speed remain, and are made up for as well: it takes a while until a goal is felt
(``DELAY`` and the servo's own), and the motor works against the voltage it induces itself
(``Trim.lag``). Should the next goal not come, the joint comes to rest that much later.

Those two are made up for only in motions that know their own acceleration: planned ones, and
followings of a target that says how it accelerates. One that does not say changes it at every
moment, and joints driven ahead of it would overshoot at every turn: 1,150 deg/s^2 where 600 were
commanded. For teleoperation ``predictor.py`` says it.
"""

from __future__ import annotations

from so101_motion.common.units import to_rad
from so101_motion.drivers.bus.ticks import RAD_PER_TICK, TOP_ACCELERATION_UNITS

BRAKING = tuple(to_rad(each) for each in (624.0, 464.0, 627.0, 572.0, 572.0, 572.0))
"""How fast each servo's set-point slows down with register 85 as new [rad/s^2], whatever register
41 says above 60. Measured by the authors of the published module on the first three joints of one
arm; the others get their mean."""

DELAY = 0.0065
"""From a setpoint to the servo's set-point that follows it, on average, and beyond its own delay
[s]: half a period, and what the emulated servo loses in whole milliseconds. Chosen by trial."""

CUT_OFF = 0.5
"""How far below its way a travelling set-point is on average [tick]: firmware counts finer than in
ticks, divides, and drops the rest. Read in a reconstruction of the factory firmware, whose division
the emulator copies; at rest nothing is dropped, because goals are whole ticks."""

CUT_OFF_SPEED = to_rad(10.0)
"""A slower set-point is at its goal for a part of every period, and loses less [rad/s]. Chosen: at
this speed it is a tick behind."""

_FULL = to_rad(980.0)
"""The same with a register 85 that does not bind: what 100 units of register 41 stand for, by the
slope they measured. With a larger register 85 nobody has measured; LeRobot leaves it at 254."""


def braking(i: int, top_units: int) -> float:
    """How fast joint ``i``'s servo slows down [rad/s^2] with ``top_units`` in register 85."""
    return min(BRAKING[i] * max(top_units / TOP_ACCELERATION_UNITS, 1.0), _FULL)


def cut_off(qd: float) -> float:
    """What the firmware drops of a set-point that travels at ``qd`` [rad/s], on average [rad]."""
    return CUT_OFF * RAD_PER_TICK * min(abs(qd) / CUT_OFF_SPEED, 1.0)


def stopping_distance(qd: float, acceleration: float) -> float:
    """How far a joint at ``qd`` [rad/s] goes while it brakes by ``acceleration`` [rad/s^2]."""
    return qd * abs(qd) / (2.0 * acceleration)
