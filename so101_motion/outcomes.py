"""What futures end with, noted in the middle of a tick and told at its end.

Futures complete after the snapshot that shows their effect has been published, for their callbacks
look at it.
"""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any


class Outcomes:
    """Used by the I/O thread only."""

    def __init__(self) -> None:
        self._noted: list[tuple[Future[Any], object, BaseException | None]] = []
        self._awaited: dict[Future[Any], int] = {}

    def expect(self, future: Future[Any], count: int) -> None:
        """``future`` ends with the last of ``count`` conclusions, or with the first that fails."""
        self._awaited[future] = count

    def conclude(
        self, future: Future[Any], error: BaseException | None = None, *, result: object = None
    ) -> None:
        """Note what ``future`` ends with; ``settle`` tells it."""
        others = self._awaited.pop(future, 1) - 1
        if others and error is None:
            self._awaited[future] = others
        else:
            self._noted.append((future, result, error))

    def settle(self) -> None:
        """Complete the futures that have ended; their callbacks run here."""
        noted, self._noted = self._noted, []
        for future, result, error in noted:
            if future.done():
                continue  # a stop of both channels that failed for one
            if error is not None:
                future.set_exception(error)
            else:
                future.set_result(result)
