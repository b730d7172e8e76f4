"""Decide when the follower may mirror the leader.

::

    STOPPED --begin--> APPROACHING --close enough--> MIRRORING
                           |  <------ held back ----- |   ^
                           +------ trouble ------+----+   | close enough
                                                 v        |
                       (from anywhere: stop)   WAITING ---+

*Close enough*: every joint is within ``GATE`` of where the leader wants it. The speed of the
follower is not decided here: see ``control/following.py``.

The follower comes to the leader, slowly, only after the user has asked for it (``begin``). After
trouble nothing moves by itself: the follower holds until the leader is brought back to it, or the
user begins again. A pause is less than trouble: the leader did not answer for a moment, as happens
on a busy computer. The follower holds, and goes on as before when the leader answers again near
where it was expected.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.control.following import GATE


class Phase(Enum):
    """The phase of a teleoperation."""

    STOPPED = "stopped"
    APPROACHING = "approaching"
    MIRRORING = "mirroring"
    WAITING = "waiting"


class Gate:
    """Decides in every period whether and how fast the follower may move. For one thread at a time.

    Attributes:
        phase: The phase of the follower.
        reason: Why it waits; empty otherwise.
        gap: The joint that is farthest off and by how much [rad], as of the last decision.
        is_paused: Whether it only waits for an answer of the leader.
    """

    def __init__(self) -> None:
        self.phase = Phase.STOPPED
        self.reason = ""
        self.gap: tuple[str, float] = ("", 0.0)
        self.is_paused = False
        self._before = Phase.STOPPED  # it paused

    def begin(self) -> None:
        """Approach the leader, then mirror it."""
        self.phase, self.reason, self.is_paused = Phase.APPROACHING, "", False

    @property
    def pauses_mirroring(self) -> bool:
        """Whether it mirrored until the pause, so that the leader cannot be far."""
        return self.is_paused and self._before is Phase.MIRRORING

    def stop(self) -> None:
        """Stop mirroring."""
        self.phase, self.reason, self.is_paused = Phase.STOPPED, "", False

    def trouble(self, reason: str) -> None:
        """Hold the follower, because one side is lost."""
        if self.phase is not Phase.STOPPED:
            self.phase, self.reason, self.is_paused = Phase.WAITING, reason, False

    def pause(self, reason: str) -> None:
        """Hold the follower while the leader is silent for a moment."""
        if self.phase in (Phase.APPROACHING, Phase.MIRRORING):
            self._before = self.phase
            self.phase, self.reason, self.is_paused = Phase.WAITING, reason, True

    def hold_back(self) -> None:
        """Note that an obstacle stops the follower; it continues at its slow pace."""
        if self.phase is Phase.MIRRORING and self.gap[1] > GATE:
            self.phase = Phase.APPROACHING

    def is_open(self, off: Array) -> bool:
        """Whether no joint is further off than ``GATE``; ``off`` has shape (5,), [rad]."""
        i = int(np.argmax(np.abs(off)))
        self.gap = (ARM_JOINTS[i], float(abs(off[i])))
        return self.gap[1] <= GATE

    def lets_go(self, off: Array) -> bool:
        """Whether the follower may move to where the leader wants it; otherwise it holds.

        A follower that was only paused goes on as before, because this is known again.

        Args:
            off: How far each joint is from there, shape (5,), [rad].
        """
        if self.is_paused:
            self.phase, self.reason, self.is_paused = self._before, "", False
        if self.is_open(off) and self.phase in (Phase.APPROACHING, Phase.WAITING):
            self.phase, self.reason, self.is_paused = Phase.MIRRORING, "", False
        return self.phase in (Phase.APPROACHING, Phase.MIRRORING)
