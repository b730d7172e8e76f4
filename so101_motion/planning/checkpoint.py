"""Give up a plan that nobody waits for any more.

Whoever runs the planner may hand it a checkpoint. Everything that takes more than a few
milliseconds calls it again and again; it returns at once, or raises ``Abandoned`` when the plan is
no longer wanted. So the planner itself needs to know nothing of threads, processes or clocks.
"""

from __future__ import annotations

from collections.abc import Callable

Checkpoint = Callable[[], None]
"""Called every few milliseconds while a plan is made; raises ``Abandoned`` to end that."""


class Abandoned(Exception):
    """The plan is no longer wanted. Not a ``So101Error``, for no caller ever sees it."""


def wanted() -> None:
    """A checkpoint that never gives up."""
