"""Waiting for a motion, so that giving up the wait ends the motion.

A cancelled client, a passed deadline and a lost connection all reach a handler as one thing:
``CancelledError``. Awaiting the motion's future and letting that error through would abandon the
wait and leave the arm moving, because a future that is being worked on cannot be cancelled. So the
future is shielded, and on cancellation the motion is interrupted and its end awaited before the
error goes on. Only this motion is touched: one that has superseded it moves on.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from so101_motion.errors import Interrupted
from so101_motion.motion import Motion

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


async def carried_out(job: Callable[[], T]) -> T:
    """Run ``job`` in a thread and wait for it; a step that was begun is finished in any case.

    When the wait is cancelled that takes effect only then, so nobody overtakes the step.

    Raises:
        Exception: What ``job`` raised.
        asyncio.CancelledError: The wait was cancelled; the job is over.
    """
    future = asyncio.ensure_future(asyncio.to_thread(job))
    try:
        return await asyncio.shield(future)
    except asyncio.CancelledError:
        await rest(future)
        raise


def left_alone(motion: Motion, logger: logging.Logger) -> None:
    """Let ``motion`` run without a waiting caller; what goes wrong is logged."""

    def report(done: Future[None]) -> None:
        error = done.exception()
        if error is not None and not isinstance(error, Interrupted):
            logger.warning("a motion nobody waits for did not arrive: %s", error)

    motion.future.add_done_callback(report)
