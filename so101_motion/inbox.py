"""What other threads ask of the I/O thread.

Requests queue. Stops do not: one throws out the requests that were made before it, of the channels
that it is for, and is looked at first.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

from so101_motion.channel import Channel
from so101_motion.errors import Interrupted


def running_future() -> Future[Any]:
    """A future that nobody can cancel: what it stands for ends by being stopped."""
    future: Future[Any] = Future()
    future.set_running_or_notify_cancel()
    return future


@dataclass(frozen=True, slots=True)
class Request:
    """Something to be done between two ticks.

    Attributes:
        future: What comes of it.
        channel: Whose stop throws it out; None for nobody's.
        run: Does it; called with the number of the coming tick.
    """

    future: Future[Any]
    channel: Channel | None
    run: Callable[[int], None]


@dataclass(frozen=True, slots=True)
class Stop:
    """A stop.

    Attributes:
        future: Completes at rest.
        channels: Whose.
        by: What the motions end with.
    """

    future: Future[None]
    channels: Collection[Channel]
    by: str


class Inbox:
    """From any thread to one; every method returns at once.

    Args:
        wake: Set when there is something new.
    """

    def __init__(self, wake: threading.Event) -> None:
        self._wake = wake
        self._lock = threading.Lock()
        self._requests: list[Request] = []
        self._stops: list[Stop] = []
        self._closing = self._over = False

    def ask(self, request: Request) -> None:
        """Queue a request; it fails with ``Interrupted("shutdown")`` if nobody serves any more."""
        with self._lock:
            closing = self._closing
            if not closing:
                self._requests.append(request)
        if closing:
            request.future.set_exception(Interrupted("shutdown"))
        self._wake.set()

    def stop(self, stop: Stop, *, anyone: bool = True) -> None:
        """Stop, ahead of the queue.

        Args:
            stop: What to stop.
            anyone: Whether there is a thread to obey; if not, everything is at rest.
        """
        dropped: list[Request] = []
        with self._lock:
            asked, self._requests = self._requests, []
            for request in asked:
                (dropped if request.channel in stop.channels else self._requests).append(request)
            over = self._over or not anyone
            if not over:
                self._stops.append(stop)
        for request in dropped:
            request.future.set_exception(Interrupted(stop.by))
        if over:
            stop.future.set_result(None)
        self._wake.set()

    def close(self) -> bool:
        """Take no more requests and stop everything; whether this was the first time."""
        with self._lock:
            first, self._closing = not self._closing, True
            dropped, self._requests = self._requests, []
            if first:
                self._stops.append(Stop(running_future(), tuple(Channel), "shutdown"))
        for request in dropped:
            request.future.set_exception(Interrupted("shutdown"))
        self._wake.set()
        return first

    # For the thread that serves

    def take(self) -> tuple[list[Stop], list[Request]]:
        """What has come since the last time."""
        with self._lock:
            stops, self._stops = self._stops, []
            requests, self._requests = self._requests, []
        return stops, requests

    def is_over(self, *, moving: bool) -> bool:
        """Whether it is time to leave; later stops then find everything at rest."""
        with self._lock:
            self._over = self._closing and not moving and not self._stops
            return self._over

    def leave(self) -> None:
        """Nobody serves from now on."""
        with self._lock:
            self._closing = self._over = True
