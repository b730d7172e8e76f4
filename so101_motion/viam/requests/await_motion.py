"""Wait for a motion; cancelling the wait stops the motion.

A handler gets ``CancelledError`` when the client cancels, the deadline passes or the connection is
lost. Letting that error through would leave the arm moving, because a running future cannot be
cancelled. So the future is shielded, and on cancellation the motion is interrupted and its end
awaited before the error is raised again. A newer motion that has replaced this one is not stopped.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from so101_motion.arm.motion_handle import Motion
from so101_motion.common.errors import Interrupted
from so101_motion.common.operation import Moving
from so101_motion.control.request_queue import own_thread

T = TypeVar("T")

Rest = Callable[[asyncio.Future[None]], Awaitable[None]]
"""Waits until a motion that is being ended is over, also if it failed."""


async def wait_for_arrival(motion: Moving, come_to_rest: Rest | None = None) -> None:
    """Wait until the arm has arrived; when the wait is cancelled, stop this motion first."""
    future = asyncio.wrap_future(motion.future)
    try:
        await asyncio.shield(future)
    except asyncio.CancelledError:
        motion.interrupt("cancelled")
        await (come_to_rest or rest)(future)
        raise


async def rest(future: asyncio.Future[Any]) -> None:
    """Wait until a motion is over, also if it failed; cancelling this wait takes effect then."""
    cancelled: asyncio.CancelledError | None = None
    while not future.done():
        try:
            await asyncio.wait([future])
        except asyncio.CancelledError as error:
            cancelled = error
    future.exception()  # read, so that asyncio does not report it as never retrieved
    if cancelled is not None:
        raise cancelled


def in_own_thread(job: Callable[[], T]) -> asyncio.Future[T]:
    return asyncio.wrap_future(own_thread(job))


async def run_to_end(job: Callable[[], T]) -> T:
    """Run ``job`` in a thread to its end; a cancelled wait takes effect after it."""
    return await wait_to_end(in_own_thread(job))


async def wait_to_end(step: Awaitable[T]) -> T:
    future = asyncio.ensure_future(step)
    try:
        return await asyncio.shield(future)
    except asyncio.CancelledError:
        await rest(future)
        raise


class TurnQueue:
    """Lets one caller through per turn of the event loop.

    Otherwise many requests that arrive at once would all compute in one long turn, and a Stop
    behind them would be read only after it.
    """

    def __init__(self) -> None:
        self._one_at_a_time = asyncio.Lock()

    async def passed(self) -> None:
        async with self._one_at_a_time:
            await asyncio.sleep(0)


def log_failure_of(motion: Motion, logger: logging.Logger) -> None:
    """Log the error of a ``motion`` that no caller waits for."""

    def report(done: Future[None]) -> None:
        error = done.exception()
        if error is not None and not isinstance(error, Interrupted):
            logger.warning("a motion that no caller waits for did not arrive: %s", error)

    motion.future.add_done_callback(report)
