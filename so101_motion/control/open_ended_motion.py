"""The common base of jogs and followings: how they are closed, and how they end."""

from __future__ import annotations

from abc import ABC, abstractmethod
from concurrent.futures import Future
from typing import Self

from so101_motion.common.errors import MotionError
from so101_motion.control.request_queue import running_future


class EndsWithBlock(ABC):
    """Ends a motion where its ``with`` block ends, waits for that, and raises why it ended early.

    If the block raised, its error is the one that is raised.
    """

    future: Future[None]

    @abstractmethod
    def close(self) -> Future[None]:
        """Come to rest and end; may be called again."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if not self.future.done():
            self.close()
        if kind is None:
            self.future.result()
        else:
            self.future.exception()


class OpenEndedMotion(EndsWithBlock):
    """A motion that goes on until it is closed, stopped, or cannot go on.

    Args:
        name: What messages call it, such as ``"jog"``.

    Attributes:
        future: Completes when the joints are at rest after ``close``, or raises why it ended
            earlier.
    """

    def __init__(self, name: str) -> None:
        self.future: Future[None] = running_future()
        self._name, self._closing = name, False

    @property
    def keeps_apart(self) -> bool:
        """Whether it keeps off other arms of its cell by itself."""
        return False

    def close(self) -> Future[None]:
        """Slow to rest and end; may be called again."""
        self._closing = True
        return self.future

    def _refuse_if_over(self) -> None:
        """Refuse what is asked of a motion that has ended.

        Raises:
            So101Error: It has; when it failed, why.
        """
        if self.future.done():
            error = self.future.exception()
            if error is not None:
                raise error
            raise MotionError(f"the {self._name} is over; open a new one")
        if self._closing:
            raise MotionError(f"the {self._name} has been closed; open a new one")
