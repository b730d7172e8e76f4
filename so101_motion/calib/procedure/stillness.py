"""Measure how long an arm has been held still, to take its homing pose hands-free.

The user needs both hands for the arm. So a key or button only announces the pose, and it is taken
once nothing has moved for a moment.
"""

from __future__ import annotations

from collections.abc import Mapping

TREMBLE = 23
"""How far a joint may move meanwhile [tick], 2 deg; a hand trembles. Chosen."""


class Stillness:
    """Measures how long joints have been held still; ``feed`` it their positions."""

    def __init__(self) -> None:
        self._since = 0.0
        self._anchor: dict[str, int] = {}

    def feed(self, t: float, ticks: Mapping[str, int | None]) -> float:
        """How long all joints have stayed within ``TREMBLE`` [s]; 0 if one does not answer.

        Args:
            t: Now [s].
            ticks: Where they are [tick].
        """
        known = {joint: place for joint, place in ticks.items() if place is not None}
        is_still = known.keys() == ticks.keys() == self._anchor.keys() and all(
            abs(place - self._anchor[joint]) <= TREMBLE for joint, place in known.items()
        )
        if not is_still:
            self._since, self._anchor = t, known
        return t - self._since
