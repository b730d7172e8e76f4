"""End a search after a number of checkpoints instead of a time, so that load changes no result."""

from __future__ import annotations

from so101_motion.common.errors import NoPath

NEVER = 1e6
"""A time budget that no search uses up [s]."""

_LOOKS_OF_A_CHECKPOINT = 250
"""The compiled library passes a checkpoint every 2048 configurations, coal one a configuration. So
where coal checks, so many times as many checkpoints are allowed. Chosen: about the same time."""


class WorkBudget:
    """A planner's checkpoint that ends a plan after a number of calls.

    Args:
        looks: How many calls a plan may take with the compiled library.
    """

    def __init__(self, looks: int) -> None:
        self._most = self._left = looks

    def reset(self, *, compiled: bool) -> None:
        """Start to count for another plan, which is checked by the compiled library or by coal."""
        self._left = self._most * (1 if compiled else _LOOKS_OF_A_CHECKPOINT)

    def __call__(self) -> None:
        """Count a call.

        Raises:
            NoPath: The budget is used up.
        """
        self._left -= 1
        if self._left < 0:
            raise NoPath("no path found within the allowed amount of work")
