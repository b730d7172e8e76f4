"""Give up a search after a number of looks, not by the clock: a busy computer changes nothing."""

from __future__ import annotations

from so101_motion.common.errors import NoPath

NEVER = 1e6
"""A time budget that no search uses up [s]."""

_LOOKS_OF_A_CHECKPOINT = 250
"""The compiled library passes a checkpoint every 2048 configurations, coal's checks one each. So
many times the checkpoints are allowed without it. Chosen: as long by the clock, about."""


class CountedPatience:
    """A planner's checkpoint that ends a plan after so many calls.

    Args:
        looks: How many a plan may take with the compiled library.
    """

    def __init__(self, looks: int) -> None:
        self._most = self._left = looks

    def renew(self, *, compiled: bool) -> None:
        """Begin to count for another plan, whose checks are the compiled library's or coal's."""
        self._left = self._most * (1 if compiled else _LOOKS_OF_A_CHECKPOINT)

    def __call__(self) -> None:
        """Count.

        Raises:
            NoPath: It is enough.
        """
        self._left -= 1
        if self._left < 0:
            raise NoPath("no path found within the looks that are allowed")
