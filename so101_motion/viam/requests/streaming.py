"""Play a trajectory while a client is still sending it.

Each batch is acknowledged once its points are queued. When they reach far ahead of the arm, the
next batch is received only after the arm has caught up, so a stream may have any length. When the
motion ends early (a stop, a newer motion, a joint that cannot follow), the client gets the error at
once, not with its next batch. When the call ends, this motion is brought to rest first.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Sequence
from typing import Any

from viam.components.arm import Arm

from so101_motion.arm.motion_queue import Opening
from so101_motion.common.geometry import Array
from so101_motion.control.streamed_trajectory import Stream, TimedPoint
from so101_motion.viam.requests.await_motion import Rest

Batch = Sequence[Arm.TrajectoryPoint]

FARTHEST = 2.0
"""How far ahead points may reach before the next batch is received [s]; chosen: longer than the
gaps of a network, and a stop discards little."""

_LOOK = 0.02  # [s] between two checks of how far ahead they reach


async def played(
    opening: Opening[Stream],
    batches: AsyncIterator[Batch],
    read: Callable[[Arm.TrajectoryPoint], Array],
    come_to_rest: Rest,
) -> AsyncGenerator[Arm.TrajectoryUpdate, None]:
    """Push batches into a stream as they arrive, and wait until the arm has arrived.

    ``read`` gives the joint angles of a point [rad]. Yields an acknowledgement for each batch.
    """
    over, opened = (asyncio.wrap_future(f) for f in (opening.motion.future, opening.opened))
    opened.add_done_callback(lambda done: done.cancelled() or done.exception())  # retrieved
    empty = True
    try:
        stream = await asyncio.shield(opened)
        while (batch := await _next(batches, over)) is not None:
            stream.push(
                [TimedPoint(t=point.time.total_seconds(), q=read(point)) for point in batch]
            )
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
