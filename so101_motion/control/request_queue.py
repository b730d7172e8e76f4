"""Queue requests of other threads for the I/O thread, and complete their futures.

A stop throws out the requests of its channels that were made before it, and is served first.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, TypeVar

from so101_motion.common.errors import ArmClosed, Interrupted
from so101_motion.control.joint_group import Channel

T = TypeVar("T")


def running_future() -> Future[Any]:
    """A future that cannot be cancelled, because its motion must be stopped instead."""
    future: Future[Any] = Future()
    future.set_running_or_notify_cancel()
    return future


def own_thread(job: Callable[[], T]) -> Future[T]:
    """Run ``job``, which may block, in its own thread: computations may occupy a whole pool."""
    done: Future[T] = running_future()

    def run() -> None:
        try:
            done.set_result(job())
        except BaseException as error:  # raised where the job is awaited
            done.set_exception(error)

    threading.Thread(target=run, name="so101-job").start()
    return done


@dataclass(frozen=True, slots=True)
class Request:
    """A job for the I/O thread, run between two ticks.

    Attributes:
        future: Completes with the result or the error; ``Interrupted`` if a stop throws it out.
        channel: The channel whose stop throws it out; None if no stop does.
        run: Called on the I/O thread.
        is_job: Whether ``future`` completes with what ``run`` returns. Otherwise ``run``, or the
            motion that it begins, completes it; an error of ``run`` fails it in either case.
    """

    future: Future[Any]
    channel: Channel | None
    run: Callable[[], object]
    is_job: bool = False


class RequestQueue:
    """The requests of all threads to the I/O thread; every method returns at once.

    Args:
        wake: Set when there is something new.

    Attributes:
        closing: Whether no more requests are taken.
        on_request: Called with the future of every request as it is made, and with the channels
            that it stops, if it is a stop; by the thread that asks. None for nobody.
    """

    def __init__(self, wake: threading.Event) -> None:
        self.on_request: Callable[[Future[Any], Collection[Channel]], None] | None = None
        self._wake = wake
        self._lock = threading.Lock()
        self._requests: list[Request] = []
        self._stops: list[Request] = []
        self._is_open = self.closing = self._over = False

    def open(self) -> None:
        self._is_open = True

    def ask(
        self,
        run: Callable[[], object],
        future: Future[Any] | None = None,
        channel: Channel | None = None,
    ) -> Future[Any]:
        """Queue a request; it fails with ``ArmClosed`` once the queue has been closed.

        Args:
            run: Called on the I/O thread, between two ticks.
            future: What ``run``, or the motion that it begins, completes. If None, a new one
                completes with what ``run`` returns.
            channel: The channel whose stop throws it out; None if no stop does.
        """
        if not self._is_open:
            raise RuntimeError("start the executor first")
        request = Request(future or running_future(), channel, run, is_job=future is None)
        if self.on_request is not None:
            self.on_request(request.future, ())
        with self._lock:
            closing = self.closing
            if not closing:
                self._requests.append(request)
        if closing:
            request.future.set_exception(ArmClosed())
        self._wake.set()
        return request.future

    def stop(self, stop: Request, channels: Collection[Channel], by: str) -> None:
        """Serve ``stop`` next; waiting requests of ``channels`` fail with ``Interrupted(by)``.

        When no thread serves, everything rests, and ``stop`` completes at once.
        """
        if self.on_request is not None:
            self.on_request(stop.future, channels)
        dropped: list[Request] = []
        with self._lock:
            asked, self._requests = self._requests, []
            for request in asked:
                (dropped if request.channel in channels else self._requests).append(request)
            over = self._over or not self._is_open
            if not over:
                self._stops.append(stop)
        for request in dropped:
            request.future.set_exception(Interrupted(by))
        if over:
            stop.future.set_result(None)
        self._wake.set()

    def close(self, stop: Request) -> bool:
        """Take no more requests and serve ``stop``; whether this was the first time."""
        with self._lock:
            first, self.closing = not self.closing, True
            dropped, self._requests = self._requests, []
            if first:
                self._stops.append(stop)
        for request in dropped:
            request.future.set_exception(Interrupted("shutdown"))
        self._wake.set()
        return first

    @property
    def has_ended(self) -> bool:
        """Whether the thread has ended after ``close``, so that nobody looks at the joints."""
        return self._over

    # For the thread that serves

    @property
    def is_empty(self) -> bool:
        return not self._stops and not self._requests

    def take(self) -> list[Request]:
        with self._lock:
            taken = [*self._stops, *self._requests]
            self._stops, self._requests = [], []
        return taken

    def is_over(self, *, moving: bool) -> bool:
        """Whether the thread may end; stops that come later complete at once."""
        with self._lock:
            self._over = self.closing and not moving and not self._stops
            return self._over

    def leave(self) -> None:
        """Note that the thread has ended; later requests fail at once."""
        with self._lock:
            self.closing = self._over = True


class Outcomes:
    """Results of futures: noted during a tick, set at its end; I/O thread only.

    Futures complete after the snapshot that shows their effect, for their callbacks look at it.
    """

    def __init__(self) -> None:
        self._noted: list[tuple[Future[Any], object, BaseException | None]] = []
        self._awaited: dict[Future[Any], int] = {}

    def expect(self, future: Future[Any], count: int) -> None:
        """``future`` completes with the last of ``count`` conclusions, or the first error."""
        self._awaited[future] = count

    def conclude(
        self, future: Future[Any], error: BaseException | None = None, *, result: object = None
    ) -> None:
        """Note the result or error of ``future``; ``settle`` completes it."""
        others = self._awaited.pop(future, 1) - 1
        if others and error is None:
            self._awaited[future] = others
        else:
            self._noted.append((future, result, error))

    def settle(self) -> None:
        """Complete the noted futures; their callbacks run here."""
        noted, self._noted = self._noted, []
        for future, result, error in noted:
            if future.done():
                continue  # a stop of both channels that has failed for one
            if error is not None:
                future.set_exception(error)
            else:
                future.set_result(result)
