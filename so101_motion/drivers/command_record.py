"""The record that a driver makes of each command it sends, for tests and recordings.

It holds the command ``q_cmd`` before gravity and lag compensation, to which the caps on speed and
acceleration apply, and the goals in ticks after it, which the wire carries.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class SentCommand:
    """One command as it was sent."""

    t: float  # when, on the driver's clock [s]
    q_cmd: tuple[float, ...]  # commanded angles of the five arm joints [rad]
    q_jaw_cmd: float  # commanded angle of the jaw [rad]
    # the servos' goals [tick], by servo id; a servo that is missing got no goal. Empty for an arm
    # without servos
    goals: Mapping[int, int]
    # whether a hand guides the arm. Its goals then follow the hand, and ``q_cmd`` is the last
    # command before that
    is_guided: bool = False
    # whether the goals were written before torque comes on, as its first goals
    is_seed: bool = False


CommandListener = Callable[[SentCommand], None]
"""Called with each command on the I/O thread; must be brief and must not raise."""
