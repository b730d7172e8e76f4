"""What is around an arm when a plan is made.

The arm's own scene is what its configuration says. To it comes what the machine has: its
components, and what stores and cameras know. Asking takes some milliseconds, as long as a plan. So
a plan is begun with what was there the last time, and counts only if that is still so.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import Protocol, TypeVar

from so101_motion.common.errors import ConfigError, SurroundingsUnknown
from so101_motion.planning.collision.scene import Scene
from so101_motion.viam.surroundings.machine_bodies import MachineBodies
from so101_motion.viam.surroundings.machine_view import Body, MachineView, scene_around

T = TypeVar("T")

_KNOWN_FOR = 5.0
"""How long a led motion may go by where other arms stood [s]; chosen."""


class Source(Protocol):
    """Something that knows what is around, beside the machine's components."""

    @property
    def is_steady(self) -> bool:
        """Whether it says the same of what has not changed."""

    async def added_to(self, scene: Scene, view: MachineView) -> Scene:
        """``scene`` with what it knows.

        Raises:
            SurroundingsUnknown: It does not say.
            ConfigError: What it says is not valid.
        """

    async def close(self) -> None:
        """Ask it no more; may be called twice."""


class Surroundings:
    """What is around one arm. Belongs to the event loop.

    Args:
        machine: Reads the machine's components.
        sources: What else knows something.
        logger: Where to say, once, that nothing of the machine is known.
    """

    def __init__(
        self, machine: MachineBodies, sources: Sequence[Source], logger: logging.Logger
    ) -> None:
        self._machine, self._sources, self._logger = machine, tuple(sources), logger
        self._said = ""
        self._seen: float | None = None  # when the machine was read last, for led motions
        self._built: tuple[Scene, tuple[Body, ...], Scene] | None = None
        self._last: dict[tuple[Source, ...], tuple[Scene, Scene]] = {}

    def is_asked(self, also: tuple[Source, ...] = ()) -> bool:
        """Whether anything beside the arm's own scene can be known."""
        return bool(self._sources or also) or self._machine.is_asked

    async def around(self, scene: Scene, also: tuple[Source, ...] = ()) -> Scene:
        """``scene`` with what is around now.

        Raises:
            SurroundingsUnknown: That cannot be found out.
        """
        view = await self._machine.read()
        if self._machine.without and self._machine.without != self._said:
            self._logger.warning("%s: nothing of it is planned around", self._machine.without)
        self._said = self._machine.without
        try:
            now = scene
            if view.bodies:
                now = await self._with_bodies(scene, view.bodies)
            for source in (*self._sources, *also):
                now = await source.added_to(now, view)
        except ConfigError as error:
            raise SurroundingsUnknown(f"what is around the arm is not valid: {error}") from error
        self._last[also] = (scene, now)
        return now

    async def update_other_arms(self) -> None:
        """Read where the other arms of this process are, before this one moves without a plan.

        Asks the machine only if there are others and it has not been asked for a while. If it does
        not say, what was known counts, and that is logged.
        """
        now = time.monotonic()
        if not self._machine.has_company or (
            self._seen is not None and now - self._seen < _KNOWN_FOR
        ):
            return
        self._seen = now
        try:
            await self._machine.read()
        except SurroundingsUnknown as error:
            self._logger.warning("using the last known places of other arms: %s", error)

    async def _with_bodies(self, scene: Scene, bodies: tuple[Body, ...]) -> Scene:
        built = self._built
        if built is None or built[0] != scene or built[1] is not bodies:
            now = await asyncio.to_thread(scene_around, scene, bodies)
            built = self._built = (scene, bodies, now)
        return built[2]

    async def planned(
        self,
        scene: Scene,
        plan: Callable[[Scene], Awaitable[T]],
        also: tuple[Source, ...] = (),
    ) -> T:
        """What ``plan`` makes of ``scene`` with what is around now, at an arm that rests.

        Args:
            scene: What is known without asking.
            plan: Called with the scene to plan in, perhaps twice; may be cancelled.
            also: Further sources.

        Raises:
            SurroundingsUnknown: What is around cannot be found out.
            Exception: What ``plan`` raises.
        """
        if not self.is_asked(also):
            return await plan(scene)
        guess, last, company = None, self._last.get(also), self._machine.company
        is_steady = all(source.is_steady for source in (*self._sources, *also))
        if last is not None and last[0] == scene and is_steady:
            guess = asyncio.ensure_future(plan(last[1]))
        try:
            now = await self.around(scene, also)
            is_as_before = last is not None and now == last[1]
            if guess is not None and is_as_before and company == self._machine.company:
                return await guess
        finally:
            if guess is not None:
                guess.cancel()
                await asyncio.wait([guess])
                guess.cancelled() or guess.exception()  # looked at, so that nobody reports it
        return await plan(now)

    async def close(self) -> None:
        """Ask nobody any more; may be called twice."""
        for source in self._sources:
            await source.close()
