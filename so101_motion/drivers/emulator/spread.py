"""Make every servo of an emulated arm a little different, as real ones are."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import replace

from so101_motion.drivers.emulator.joint_figures import Joint
from so101_motion.drivers.servo_types import ServoFigures, ServoType

_ZERO_TICKS = 100.0
"""Largest shift of a zero with a spread of 1 [tick]; chosen, a spread of 0.2 gives 1.8 deg."""


def differing_servos(
    joints: Sequence[Joint], kind: ServoType, *, spread: float, seed: int
) -> Iterator[tuple[Joint, ServoType]]:
    """Vary friction, play, torque, dead time and zero of each joint and its servo.

    Args:
        joints: The nominal joints.
        kind: The nominal servo.
        spread: Largest deviation of each figure, as a share of it; 0 leaves all as they are.
        seed: The same seed makes the same arm.
    """
    rng = random.Random(seed)

    def factor() -> float:
        return 1.0 + rng.uniform(-spread, spread)

    for joint in joints:
        friction, dead_time, torque = factor(), factor(), factor()
        zero = joint.zero_ticks + round(_ZERO_TICKS * rng.uniform(-spread, spread))
        own = ServoFigures(
            torque=torque, friction=friction, dead_time=dead_time, play=kind.play * factor()
        )
        yield replace(joint, zero_ticks=zero), own.of(kind)
