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

from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.feetech.torque_switch import ServoParts, TorqueSwitch

_JAW = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Pull:
    """A soft pull.

    Attributes:
        toward: Angles of the five arm joints to pull towards [rad].
        share: Share of full drive that each of them uses at most.
        until: When it ends by itself [s].
    """

    toward: tuple[float, ...]
    share: float
    until: float


class HandPull:
    """Pulls the arm joints while a pull is requested. Used by the I/O thread only.

    Args:
        parts: The servos and their state.
        switch: Switches their torque.
    """

    def __init__(self, parts: ServoParts, switch: TorqueSwitch) -> None:
        self._chain, self._compensation, self._at = parts.chain, parts.compensation, parts.at
        self._out_of_range, self._goals = parts.out_of_range, parts.goals
        self._switch, self._clock = switch, parts.clock
        self._pull: Pull | None = None

    @property
    def is_on(self) -> bool:
        """Whether the joints are pulled."""
        return self._pull is not None

    def ask(self, bus: Bus, pull: Pull) -> None:
        """Start the pull, or change it, from the next ``step`` on.

        Raises:
            BusError: A servo of the arm is silent, does not obey, or two readings of it disagree.
        """
        if self._pull is None:
            self._begin(bus, pull)
        self._pull = pull

    def step(self, bus: Bus) -> None:
        """Send the goals for the joints' present angles, or end the pull if its time is over.

        Raises:
            BusError: A servo did not let go.
        """
        now, pull = self._clock.now(), self._pull
        if pull is None:
            return
        if now > pull.until:
            self.end(bus)
            return
        goals = []
        for q, toward, full_error in zip(
            self._at.q, pull.toward, self._compensation.trim.full_drive_errors, strict=False
        ):
            most = pull.share * full_error
            goals.append(q + min(max(toward - q, -most), most))
        left = {*self._out_of_range.left, _JAW}
        shares = [pull.share] * len(goals)
        self._goals.lead(bus, goals, shares, self._chain.presence.silent, left)

    def end(self, bus: Bus) -> None:
        """Let go of the joints, if they are pulled.

        Raises:
            BusError: A servo did not let go. It keeps its low limit then, and this can be repeated.
        """
        if self._pull is not None:
            self._switch.off(bus)
            self._pull = None
            self._switch.limit_again()

    def _begin(self, bus: Bus, pull: Pull) -> None:
        self._switch.require_arm(bus)
        self._switch.refuse_unsure(bus, range(_JAW))
        here, now = list(self._at.q), self._clock.now()
        self._compensation.begin(here, here, now, self._out_of_range.free)
        limit = round(1000.0 * pull.share)
        ram = self._chain.ram
        self._pull = pull  # what fails from here on ends by itself
        self._chain.put_all(
            reg.TORQUE_LIMIT, {i: min(limit, own[reg.TORQUE_LIMIT]) for i, own in ram.items()}
        )
        for i in self._chain.index.values():
            if i != _JAW:
                self._switch.catch(bus, i)
