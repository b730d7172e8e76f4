"""Wait for a motion; cancelling the wait stops the motion.

A cancelled client, a passed deadline and a lost connection all reach a handler as one thing:
``CancelledError``. Awaiting the motion's future and letting that error through would abandon the
wait and leave the arm moving, because a future that is being worked on cannot be cancelled. So the
future is shielded, and on cancellation the motion is interrupted and its end awaited before the
error goes on. Only this motion is touched: one that has superseded it moves on.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from so101_motion.arm.motion_handle import Motion
from so101_motion.common.errors import Interrupted
from so101_motion.control.request_queue import running_future

T = TypeVar("T")

Rest = Callable[[asyncio.Future[None]], Awaitable[None]]
"""Waits until a motion that is being ended is over, well or not."""


async def arrival(motion: Motion, come_to_rest: Rest | None = None) -> None:
    """Wait until the arm has arrived; when the wait is cancelled, stop this motion first.

    Args:
        motion: What is waited for.
        come_to_rest: Waits until an interrupted motion is over; ``rest`` if not given.

    Raises:
        So101Error: Why it did not arrive.
        asyncio.CancelledError: The wait was cancelled; this motion is at rest.
    """
    future = asyncio.wrap_future(motion.future)
    try:
        await asyncio.shield(future)
    except asyncio.CancelledError:
        motion.interrupt("cancelled")
        await (come_to_rest or rest)(future)
        raise


async def rest(future: asyncio.Future[Any]) -> None:
    """Wait until a motion is over, well or not; cancelling this wait takes effect only then."""
    cancelled: asyncio.CancelledError | None = None
    while not future.done():
        try:
            await asyncio.wait([future])
        except asyncio.CancelledError as error:
            cancelled = error
    future.exception()  # looked at, so that asyncio does not report it as forgotten
    if cancelled is not None:
        raise cancelled


def own_thread(job: Callable[[], T]) -> Future[T]:
    """Run ``job``, which waits, in a thread of its own.

    The threads of ``asyncio.to_thread`` are few, and what plans or computes may occupy them all.
    """
    done: Future[T] = running_future()

    def run() -> None:
        try:
            done.set_result(job())
        except BaseException as error:  # whoever waits must hear of it
            done.set_exception(error)

    threading.Thread(target=run, name="so101-job").start()
    return done


def in_own_thread(job: Callable[[], T]) -> asyncio.Future[T]:
    """``own_thread`` for the event loop."""
    return asyncio.wrap_future(own_thread(job))


async def carried_out(job: Callable[[], T]) -> T:
    """Run ``job`` in a thread and wait for it; a step that has begun is always finished.

    When the wait is cancelled that takes effect only then, so nobody overtakes the step.

    Raises:
        Exception: What ``job`` raised.
        asyncio.CancelledError: The wait was cancelled; the job is over.
    """
    return await finished(in_own_thread(job))


async def finished(step: Awaitable[T]) -> T:
    """Wait for a step that is always finished, like ``carried_out``."""
    future = asyncio.ensure_future(step)
    try:
        return await asyncio.shield(future)
    except asyncio.CancelledError:
        await rest(future)
        raise


class TurnQueue:
    """Lets one caller per turn of the event loop through.

    What many requests that came at once have to compute before they first wait would otherwise be
    one long turn, and a Stop behind them would not be read before its end.
    """

    def __init__(self) -> None:
        self._one_at_a_time = asyncio.Lock()

    async def passed(self) -> None:
        """Wait for a turn."""
        async with self._one_at_a_time:
            await asyncio.sleep(0)


def left_alone(motion: Motion, logger: logging.Logger) -> None:
    """Let ``motion`` run without a waiting caller; errors are logged."""

    def report(done: Future[None]) -> None:
        error = done.exception()
        if error is not None and not isinstance(error, Interrupted):
            logger.warning("a motion nobody waits for did not arrive: %s", error)

    motion.future.add_done_callback(report)
