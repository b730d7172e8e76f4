"""Decide in every period where the follower goes.

The pilot puts the parts together: the predictor says where the leader will be, the mirror which
angles of the follower that is, the gate whether it may go there. It is asked before each setpoint
of a follower of this process, or by what sends goals to an arm elsewhere.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from so101_motion.common.clock import Clock
from so101_motion.common.geometry import Array
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_rad
from so101_motion.control.approach import APPROACH, GATE
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.teleop.gate import Gate, Phase
from so101_motion.tasks.teleop.mirror import Mirror
from so101_motion.tasks.teleop.predictor import LONGEST, Predictor

HORIZON = 0.006
"""How far ahead of now the leader is aimed at [s]. What the follower's servos are behind, their
driver makes up for, who is told how the target moves on."""

JAW_HORIZON = 0.066
"""The same for the jaw, whose lag nobody makes up for [s]; by trial."""

LOST_AFTER = 0.05
"""After how long without an answer from all joints of the leader the follower holds [s]. With the
period after, it brakes within 0.06 s. Single lost replies are asked for again long before."""

BEYOND = to_rad(0.5)
"""How far beyond the follower's range the leader must be for it to be told [rad]; chosen."""

FULL_JERK = 500.0
"""Jerk cap while mirroring [rad/s^3]: full acceleration within two periods. Chosen; a lower one
makes the follower swing around a hand that trembles."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """The follower's speeds.

    Attributes:
        full: Caps of the arm while it mirrors.
        approach: Caps of the arm while it comes to the leader.
    """

    full: MotionLimits = field(
        default_factory=lambda: MotionLimits.uniform(
            velocity=to_rad(180.0), acceleration=to_rad(450.0), jerk=FULL_JERK
        )
    )
    approach: MotionLimits = APPROACH


class Target(NamedTuple):
    """Where the follower is wanted.

    Attributes:
        q: Joint angles, shape (5,), [rad].
        qd: How fast they move, shape (5,), [rad/s].
        qdd: How that changes, shape (5,), [rad/s^2].
    """

    q: Array
    qd: Array
    qdd: Array


class Pilot:
    """Computes the follower's targets. Several threads may use it.

    Args:
        clock: What time it is, for both sides.
        predictor: Where the leader will be.
        mirror: Which angles of the follower that is.
        pace: How fast to go.
        horizon: How far ahead to aim [s].
        lost_after: After how long without an answer of the leader to hold [s].

    Attributes:
        gate: Whether the follower may go there.
        pace: As given.
        beyond: The joints that the leader wants beyond the follower's range, by name.
    """

    def __init__(
        self,
        clock: Clock,
        predictor: Predictor,
        mirror: Mirror,
        pace: Pace,
        *,
        horizon: float = HORIZON,
        lost_after: float = LOST_AFTER,
    ) -> None:
        self.gate, self.pace = Gate(), pace
        self.beyond: tuple[str, ...] = ()
        self._clock, self._predictor, self._mirror = clock, predictor, mirror
        self._horizon, self._lost_after = horizon, lost_after
        self._lower, self._upper = np.full(5, -np.inf), np.full(5, np.inf)
        self._jumps = 0
        self._lock = threading.Lock()

    def fit(self, lower: Array, upper: Array) -> None:
        """Learn the follower's range, shapes (5,), [rad]."""
        with self._lock:
            self._lower, self._upper = lower, upper

    # Deciding

    def begin(self) -> None:
        """Approach the leader, then mirror it."""
        with self._lock:
            track = self._predictor.track
            self._jumps = track.jumps if track is not None else 0
            self.gate.begin()

    def stop(self) -> None:
        """Hold for good."""
        with self._lock:
            self.gate.stop()

    def trouble(self, reason: str) -> None:
        """Hold until the gate opens."""
        with self._lock:
            self.gate.trouble(reason)

    def hold_back(self) -> None:
        """Note that an obstacle stops the follower; it continues at its slow pace."""
        with self._lock:
            self.gate.hold_back()

    def may_begin(self, q: Array) -> bool:
        """Whether a follower at ``q``, shape (5,), [rad], may start to move."""
        with self._lock:
            target = self._target()
            if target is None:
                return False
            return self.gate.phase is Phase.APPROACHING or self.gate.is_open(target.q - q)

    # Aiming

    def arm(self, q: Array, *, rests: bool) -> Target | None:
        """Where the arm goes; None to hold.

        Args:
            q: Where it is wanted now, shape (5,), [rad].
            rests: Whether it is at rest.
        """
        with self._lock:
            target = self._target()
            if target is None:
                return None
            if rests:
                self.gate.resume()
            if self.gate.lets_go(target.q - q):
                return target
            return None

    def jaw(self) -> tuple[float, float] | None:
        """The aperture that is wanted, 0 to 1, and how fast it changes [1/s]; None to hold."""
        with self._lock:
            seen = self._seen(max(self._horizon, JAW_HORIZON))
            if seen is None or self.gate.phase not in (Phase.APPROACHING, Phase.MIRRORING):
                return None
            aperture = float(np.clip(seen[0][5], 0.0, 1.0))
            return aperture, float(seen[1][5]) if 0.0 < aperture < 1.0 else 0.0

    # How

    def _target(self) -> Target | None:
        """Where the follower is wanted, within its range; None to hold."""
        seen = self._seen(self._horizon)
        if seen is None:
            return None
        x, xd, xdd = (each[:5] for each in seen)
        wanted, factors = self._mirror.of(x), self._mirror.factors
        q = np.clip(wanted, self._lower, self._upper)
        over = np.abs(wanted - q)
        self.beyond = tuple(np.array(ARM_JOINTS)[over > BEYOND].tolist()) if over.any() else ()
        qd, qdd = (np.where(over > 0.0, 0.0, factors * each) for each in (xd, xdd))
        return Target(q, qd, qdd)

    def _seen(self, horizon: float) -> tuple[Array, Array, Array] | None:
        now, track = self._clock.now(), self._predictor.track
        if track is None:
            return None
        silence = now - track.t_heard
        if silence > self._lost_after:
            is_brief = silence <= max(LONGEST, 2.0 * self._lost_after)
            (self.gate.pause if is_brief else self.gate.trouble)("the leader does not answer")
            return None
        if track.jumps != self._jumps:
            self._jumps = track.jumps
            self.gate.trouble(
                f"the leader was suddenly elsewhere; bring it to within {to_deg(GATE):g} deg of"
                " the follower, or start again"
            )
        return self._predictor.at(now + horizon)
