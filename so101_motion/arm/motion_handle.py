"""Wait for one motion, or interrupt it, never the next one."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from so101_motion.common.errors import SUPERSEDED, Interrupted, So101Error
from so101_motion.common.public import Public
from so101_motion.common.realtime import LOOK_FOR_SIGNALS
from so101_motion.control.motion_source import PlannedMotion
from so101_motion.control.request_queue import running_future
from so101_motion.planning.request import Plan

if TYPE_CHECKING:
    from so101_motion.common.clock import Clock

T = TypeVar("T")


class Motion(Public):
    """A motion that is being planned, is under way, or is over.

    Attributes:
        future: Completes when the arm has arrived and settled, or raises what went wrong:
            ``PlanningError``, ``Interrupted``, ``FollowingError``, ``WorkerError``.
        plan: The plan that is being executed, once it is known; None for motions without a plan.
        playing: What moves the arm, if a newer motion may go on from it without a stop.
        halt: Ends its movement, and only that, for the reason given; None before it moves.
    """

    _shown = "future interrupt plan result"

    def __init__(self) -> None:
        self.future: Future[None] = running_future()  # a motion ends by being interrupted
        self.plan: Plan | None = None
        self.playing: PlannedMotion | None = None
        self._lock = threading.Lock()
        self._interruption: Future[str] = Future()
        self._wake = threading.Event()  # set when it is interrupted
        self.halt: Callable[[str], object] | None = None

    def __repr__(self) -> str:
        if not self.future.done():
            return "<Motion under way>"
        return f"<Motion over: {self.future.exception() or 'it arrived'}>"

    def result(self, timeout: float | None = None) -> None:
        """Wait until the arm has arrived, for ``timeout`` on the wall clock [s] at most.

        Raises:
            TimeoutError: It is still under way, and goes on.
            So101Error: It did not arrive; the error says why.
        """
        end = math.inf if timeout is None else time.monotonic() + timeout
        while not self.future.done():
            left = end - time.monotonic()
            if left <= 0.0:
                raise TimeoutError(f"still under way after {timeout:g} s, and goes on")
            wait((self.future,), min(left, LOOK_FOR_SIGNALS))
        if (error := self.future.exception()) is not None:
            raise error.with_traceback(None) if isinstance(error, So101Error) else error

    def interrupt(self, by: str) -> None:
        """End this motion early; the arm slows to rest along a jerk-limited ramp.

        Returns at once; ``future`` completes when the arm is at rest.
        """
        halt = self.give_up(by)
        if halt is not None:
            halt(by)

    def give_up(self, by: str) -> Callable[[str], object] | None:
        """End the preparation of this motion, as ``interrupt`` does.

        Returns a function that ends its movement; None if it has not begun to move, or ends
        already.
        """
        with self._lock:
            if self.future.done() or self._interruption.done():
                return None
            self._interruption.set_result(by)
            self._wake.set()
            return self.halt

    def hand_over(self, newer: Motion) -> bool:
        """End, and let a newer motion go on from what moves the arm; False if there is no such."""
        with self._lock:
            if self.playing is None or self.future.done() or self._interruption.done():
                return False
            self._interruption.set_result(SUPERSEDED)
            newer.playing, self.playing = self.playing, None
            self._wake.set()
        return True

    def wait_for(self, awaited: Future[T]) -> T:
        """The result of ``awaited``; cancelled, with ``Interrupted``, when this is interrupted."""
        either: list[Future[Any]] = [awaited, self._interruption]
        wait(either, return_when=FIRST_COMPLETED)
        if self._interruption.done():
            awaited.cancel()
        self.refuse_interrupted()
        return awaited.result()

    def pause_until(self, clock: Clock, until: float) -> None:
        """Wait until a time [s]; an interruption ends it and raises. One thread at a time."""
        with clock.attend():
            while clock.now() < until and not self._interruption.done():
                clock.wait(until, self._wake)
        self.refuse_interrupted()

    def wake(self) -> None:
        """Let its thread look again at what it waits for in ``wait_until``."""
        self._wake.set()

    def wait_until(self, clock: Clock, until: float) -> None:
        """Wait until a time [s], or ``wake``, on a thread that attends to ``clock``.

        Raises:
            Interrupted: The motion was interrupted.
        """
        clock.wait(until, self._wake)
        self.refuse_interrupted()

    @contextmanager
    def begin(self) -> Iterator[None]:
        """Start moving in this block, and set ``halt``; an interruption waits for its end.

        One that came before raises ``Interrupted``; the block is not entered.
        """
        with self._lock:
            self.refuse_interrupted()
            yield

    def take_outcome(self, done: Future[None]) -> None:
        """End with the outcome of ``done``; a callback for motions without a thread."""
        error = done.exception()
        if error is not None:
            self.future.set_exception(error)
        else:
            self.future.set_result(None)

    def refuse_interrupted(self) -> None:
        """Raise ``Interrupted`` if a newer motion or a stop has ended this one."""
        if self._interruption.done():
            raise Interrupted(self._interruption.result())


Step = Plan | Callable[[Motion], Plan | None]
"""A step of a series: a plan, or what is called while the arm rests and may return a plan."""
