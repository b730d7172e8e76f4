"""Refuse motions that were asked for before a stop.

A request may have to wait before it can begin a motion: for the positions of other arms, for a
plan, for servos that come back. A stop that comes meanwhile finds no motion that it could end. So
requests and stops are numbered in the order in which they arrive. The number of a request is a
context variable: it goes with the request into the tasks and threads that carry it out.
"""

from __future__ import annotations

import math
from contextvars import ContextVar
from itertools import count

from so101_motion.common.errors import Interrupted

STOP = "stop"
"""What motions end with that somebody stopped: ``Interrupted(STOP)``."""

NUMBERS = count(1)
"""Numbers requests and stops; any thread may take the next one."""

_asked: ContextVar[float] = ContextVar("asked", default=math.inf)


def mark_request() -> None:
    """Note that a request has just arrived, which this task or thread carries out."""
    _asked.set(next(NUMBERS))


def request_number() -> int:
    """The number of the request that this task or thread carries out; a new one if it has none."""
    asked = _asked.get()
    return next(NUMBERS) if math.isinf(asked) else int(asked)


def forget_request() -> None:
    """Note that what follows is a motion that has begun: a stop ends that by itself."""
    _asked.set(math.inf)


def is_older(stopped: int) -> bool:
    """Whether the request that is carried out arrived before the stop of this number."""
    return stopped > _asked.get()


def refuse_older(stopped: int) -> None:
    """Raise ``Interrupted`` for a request that arrived before stop ``stopped``; 0 for none."""
    if is_older(stopped):
        raise Interrupted(STOP)
