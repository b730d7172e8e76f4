"""Decide when the follower may mirror the leader, and how fast.

::

    STOPPED --begin--> APPROACHING --close enough--> MIRRORING
                           |  <------ held back ----- |   ^
                           +------ trouble ------+----+   | close enough
                                                 v        |
                       (from anywhere: stop)   WAITING ---+

*Close enough*: no joint further than ``GATE`` from where the leader wants it. Then the follower
keeps the pace of the approach at first and takes half a second to come up to its full speed, so
even the last degrees are no jump.

Only a person who says so (``begin``) makes the follower come to the leader, at its own slow pace.
After trouble nothing moves by itself: the follower holds until the leader is led back to it, or
somebody begins anew. A pause is less than trouble: nothing was heard for a moment, as happens on a
busy computer. The follower holds, and when the leader is heard again, where it was to be expected,
the follower comes to it as after a beginning.

"""

from __future__ import annotations

from enum import Enum

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_rad
from so101_motion.planning.timing.limits import MotionLimits

GATE = to_rad(5.0)
"""How far a joint may be off for mirroring to begin [rad]; the published module's later gate."""

EASE = 0.5
"""How long the pace takes from that of the approach to full speed [s]; chosen."""


class Phase(Enum):
    """The phase of a teleoperation."""

    STOPPED = "stopped"
    APPROACHING = "approaching"
    MIRRORING = "mirroring"
    WAITING = "waiting"


class Gate:
    """Decides in every period whether and how fast the follower may move. For one thread at a time.

    Args:
        full: Caps while mirroring.
        approach: Caps of the approach.

    Attributes:
        phase: What the follower does.
        reason: Why it waits; empty otherwise.
        gap: The joint that is furthest off and by how much [rad], as of the last decision.
        is_paused: Whether it waits for no more than an answer.
    """

    def __init__(self, full: MotionLimits, approach: MotionLimits) -> None:
        self._full, self._approach = full, approach
        self.phase = Phase.STOPPED
        self.reason = ""
        self.gap: tuple[str, float] = ("", 0.0)
        self.is_paused = False
        self._since = 0.0

    def begin(self) -> None:
        """Approach the leader, then mirror it."""
        self.phase, self.reason, self.is_paused = Phase.APPROACHING, "", False

    def stop(self) -> None:
        """Stop mirroring."""
        self.phase, self.reason, self.is_paused = Phase.STOPPED, "", False

    def trouble(self, reason: str) -> None:
        """Hold the follower, because one side is lost."""
        if self.phase is not Phase.STOPPED:
            self.phase, self.reason, self.is_paused = Phase.WAITING, reason, False

    def pause(self, reason: str) -> None:
        """Hold the follower while the leader is silent, until ``resume`` or the gate opens."""
        if self.phase in (Phase.APPROACHING, Phase.MIRRORING):
            self.phase, self.reason, self.is_paused = Phase.WAITING, reason, True

    def resume(self) -> None:
        """Continue, because the leader answers again and the follower is at rest."""
        if self.is_paused:
            self.begin()

    def hold_back(self) -> None:
        """Note that an obstacle stops the follower; it continues at its slow pace."""
        if self.phase is Phase.MIRRORING and self.gap[1] > GATE:
            self.phase = Phase.APPROACHING

    def is_open(self, off: Array) -> bool:
        """Whether no joint is further off than ``GATE``; ``off`` has shape (5,), [rad]."""
        i = int(np.argmax(np.abs(off)))
        self.gap = (ARM_JOINTS[i], float(abs(off[i])))
        return self.gap[1] <= GATE

    def decide(self, t: float, off: Array) -> MotionLimits | None:
        """How fast the follower may go now; None to hold.

        Args:
            t: Now [s].
            off: How far each joint is from where the leader wants it, shape (5,), [rad].
        """
        is_open = self.is_open(off)
        if is_open and self.phase in (Phase.APPROACHING, Phase.WAITING):
            self.phase, self.reason, self._since = Phase.MIRRORING, "", t
            self.is_paused = False
        if self.phase is Phase.APPROACHING:
            return self._approach
        return self._eased(t - self._since) if self.phase is Phase.MIRRORING else None

    def share(self, t: float) -> float:
        """The share of the full pace that is reached at ``t`` [s], 0 to 1."""
        return min(max((t - self._since) / EASE, 0.0), 1.0)

    def _eased(self, elapsed: float) -> MotionLimits:
        if elapsed >= EASE:
            return self._full
        u = max(elapsed, 0.0) / EASE
        slow, full = self._approach, self._full
        return MotionLimits(
            velocity=slow.velocity + u * (full.velocity - slow.velocity),
            acceleration=slow.acceleration + u * (full.acceleration - slow.acceleration),
            jerk=slow.jerk + u * (full.jerk - slow.jerk),
        )
