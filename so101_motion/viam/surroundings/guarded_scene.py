"""Tell an arm's guard what the machine has around the arm.

Targets that come one by one, streams and teleoperation are not planned: a guard checks every
setpoint, in the control cycle, so it must know the surroundings beforehand: the machine's
components and what is in the arm's stores. They are read before such a motion, and again beside it
while it goes on. What a camera sees is not part of it: a picture takes long, is another one each
time, and shows what the arm is to reach.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

from so101_motion.arm.arm import Arm
from so101_motion.common.errors import ConfigError, Interrupted, SurroundingsUnknown
from so101_motion.planning.collision.scene import Scene
from so101_motion.viam.surroundings.surroundings import Surroundings

RENEWED = 1.0
"""Surroundings that are older are read again while motions go on [s]; chosen: it takes
milliseconds of the process whose other threads move the arm."""

REPLANNED = 0.1  # the same for motions that are planned again while they move [s]; chosen
KNOWN_FOR = 5.0  # surroundings that are older must be read before a motion begins [s]; chosen


class GuardedScene:
    """Keeps one arm's guard informed, in the event loop; unused, only ``read`` reads anything."""

    def __init__(
        self,
        arm: Arm,
        surroundings: Surroundings,
        logger: logging.Logger,
        *,
        is_used: bool = True,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._arm, self._surroundings, self._logger = arm, surroundings, logger
        self._is_used, self._now = is_used, now
        self._told: tuple[Scene, Scene] | None = None  # the arm's own, and that with the rest
        self._t = 0.0  # of the last reading that succeeded
        self._reading: asyncio.Task[None] | None = None
        self._said = ""

    async def known(self) -> None:
        """Make sure that the guard knows the surroundings; waits only if it does not."""
        if not self._is_used:
            return
        age = self._now() - self._t
        if self._told is None or self._told[0] != self._arm.scene or age > KNOWN_FOR:
            await self.read()
        elif age > RENEWED:
            self._begin()

    async def read(self) -> None:
        """Read the surroundings and tell the guard, also that of a following under way.

        If they cannot be read, the guard goes on with the last ones. A stop meanwhile interrupts.
        """
        stops = self._arm.stops
        while self._surroundings.is_asked():
            await asyncio.shield(self._begin())
            if self._arm.stops != stops:
                raise Interrupted("stop")
            if self._told is not None and self._told[0] == self._arm.scene:
                return  # else it was begun before the arm had its present scene

    async def keep_known(self, goes_on: Callable[[], bool], every: float = RENEWED) -> None:
        """Read the surroundings again every so often [s] as long as ``goes_on()``."""
        while goes_on():
            await asyncio.sleep(every)
            with suppress(SurroundingsUnknown, Interrupted):  # the first is in the log
                await self.read()

    @asynccontextmanager
    async def kept_known(self, *, new: bool = False) -> AsyncIterator[None]:
        """Make sure that the guard knows the surroundings until the block ends; see ``known``.

        If they shall be ``new``, they are read now and every ``REPLANNED``; see ``read``.
        """
        await (self.read() if new else self.known())
        goes_on = self._surroundings.is_asked if new else lambda: self._is_used
        keep = self.keep_known(goes_on, REPLANNED if new else RENEWED)
        reading = asyncio.ensure_future(keep)
        try:
            yield
        finally:
            reading.cancel()
            await asyncio.wait([reading])

    async def close(self) -> None:
        if self._reading is not None:
            self._reading.cancel()
            await asyncio.wait([self._reading])

    def _begin(self) -> asyncio.Task[None]:
        if self._reading is None or self._reading.done():
            self._reading = asyncio.ensure_future(self._read())
            self._reading.add_done_callback(self._report)
        return self._reading

    async def _read(self) -> None:
        t, own = self._now(), self._arm.scene
        around = await self._surroundings.standing(own)
        if self._told != (own, around):
            try:
                await asyncio.to_thread(self._arm.keep_off, own, around)
            except ConfigError as error:
                reason = f"an obstacle around the arm is not valid: {error}"
                raise SurroundingsUnknown(reason) from error
        self._told, self._t = (own, around), t

    def _report(self, reading: asyncio.Task[None]) -> None:
        error = None if reading.cancelled() else reading.exception()
        if error is not None and str(error) != self._said:
            self._logger.warning("the guard cannot read the obstacles around the arm: %s", error)
        self._said = "" if error is None else str(error)
