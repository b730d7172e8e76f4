"""Make every servo of an emulated arm a little different, as real ones are."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import replace

from so101_motion.drivers.emulator.hardware import Joint
from so101_motion.drivers.servo_types import ServoFigures, ServoType

_ZERO_TICKS = 100.0
"""How far a zero is off with a spread of 1 [tick]; chosen, a spread of 0.2 makes it 1.8 deg."""


def differing_servos(
    joints: Sequence[Joint], kind: ServoType, *, spread: float, seed: int
) -> Iterator[tuple[Joint, ServoType]]:
    """Each joint and its servo with friction, play, gain, dead time and zero of its own.

    Args:
        joints: The joints as they are meant to be.
        kind: The servo as it is meant to be.
        spread: Largest deviation of each figure, as a share of it; 0 leaves all as they are.
        seed: The same seed makes the same arm.
    """
    rng = random.Random(seed)

    def factor() -> float:
        return 1.0 + rng.uniform(-spread, spread)

    for joint in joints:
        friction, dead_time, torque = factor(), factor(), factor()
        own = ServoFigures(torque=torque, friction=friction, dead_time=dead_time)
        zero = joint.zero_ticks + round(_ZERO_TICKS * rng.uniform(-spread, spread))
        yield replace(joint, lash=joint.lash * factor(), zero_ticks=zero), own.of(kind)
