"""What is around an arm when a plan is made.

The arm's own scene is what its configuration says. To it comes what the machine has: its
components, and what stores and cameras know. Asking takes some milliseconds, as long as a plan. So
a plan is begun with what was there the last time, and counts only if that is still so.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import TypeVar

from so101_motion.common.errors import ConfigError, SurroundingsUnknown
from so101_motion.planning.collision.scene import Scene
from so101_motion.viam.surroundings.machine_bodies import MachineBodies, scene_around

T = TypeVar("T")


class Surroundings:
    """What is around one arm. Belongs to the event loop.

    Args:
        machine: Reads the machine's components.
        logger: Where to say, once, that nothing of the machine is known.
    """

    def __init__(self, machine: MachineBodies, logger: logging.Logger) -> None:
        self._machine, self._logger = machine, logger
        self._said = ""
        self._last: tuple[Scene, Scene] | None = None

    @property
    def is_asked(self) -> bool:
        """Whether anything beside the arm's own scene can be known."""
        return self._machine.is_asked

    async def around(self, scene: Scene) -> Scene:
        """``scene`` with what is around now.

        Raises:
            SurroundingsUnknown: That cannot be found out.
        """
        bodies = await self._machine.read()
        if self._machine.without and self._machine.without != self._said:
            self._logger.warning("%s: nothing of it is planned around", self._machine.without)
        self._said = self._machine.without
        if not bodies:
            return scene
        try:
            around = await asyncio.to_thread(scene_around, scene, bodies)
        except ConfigError as error:
            raise SurroundingsUnknown(f"the machine has what cannot be meant: {error}") from error
        self._last = (scene, around)
        return around

    async def planned(self, scene: Scene, plan: Callable[[Scene], Awaitable[T]]) -> T:
        """What ``plan`` makes of ``scene`` with what is around now.

        Args:
            scene: What is known without asking.
            plan: Called with the scene to plan in, perhaps twice; may be cancelled.

        Raises:
            SurroundingsUnknown: What is around cannot be found out.
            Exception: What ``plan`` raises.
        """
        if not self.is_asked:
            return await plan(scene)
        guess = None
        last = self._last
        if last is not None and last[0] == scene:
            guess = asyncio.ensure_future(plan(last[1]))
        try:
            now = await self.around(scene)
            if guess is not None and last is not None and now == last[1]:
                return await guess
        finally:
            if guess is not None:
                guess.cancel()
                with suppress(BaseException):
                    await asyncio.wait([guess])
        return await plan(now)
