"""Let a caller cancel planning through a checkpoint that the planner calls.

The caller passes a checkpoint. Everything that takes more than a few milliseconds calls it again
and again; it returns at once, or raises ``Abandoned`` when the plan is no longer wanted. So the
planner itself knows nothing of threads, processes or clocks.
"""

from __future__ import annotations

from collections.abc import Callable

Checkpoint = Callable[[], None]
"""Called every few milliseconds during planning; raises ``Abandoned`` to end it."""


class Abandoned(Exception):
    """The plan is no longer wanted. Not a ``So101Error``, because no user ever sees it."""


def never_abandoned() -> None:
    """A checkpoint that never gives up."""
