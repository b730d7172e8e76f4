"""The ghost's place on the plan's timeline, paused or playing."""

from __future__ import annotations

RATES = (0.25, 0.5, 1.0, 2.0)
"""How fast a plan can be played, against the time it takes the arm."""


class Playback:
    """A place on a timeline that is dragged or plays."""

    def __init__(self) -> None:
        self.t = 0.0
        self._duration = 0.0
        self._rate: float | None = None
        self._seen: float | None = None

    @property
    def rate(self) -> float | None:
        return self._rate

    def load(self, duration: float) -> None:
        """Load a plan of ``duration`` [s]; pauses at its end."""
        self.t = self._duration = duration
        self._rate = None

    def seek(self, t: float) -> None:
        self.t = min(max(t, 0.0), self._duration)
        self._rate = None

    def play(self, rate: float) -> None:
        """Play at ``rate``, from the beginning if it is at the end; the same rate pauses it."""
        if self._rate == rate:
            self._rate = None
            return
        if self.t >= self._duration:
            self.t = 0.0
        self._rate, self._seen = rate, None

    def advance(self, now: float) -> bool:
        """Advance to the time ``now`` [s] while it plays; return whether it moved."""
        if self._rate is None:
            return False
        before, self._seen = self._seen, now
        if before is None:
            return True
        self.t = min(self.t + self._rate * (now - before), self._duration)
        if self.t >= self._duration:
            self._rate = None
        return True
