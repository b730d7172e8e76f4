"""What a page of the calibration sees of the arm: whether there is news, and the picture of it."""

from __future__ import annotations

import time

from so101_motion.calib.likely import Likely, likely
from so101_motion.calibrator import Situation

from .workshop import Workshop

_PERIOD = 0.07
"""Time between two pictures [s]; chosen: hands are slow, and browsers on phones are as well."""


class Watch:
    """Looks at the arm on the bench.

    Args:
        shop: What all pages share.

    Attributes:
        now: What was seen last; None while there is no bench.
    """

    def __init__(self, shop: Workshop) -> None:
        self._shop = shop
        self.now: Situation | None = None
        self._due = 0.0

    def refresh(self) -> bool:
        """Look; whether there is news."""
        bench, t = self._shop.bench, time.monotonic()
        if bench is None or t < self._due:
            return False
        before, self.now = self.now, bench.calibrator.situation
        if before is not None and _same(before, self.now):
            return False
        self._due = t + _PERIOD
        return True

    def draw(self) -> Likely | None:
        """Put the picture's arm where the joints probably are; that, or None without a bench."""
        now = self.now
        if now is None:
            return None
        seen = likely(now.view.state, now.joints, now.angles)
        self._shop.picture.move(seen.q, seen.q_jaw)
        return seen


def _same(before: Situation, now: Situation) -> bool:
    """Whether nobody would see a difference."""
    a, b = before.view, now.view
    return (
        (a.state, a.error, a.note) == (b.state, b.error, b.note)
        and before.joints == now.joints
        and before.is_connected == now.is_connected
        and before.notes == now.notes
    )
