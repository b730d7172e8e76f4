"""Settings of manual mode: how stiff the arm is while a hand guides it."""

from __future__ import annotations

from dataclasses import dataclass

from so101_motion.common.units import to_rad


@dataclass(frozen=True, slots=True, kw_only=True)
class Compliance:
    """How stiff the arm is in manual mode.

    Dead band and gain are the published module's. Its P gain went into the servos' EEPROM; ours is
    made by moving the goals. The resistance is chosen: 0.2 N m at 12 V.

    Attributes:
        dead_band: How far a joint is pushed before the place that it holds comes along [rad].
        p_gain: How stiff it is within the dead band, in the servos' unit: a quarter of a thousandth
            of full drive for each tick. Above the servo's own it has no more effect.
        resistance: Share of full drive, beyond what carries its weight, that a joint puts up
            against the hand at most.
    """

    dead_band: float = to_rad(0.5)
    p_gain: float = 8.0
    resistance: float = 0.03
