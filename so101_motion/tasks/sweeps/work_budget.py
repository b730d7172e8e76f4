"""End a search after a number of checkpoints instead of a time, so that load changes no result."""

from __future__ import annotations

from so101_motion.common.errors import NoPath

NEVER = 1e6
"""A time budget that no search uses up [s]."""


class WorkBudget:
    """A planner's checkpoint that ends a plan after a number of calls.

    Args:
        looks: How many calls a plan may take; the library calls every 2048 configurations.
    """

    def __init__(self, looks: int) -> None:
        self._most = self._left = looks

    def reset(self) -> None:
        """Start to count for another plan."""
        self._left = self._most

    def __call__(self) -> None:
        """Count a call.

        Raises:
            NoPath: The budget is used up.
        """
        self._left -= 1
        if self._left < 0:
            raise NoPath("no path found within the allowed amount of work")
