"""Where a joint is taken to be while its servo does not answer.

An answer is lost now and then, and a busy computer may hold all of them back for a tenth of a
second, while the setpoints go on. To let the last position stand in would make a joint at 80 deg/s
seem to be 8 deg behind by then, and somebody would stop it for that. So what stands in is the last
position and as much as the joint has been sent on since.
"""

from __future__ import annotations

from collections.abc import Sequence


class Unseen:
    """The last look at each joint.

    Args:
        n: How many joints.
    """

    def __init__(self, n: int) -> None:
        self._seen: list[tuple[float, float | None]] = [(0.0, None)] * n

    def note(self, i: int, q: float, wanted: Sequence[float] | None) -> None:
        """Joint ``i`` is at ``q`` [rad], and the joints are wanted at ``wanted``; None is limp."""
        self._seen[i] = (q, None if wanted is None else wanted[i])

    def stand_in(self, i: int, wanted: Sequence[float] | None) -> float:
        """Where joint ``i`` should be by now [rad], if they are wanted at ``wanted``."""
        q, then = self._seen[i]
        return q if wanted is None or then is None else q + wanted[i] - then
