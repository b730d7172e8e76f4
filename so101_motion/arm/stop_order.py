"""Refuse motions that were asked for before a stop.

A request may have to wait before it can begin a motion: for the positions of other arms, for a
plan, for servos that come back. A stop that comes meanwhile finds no motion that it could end. So a
request is marked when it arrives with the number of stops so far, and what would begin a motion for
it after a later stop refuses. The mark is a context variable: it goes with the request into the
tasks and threads that carry it out.
"""

from __future__ import annotations

import math
import threading
from contextvars import ContextVar

from so101_motion.common.errors import Interrupted

STOP = "stop"
"""What motions end with that somebody stopped: ``Interrupted(STOP)``."""

_lock = threading.Lock()
_newest = 0
_asked: ContextVar[float] = ContextVar("asked", default=math.inf)


def mark_request() -> None:
    """Note that a request has just arrived, which this task or thread carries out."""
    _asked.set(_newest)


def forget_request() -> None:
    """Note that what follows is a motion that has begun: a stop ends that by itself."""
    _asked.set(math.inf)


class LastStop:
    """The newest stop of an arm or a jaw. Its owner sees to it that only one thread calls."""

    def __init__(self) -> None:
        self._number = 0

    def note(self) -> None:
        """Note a stop."""
        global _newest
        with _lock:
            _newest += 1
            self._number = _newest

    def refuse_older(self) -> None:
        """Refuse a motion for a request that arrived before the newest stop.

        Raises:
            Interrupted: It did.
        """
        if self._number > _asked.get():
            raise Interrupted(STOP)
