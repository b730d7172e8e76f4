"""Track whether the servos of a port have been found, and if not, why.

The I/O thread notes the result of each try; any thread may read it.
"""

from __future__ import annotations

from so101_motion.common.clock import Clock
from so101_motion.common.errors import BusError, NotReady, PortUnavailable

RETRY_PERIOD = 1.0
"""Servos that could not be set up are tried again after this time [s]. Chosen: a try in which no
servo answers takes 0.02 s."""


class Readiness:
    """Whether the servos of one port have been found.

    Args:
        clock: The rig's clock.

    Attributes:
        is_asked: Whether there was a try since a component asked for them.
        is_found: Whether they have been set up since then.
    """

    def __init__(self, clock: Clock) -> None:
        self.is_asked = self.is_found = False
        self._clock, self._begun = clock, clock.now()
        self._why: BusError | None = None
        self._due = self._begun

    @property
    def is_due(self) -> bool:
        """Whether it is time for another try."""
        return self._clock.now() >= self._due

    @property
    def has_port(self) -> bool:
        """Whether the port was there at the last try, though the servos were not."""
        return self._why is not None and not isinstance(self._why, PortUnavailable)

    @property
    def reason(self) -> str | None:
        """Why the servos cannot be used yet; None once they have been set up."""
        if self.is_found:
            return None
        if self._why is None:
            return "the servos have not been looked for yet; try again"
        tried = self._clock.now() - self._begun
        return f"{self._why} (tried for {tried:.0f} s, and tried again every second)"

    def reset(self) -> None:
        """Start again, because other servos are asked for."""
        self.is_asked = self.is_found = False
        self._why = None
        self._begun = self._due = self._clock.now()

    def begin_try(self) -> bool:
        """Note that a try begins; returns whether it is the first."""
        is_first, self.is_asked = not self.is_asked, True
        self._due = self._clock.now() + RETRY_PERIOD
        return is_first

    def found(self) -> None:
        """Note that the servos have been found and set up."""
        self.is_asked = self.is_found = True
        self._why = None

    def end_try(self, error: BusError) -> None:
        """Note that a try failed."""
        if not self.is_found:
            self._why = error

    def require_found(self) -> None:
        """Raise unless the servos have been found.

        Raises:
            NotReady: They have not.
        """
        reason = self.reason
        if reason is not None:
            raise NotReady(reason) from self._why
