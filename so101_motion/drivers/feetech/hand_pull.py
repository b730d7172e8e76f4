"""Pull limp joints softly, so that the hand that leads them feels it.

The arm counts as limp meanwhile: nothing carries it, and it stays where the hand takes it. Its
servos are switched on where they are, with the torque limit lowered first, and pull towards given
angles with at most the requested share of their drive. The goal is never farther from the joint
than that share needs, and the limit in RAM bounds it once more. The jaw stays limp.

A pull ends by itself unless it is requested again and again. It also ends when a servo or the port
comes back after a loss, and when the joints are held, released or given up.
"""

from __future__ import annotations

from dataclasses import dataclass

from so101_motion.common.clock import Clock
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.feetech.chain import Chain
from so101_motion.drivers.feetech.goal_compensation import GoalCompensation

_JAW = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Pull:
    """A soft pull."""

    toward: tuple[float, ...]  # angles of the five arm joints to pull towards [rad]
    share: float  # share of full drive that each of them uses at most
    until: float  # when it ends by itself [s]


class HandPull:
    """Pulls the arm joints while a ``pull`` is requested. Used by the I/O thread only."""

    def __init__(self, chain: Chain, compensation: GoalCompensation, clock: Clock) -> None:
        self._chain, self._compensation, self._clock = chain, compensation, clock
        self.pull: Pull | None = None

    @property
    def is_on(self) -> bool:
        return self.pull is not None

    def ask(self, pull: Pull) -> None:
        """Start the pull, or change it, from the next ``step`` on."""
        if self.pull is None:
            self._begin(pull)
        self.pull = pull

    def step(self) -> None:
        """Send the goals for the joints' present angles, or end the pull if its time is over."""
        now, pull = self._clock.now(), self.pull
        if pull is None:
            return
        if now > pull.until:
            self.end()
            return
        goals = []
        for q, toward, full_error in zip(
            self._chain.at.q, pull.toward, self._compensation.trim.full_drive_errors, strict=False
        ):
            most = pull.share * full_error
            goals.append(q + min(max(toward - q, -most), most))
        self._chain.lead(goals, [pull.share] * len(goals), but=(_JAW,))

    def end(self) -> None:
        """Let go of the joints, if they are pulled.

        A servo that does not let go (``BusError``) keeps its low limit; this can be repeated.
        """
        if self.pull is not None:
            self._chain.switch_off()
            self.pull = None
            self._chain.limit_again()

    def _begin(self, pull: Pull) -> None:
        chain = self._chain
        chain.require_arm()
        chain.refuse_unsure(range(_JAW))
        here, now = list(chain.at.q), self._clock.now()
        self._compensation.begin(here, here, now, chain.out_of_range.free)
        limit = round(1000.0 * pull.share)
        self.pull = pull  # what fails from here on ends by itself
        limits = {i: min(limit, own[reg.TORQUE_LIMIT]) for i, own in chain.ram.items()}
        chain.put_all(reg.TORQUE_LIMIT, limits)
        for i in chain.index.values():
            if i != _JAW:
                chain.catch(i)
