"""Compute the follower's target in every period, from predictor, mirror and gate."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

import numpy as np

from so101_motion.common.clock import Clock
from so101_motion.common.geometry import Array, freeze
from so101_motion.common.state import ARM_JOINTS
from so101_motion.common.units import to_deg, to_rad
from so101_motion.control.following import APPROACH, GATE
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.teleop.predictor import LONGEST, Predictor

HORIZON = 0.006
"""How far ahead the leader is predicted [s]. The driver compensates for the lag of the follower's
servos itself, because it knows the target's velocity and acceleration."""

JAW_HORIZON = 0.066  # the same for the jaw, whose lag is not compensated [s]; by trial

LOST_AFTER = 0.05
"""The follower holds when a joint of the leader has not answered for so long [s]. With the period
after, it brakes within 0.06 s. Single lost replies are asked for again long before."""

BEYOND = to_rad(0.5)  # the user is told when the leader is farther beyond the range [rad]; chosen

FULL_JERK = 500.0
"""Jerk cap while mirroring [rad/s^3]: full acceleration within two periods. Chosen; a lower one
makes the follower swing around a hand that trembles."""


MIRRORED = ("shoulder_pan", "wrist_roll")  # turn the other way in an upright mirror


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mirror:
    """Angle of the follower = factor x angle of the leader + offset, joint by joint.

    The jaw needs none: it opens by the same share of its own travel.
    """

    factors: Array = field(default_factory=lambda: np.ones(5))  # shape (5,)
    offsets: Array = field(default_factory=lambda: np.zeros(5))  # shape (5,), [rad]

    def __post_init__(self) -> None:
        freeze(self, factors=(5,), offsets=(5,))
        if not (np.all(np.isfinite(self.factors)) and np.all(np.isfinite(self.offsets))):
            raise ValueError(f"must be finite, got {self.factors}, {self.offsets}")

    def facing(self) -> Mirror:
        """This mapping for arms that face each other, as in a mirror."""
        signs = np.where(np.isin(ARM_JOINTS, MIRRORED), -1.0, 1.0)
        return Mirror(factors=signs * self.factors, offsets=self.offsets)

    def of(self, q_leader: Array) -> Array:
        """The follower's angles for the leader's, shapes (5,), [rad]."""
        return np.asarray(self.factors * q_leader + self.offsets)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """The follower's speeds."""

    # caps of the arm while it mirrors
    full: MotionLimits = field(
        default_factory=lambda: MotionLimits.uniform(
            velocity=to_rad(180.0), acceleration=to_rad(450.0), jerk=FULL_JERK
        )
    )
    approach: MotionLimits = APPROACH  # caps of the arm while it comes to the leader


class Phase(Enum):
    """The phase of a teleoperation."""

    STOPPED = "stopped"
    APPROACHING = "approaching"
    MIRRORING = "mirroring"
    WAITING = "waiting"


class Gate:
    """Decides in every period whether and how fast the follower may move. For one thread at a time.

    ::

        STOPPED --begin--> APPROACHING --close enough--> MIRRORING
                               |  <------ held back ----- |   ^
                               +------ trouble ------+----+   | close enough
                                                     v        |
                           (from anywhere: stop)   WAITING ---+

    *Close enough*: every joint is within ``GATE`` of where the leader wants it. After trouble
    nothing moves by itself: the follower holds until the leader is brought back to it, or the user
    begins again. After a pause, in which the leader did not answer for a moment, it goes on as
    before when the leader answers again near where it was expected.
    """

    def __init__(self) -> None:
        self.phase = Phase.STOPPED
        self.reason = ""  # why it waits
        self.gap: tuple[str, float] = ("", 0.0)  # the joint farthest off, and how far [rad]
        self.is_paused = False  # whether it only waits for an answer of the leader
        self._before = Phase.STOPPED  # it paused

    def begin(self) -> None:
        self.phase, self.reason, self.is_paused = Phase.APPROACHING, "", False

    @property
    def pauses_mirroring(self) -> bool:
        """Whether it mirrored until the pause, so that the leader cannot be far."""
        return self.is_paused and self._before is Phase.MIRRORING

    def stop(self) -> None:
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
        """Whether the follower may move to the leader, ``off`` from it, shape (5,), [rad]."""
        if self.is_paused:
            self.phase, self.reason, self.is_paused = self._before, "", False
        if self.is_open(off) and self.phase in (Phase.APPROACHING, Phase.WAITING):
            self.phase, self.reason, self.is_paused = Phase.MIRRORING, "", False
        return self.phase in (Phase.APPROACHING, Phase.MIRRORING)


class Target(NamedTuple):
    """A target of the follower."""

    q: Array  # joint angles, shape (5,), [rad]
    qd: Array  # their velocities, shape (5,), [rad/s]
    qdd: Array  # their accelerations, shape (5,), [rad/s^2]


class Pilot:
    """Computes the follower's targets, by the clock of both sides. Several threads may use it.

    It predicts ``horizon`` [s] ahead, and holds when the leader has not answered for ``lost_after``
    [s]. ``beyond`` names the joints that the leader wants beyond the follower's range.
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
        """Set the follower's range, shapes (5,), [rad]."""
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
        with self._lock:
            self.gate.stop()

    def trouble(self, reason: str) -> None:
        with self._lock:
            self.gate.trouble(reason)

    def hold_back(self) -> None:
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

    def arm(self, q: Array) -> Target | None:
        """The arm's next target; None to hold, ``gate.pauses_mirroring`` says whether briefly.

        Args:
            q: Its present setpoint, shape (5,), [rad].
        """
        with self._lock:
            target = self._target()
            if target is None:
                return None
            if self.gate.lets_go(target.q - q):
                return target
            return None

    def jaw(self) -> tuple[float, float] | None:
        """The wanted aperture, 0 to 1, and its rate [1/s]; None to hold."""
        with self._lock:
            seen = self._seen(max(self._horizon, JAW_HORIZON))
            if seen is None or self.gate.phase not in (Phase.APPROACHING, Phase.MIRRORING):
                return None
            aperture = float(np.clip(seen[0][5], 0.0, 1.0))
            return aperture, float(seen[1][5]) if 0.0 < aperture < 1.0 else 0.0

    # How

    def _target(self) -> Target | None:
        """The target within the follower's range; None to hold."""
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
                f"the leader's angles jumped; bring it to within {to_deg(GATE):g} deg of the"
                " follower, or start again"
            )
        return self._predictor.at(now + horizon)
