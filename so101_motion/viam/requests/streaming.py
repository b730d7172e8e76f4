"""Play a trajectory while a client is still sending it.

Each batch is acknowledged once its points are taken. When they reach far ahead of the arm the next
batch is not taken from the wire before the arm has come nearer: what a client sends too early waits
on its side, so a stream may be as long as one likes. What ends the motion meanwhile (a stop, a
newer motion, a joint left behind) reaches the client at once, not with its next batch; and whatever
ends the call brings this motion to rest before the call is over.
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
"""How far ahead points may reach before the next batch is taken [s]; chosen: rides out whatever a
network does, and a stop has little to throw away."""

_LOOK = 0.02  # [s] between two looks at how far ahead they reach


async def played(
    opening: Opening[Stream],
    batches: AsyncIterator[Batch],
    read: Callable[[Arm.TrajectoryPoint], Array],
    come_to_rest: Rest,
) -> AsyncGenerator[Arm.TrajectoryUpdate, None]:
    """Push batches into a stream as they arrive, and wait until the arm has arrived.

    Args:
        opening: Of the stream that takes the points.
        batches: What the client sends.
        read: Joint angles, shape (5,), [rad], of a point.
        come_to_rest: Waits until an interrupted motion is over.

    Yields:
        An acknowledgement for each batch.

    Raises:
        So101Error: Why the arm did not arrive.
    """
    over, opened = (asyncio.wrap_future(f) for f in (opening.motion.future, opening.opened))
    opened.add_done_callback(lambda done: done.cancelled() or done.exception())  # looked at
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
    """The next batch, None after the last; raises what ends the motion first."""
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
