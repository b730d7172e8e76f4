"""Manual mode: hand guiding of the arm, for a while or until it is ended."""

from __future__ import annotations

import asyncio
import logging

from so101_motion.arm.arm import Arm
from so101_motion.common.attributes import checked_number
from so101_motion.common.compliance import Compliance
from so101_motion.common.errors import So101Error
from so101_motion.common.modes import Mode
from so101_motion.viam.requests.await_motion import finished, in_own_thread

LONGEST = 86400.0
"""Longest time manual mode can be limited to [s]; chosen, a day."""


class ManualMode:
    """Switches an arm between holding and hand guiding. Lives in the event loop.

    Args:
        arm: The arm.
        logger: Where to say that holding again failed when the time was up.
    """

    def __init__(self, arm: Arm, logger: logging.Logger) -> None:
        self._arm = arm
        self._logger = logger
        self._timer: asyncio.Task[None] | None = None
        self._one_at_a_time = asyncio.Lock()

    async def set(
        self, enabled: bool, enabled_for: float = 0.0, compliance: Compliance | None = None
    ) -> None:
        """Start or end manual mode, with a time limit; once begun it is always finished.

        Args:
            enabled: Whether the arm shall yield.
            enabled_for: For how long [s]; 0 for no end. Real seconds, even in simulated time: they
                are a person's.
            compliance: How it yields; the arm's own way if not given.

        Raises:
            ConfigError: ``enabled_for`` is negative or absurdly long.
            So101Error: The joints could not be switched.
        """
        checked_number("enabled_for", enabled_for, lower=0.0, upper=LONGEST, unit="s")
        await finished(self._switch(enabled, enabled_for, compliance))

    async def _switch(
        self, enabled: bool, enabled_for: float, compliance: Compliance | None
    ) -> None:
        async with self._one_at_a_time:
            await in_own_thread(lambda: self._arm.set_manual(enabled, compliance))
            self.forget()
            if enabled and enabled_for > 0.0:
                self._timer = asyncio.create_task(self._hold_after(enabled_for))

    def forget(self) -> None:
        """Cancel the time limit."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    async def _hold_after(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
        async with self._one_at_a_time:
            if self._arm.state.mode is not Mode.GUIDING:
                return
            try:
                await in_own_thread(lambda: self._arm.set_manual(False))
            except So101Error as error:
                self._logger.warning("the time for manual mode is up, but: %s", error)
