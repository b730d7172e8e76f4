"""Position of the ghost on the plan's timeline, standing or playing."""

from __future__ import annotations

RATES = (0.25, 0.5, 1.0, 2.0)
"""How fast a plan can be played, against the time it takes the arm."""


class Playback:
    """A place on a timeline that can be dragged, or runs by itself."""

    def __init__(self) -> None:
        self.t = 0.0
        self._duration = 0.0
        self._rate: float | None = None
        self._seen: float | None = None

    @property
    def rate(self) -> float | None:
        """How fast it runs; None while it stands."""
        return self._rate

    def load(self, duration: float) -> None:
        """Take up another plan of ``duration`` [s]; stands at its end, where the goal is."""
        self.t = self._duration = duration
        self._rate = None

    def seek(self, t: float) -> None:
        """Stand at ``t`` [s]."""
        self.t = min(max(t, 0.0), self._duration)
        self._rate = None

    def play(self, rate: float) -> None:
        """Run at ``rate``, from the beginning if it is at the end; the same rate again stops it."""
        if self._rate == rate:
            self._rate = None
            return
        if self.t >= self._duration:
            self.t = 0.0
        self._rate, self._seen = rate, None

    def advance(self, now: float) -> bool:
        """Run on.

        Args:
            now: The time [s].

        Returns:
            Whether it moved.
        """
        if self._rate is None:
            return False
        before, self._seen = self._seen, now
        if before is None:
            return True
        self.t = min(self.t + self._rate * (now - before), self._duration)
        if self.t >= self._duration:
            self._rate = None
        return True
