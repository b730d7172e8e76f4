"""Wait for a motion or a stream; cancelling the wait stops the motion.

A handler gets ``CancelledError`` when the client cancels, the deadline passes or the connection is
lost. Letting that error through would leave the arm moving, because a running future cannot be
cancelled. So the future is shielded, and on cancellation the motion is interrupted and its end
awaited before the error is raised again. A newer motion that has replaced this one is not stopped.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Sequence
from concurrent.futures import Future
from typing import Any, TypeVar

from viam.components.arm import Arm

from so101_motion.arm.motion_handle import Motion
from so101_motion.arm.motion_queue import Opening
from so101_motion.common.errors import Interrupted
from so101_motion.common.operation import Moving
from so101_motion.control.request_queue import own_thread
from so101_motion.control.streamed_trajectory import Stream, TimedPoint
from so101_motion.viam.conversion import convert

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


Batch = Sequence[Arm.TrajectoryPoint]

FARTHEST = 2.0
"""How far ahead points may reach before the next batch is received [s]; chosen: longer than the
gaps of a network, and a stop discards little."""

_LOOK = 0.02  # [s] between two checks of how far ahead they reach


async def played(
    opening: Opening[Stream],
    batches: AsyncIterator[Batch],
    come_to_rest: Rest,
) -> AsyncGenerator[Arm.TrajectoryUpdate, None]:
    """Push batches into a stream as they arrive, and wait until the arm has arrived.

    Yields an acknowledgement for each batch.
    """
    over, opened = (asyncio.wrap_future(f) for f in (opening.motion.future, opening.opened))
    opened.add_done_callback(lambda done: done.cancelled() or done.exception())  # retrieved
    empty = True
    try:
        stream = await asyncio.shield(opened)
        while (batch := await _next(batches, over)) is not None:
            points = [(p.time, convert.from_joint_values(p.positions)) for p in batch]
            stream.push([TimedPoint(t=time.total_seconds(), q=q) for time, q in points])
            empty = False
            yield Arm.TrajectoryUpdate()
            while stream.ahead > FARTHEST and not over.done():
                await asyncio.wait([over], timeout=_LOOK)
        if not empty:
            stream.finish()
            await asyncio.shield(over)
    finally:
        opening.motion.interrupt("cancelled")
        await come_to_rest(over)


async def _next(batches: AsyncIterator[Batch], over: asyncio.Future[None]) -> Batch | None:
    """The next batch, None after the last; raises the motion's error if it ends first."""
    coming = asyncio.ensure_future(anext(batches, None))
    either: tuple[asyncio.Future[Any], ...] = (coming, over)
    try:
        await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
    except asyncio.CancelledError:
        coming.cancel()
        raise
    if over.done():
        coming.cancel()
        over.result()
    return await coming
