"""Report every command that a driver sends, for tests and recordings.

A driver calls ``on_command`` on its own thread each time goals go out. What it hands over is the
command ``q_cmd`` as it was sent, before droop and lag are made up for, and the goals in ticks as
they were sent, after that. Caps bind the first; the second is what the wire carries.

    sent = []
    rig.servos.on_command = sent.append
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class SentCommand:
    """One command as it was sent.

    Attributes:
        t: When, on the driver's clock [s].
        q_cmd: Where the five arm joints were sent [rad].
        q_jaw_cmd: Where the jaw was sent [rad].
        goals: What the servos were sent [tick], by servo id; a servo that is missing got no goal.
            Empty for an arm without servos.
        is_guided: Whether a hand guides the arm. Its goals then follow the hand, and ``q_cmd`` is
            only what was commanded before.
        is_seed: Whether the goals were written to be there when torque comes on.
    """

    t: float
    q_cmd: tuple[float, ...]
    q_jaw_cmd: float
    goals: Mapping[int, int]
    is_guided: bool = False
    is_seed: bool = False


CommandListener = Callable[[SentCommand], None]
"""Called with each command on the I/O thread; must be brief and must not raise."""
