"""Estimate joint velocities from recent joint positions.

The servo's own velocity comes in steps of 4.4 deg/s, because it counts ticks over 20 ms. A straight
line through the positions of the last tenth of a second is finer and needs no bytes: with 100
measurements a second a scatter of one tick becomes 0.4 deg/s. It is half that window late, which
does not matter for its use: deciding whether a joint is at rest.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from operator import mul

WINDOW = 0.1
"""How far back the line reaches [s]; chosen, see above."""

_SPACING = WINDOW / 16
"""Measurements closer together than this [s] are left out: at 100 a second none, at 200 every other
one. They would cost time and add little."""

_FEWEST = 3  # with two points the scatter would be the slope; slow polling keeps this many


class VelocityEstimate:
    """Fits the slopes of several signals; in plain Python, which is faster than numpy for six.

    Args:
        n: How many.
    """

    def __init__(self, n: int) -> None:
        self._t: deque[float] = deque()
        self._signals: tuple[deque[float], ...] = tuple(deque() for _ in range(n))

    def add(self, t: float, values: Sequence[float]) -> None:
        """Add ``n`` values measured at ``t`` [s]."""
        if self._t and t - self._t[-1] < _SPACING:
            return
        self._t.append(t)
        for signal, value in zip(self._signals, values, strict=True):
            signal.append(value)
        while len(self._t) > _FEWEST and self._t[0] < t - WINDOW - 1e-9:
            self._t.popleft()
            for signal in self._signals:
                signal.popleft()

    def clear(self) -> None:
        """Forget everything, after a gap."""
        self._t.clear()
        for signal in self._signals:
            signal.clear()

    def value(self) -> list[float]:
        """Change per second of each signal; zero until two moments are known."""
        middle = sum(self._t) / max(len(self._t), 1)
        t = [moment - middle for moment in self._t]
        spread = sum(map(mul, t, t))
        if spread <= 0.0:
            return [0.0] * len(self._signals)
        return [sum(map(mul, t, signal)) / spread for signal in self._signals]
