"""Switch manual mode, in which the arm is guided by hand, for some time or until it is ended.

A hand is stronger than the wall that it feels before contact, so what the arm touches is logged.
"""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from contextvars import copy_context
from functools import partial

from so101_motion.arm.arm import Arm
from so101_motion.common.attributes import checked_number
from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import Interrupted, So101Error, SurroundingsUnknown
from so101_motion.common.modes import LONGEST_GUIDING, Mode
from so101_motion.viam.requests.await_motion import in_own_thread, wait_to_end
from so101_motion.viam.surroundings.guarded_scene import GuardedScene

LOOK_EVERY = 0.5  # time between two looks at what a guided arm touches [s]; chosen


class ManualMode:
    """Switches an arm between holding and hand guiding. Lives in the event loop.

    ``touching`` is what the guided arm touches, see ``Arm.touching``; empty if nothing.
    """

    def __init__(self, arm: Arm, logger: logging.Logger, surroundings: GuardedScene) -> None:
        self._arm, self._surroundings = arm, surroundings
        self._logger = logger
        self.touching = ""
        self._looking: asyncio.Task[None] | None = None
        self._timer: asyncio.Task[None] | None = None
        self._one_at_a_time = asyncio.Lock()

    async def set(
        self, enabled: bool, enabled_for: float = 0.0, compliance: Compliance | None = None
    ) -> None:
        """Start or end manual mode; a switch that has begun is always finished.

        It ends after ``enabled_for`` real seconds, even in simulated time; 0 for no end.
        """
        checked_number("enabled_for", enabled_for, lower=0.0, upper=LONGEST_GUIDING, unit="s")
        async with self._one_at_a_time:
            await wait_to_end(self._switch(enabled, enabled_for, compliance))

    async def _switch(
        self, enabled: bool, enabled_for: float, compliance: Compliance | None
    ) -> None:
        # in the request's context, so that it is refused if the arm was stopped meanwhile
        await in_own_thread(partial(copy_context().run, self._arm.set_manual, enabled, compliance))
        self.forget()
        if enabled:
            self._looking = asyncio.create_task(self._look())
        if enabled and enabled_for > 0.0:
            self._timer = asyncio.create_task(self._hold_after(enabled_for))

    def forget(self) -> None:
        for task in (self._timer, self._looking):
            if task is not None:
                task.cancel()
        self._timer, self._looking, self.touching = None, None, ""

    async def _look(self) -> None:
        while self._arm.state.mode is Mode.GUIDING:
            with suppress(SurroundingsUnknown, Interrupted):  # the first is in the log
                await self._surroundings.known()
            touching = await in_own_thread(self._arm.touching)
            if touching and touching != self.touching:
                self._logger.warning("the arm that a hand guides has %s", touching)
            self.touching = touching
            await asyncio.sleep(LOOK_EVERY)
        self.touching = ""

    async def _hold_after(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
        async with self._one_at_a_time:
            if self._arm.state.mode is not Mode.GUIDING:
                return
            try:
                await in_own_thread(lambda: self._arm.set_manual(False))
            except So101Error as error:
                self._logger.warning(
                    "the time for manual mode is up, but the arm cannot hold: %s", error
                )
