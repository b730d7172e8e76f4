"""Settings of manual mode: how stiff the arm is while a hand guides it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_rad

Wall = Callable[[Array, Array], Array]
"""How far a hand may lead the joints without resistance. From where they are now, shape (5,), and
where it may lead them, shape (k, 5), to configurations between the two, (k, 5); [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compliance:
    """How stiff the arm is in manual mode.

    Dead band and gain are the published module's. Its P gain went into the servos' EEPROM; ours is
    made by moving the goals. The resistance is chosen: 0.2 N m at 12 V.
    """

    # how far a hand pushes a joint before the angle it holds follows [rad]
    dead_band: float = to_rad(0.5)
    # stiffness within the dead band, in the servos' unit: a quarter of a thousandth of full drive
    # per tick. A gain above the servo's own has no further effect
    p_gain: float = 8.0
    # largest drive with which a joint resists the hand, beyond what carries its weight, as a share
    # of full drive. Gears and motor brake one in motion besides
    resistance: float = 0.03
    # largest drive with which a joint holds a hand off what the arm must not touch, as a share of
    # full drive; 0 for no such wall. Chosen: 0.9 N m at 12 V, more than what leads most joints at
    # 30 deg/s. A strong hand gets past it; a joint that holds has three times as much
    wall: float = 0.3
