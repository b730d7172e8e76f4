"""Run one motion at a time: a newer motion supersedes the one under way.

Everything that moves the arm is registered here from the instant it is asked for, so a stop ends
what is still being prepared as well. The old motion is interrupted and the arm comes to rest before
the new one begins. A retarget does not stop the arm: it begins first and interrupts then. Any
thread may call; nothing waits while it holds the lock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextvars import copy_context
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from so101_motion.arm.motion_handle import Motion
from so101_motion.arm.stop_order import STOP, forget_request, is_older, refuse_older
from so101_motion.common.errors import SUPERSEDED, ArmClosed, So101Error
from so101_motion.control.motion_source import S

T = TypeVar("T")

Run = Callable[[Motion], Future[None] | None]
"""Carries a motion out. It returns None at the end of the motion, or earlier a future that
completes then."""


@dataclass(frozen=True, slots=True)
class Opening(Generic[S]):
    """A jog or following that begins as soon as the arm rests.

    Attributes:
        motion: Registered already; interrupting it ends the opening, too.
        opened: Completes with the jog or following when it has begun, or raises why it has not.
    """

    motion: Motion
    opened: Future[S]


_here = threading.local()  # has the motion that a thread carries out


def wait_here(awaited: Future[T]) -> T:
    """The result of ``awaited``; the motion that the calling thread carries out waits for it.

    ``Interrupted`` if that motion was interrupted; ``awaited`` is cancelled then.
    """
    motion: Motion | None = getattr(_here, "motion", None)
    try:
        return awaited.result() if motion is None else motion.wait_for(awaited)
    except So101Error as error:
        raise error.with_traceback(None)  # noqa: B904  # without the frames of other threads


class MotionQueue:
    """The motions of one arm.

    Args:
        come_to_rest: Slows the arm down for a newer motion. Returns at once: a future that
            completes at rest, or None if the arm rests already.

    Attributes:
        current: The newest motion; before the first, one that is over.
        stopped: The number of the newest stop, see ``stop_order.py``.
        lock: Held, for moments only, by whoever changes these two.
        is_closed: Whether no motion can be asked for any more.
    """

    def __init__(self, come_to_rest: Callable[[], Future[None] | None]) -> None:
        self.current = Motion()
        self.current.future.set_result(None)
        self._considered = Motion()
        self._come_to_rest = come_to_rest
        self.lock = threading.Lock()
        self.stopped, self.is_closed = 0, False
        self._threads = ThreadPoolExecutor(max_workers=4, thread_name_prefix="so101-arm")

    def start(self, run: Run, *, goes_on: bool = False) -> Motion:
        """Let ``run`` move the arm once it rests; returns at once.

        The motion raises what ``run`` or its future raises. With ``goes_on``, what moves the arm
        now may go on meanwhile, if ``Motion.playing`` says what it is; the new motion has it as its
        own then.

        Raises:
            Interrupted: The arm was stopped after the request for this motion had arrived.
            ArmClosed: The queue has been closed.
        """
        motion = Motion()
        with self.lock:
            refuse_older(self.stopped)
            previous = self.current
            try:
                # as ``asyncio.to_thread`` has it: large contents of a request are in its context
                self._threads.submit(copy_context().run, self._run, motion, [previous], run)
            except RuntimeError:  # no more threads after ``close``
                raise ArmClosed from None
            self.current = motion
            if not (goes_on and previous.hand_over(motion)):
                previous.interrupt(SUPERSEDED)
            self._considered.interrupt(SUPERSEDED)
        return motion

    def consider(self, planning: Future[Any]) -> Motion:
        """Note what is planned for a motion that may be asked for next, if it turns out possible.

        The motion under way goes on. A newer motion, a stop, or a newer one that is considered
        cancels ``planning``, and interrupts what is returned.
        """
        motion = Motion()
        motion.halt = lambda _by: planning.cancel()
        with self.lock:
            if is_older(self.stopped):
                motion.interrupt(STOP)
            before, self._considered = self._considered, motion
        before.interrupt(SUPERSEDED)
        return motion

    def stop(self, by: str, number: int) -> None:
        """End what is prepared; requests that are older than ``number`` begin nothing any more."""
        with self.lock:
            self.stopped = max(self.stopped, number)
            self.current.give_up(by)  # the executor's stop ends what moves
            self._considered.interrupt(by)

    def take_over(self, begin: Callable[[Motion], Future[None]]) -> Motion:
        """Begin a motion that takes over without a stop.

        ``begin`` begins the motion that it is given, and returns at once a future that completes at
        its end. ``Interrupted`` if the arm was stopped after the request for this motion had
        arrived.
        """
        motion = Motion()
        with self.lock:
            refuse_older(self.stopped)
            running = begin(motion)
            previous, self.current = self.current, motion
            previous.interrupt(SUPERSEDED)
            self._considered.interrupt(SUPERSEDED)
        running.add_done_callback(motion.take_outcome)
        return motion

    def close(self) -> None:
        self.is_closed = True
        self.current.interrupt("shutdown")
        self._threads.shutdown(wait=True)

    def _run(self, motion: Motion, previous: list[Motion], run: Run) -> None:
        # The motion before is ending. An error keeps the frames that it passed and all they refer
        # to, so it must not keep that motion, or failed motions would all keep each other alive.
        wait([previous.pop().future])
        forget_request()
        try:
            if motion.playing is None or motion.playing.future.done():
                self._rest_for(motion)
            _here.motion = motion
            ending = run(motion)
        except BaseException as error:  # those who wait for the motion must get it
            motion.future.set_exception(error)
        else:
            if ending is None:
                motion.future.set_result(None)
            else:
                ending.add_done_callback(motion.take_outcome)
        finally:
            _here.motion = None

    def _rest_for(self, motion: Motion) -> None:
        """Bring the arm to rest for a motion, unless a newer one has been asked for since.

        The newer one may be under way already, or may have released the arm.
        """
        with self.lock:
            if self.current is not motion:
                motion.interrupt(SUPERSEDED)
            motion.refuse_interrupted()
            resting = self._come_to_rest()
        if resting is not None:
            resting.result()
