"""Collect an arm's surroundings when a plan is made.

They are the arm's configured scene, the machine's components, and the things that stores and
cameras report. Reading them takes some milliseconds, as long as a plan. So planning begins with the
last known surroundings, and the plan is used only if they are unchanged.
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
"""How long the positions of other arms may be used for streamed targets and jogs [s]; chosen."""


class Source(Protocol):
    """A store or camera that reports things around the arm."""

    @property
    def is_steady(self) -> bool:
        """Whether it reports the same while nothing changes; a camera does not."""

    async def added_to(self, scene: Scene, view: MachineView) -> Scene:
        """``scene`` with the things that it reports.

        Raises:
            SurroundingsUnknown: It does not answer.
            ConfigError: A thing that it reports is not valid.
        """

    async def close(self) -> None:
        """Stop using it; may be called twice."""


class Surroundings:
    """The surroundings of one arm. Lives in the event loop.

    Args:
        machine: Reads the machine's components.
        sources: The stores and cameras.
        logger: Gets a warning, once, if the machine's components are unknown.
    """

    def __init__(
        self, machine: MachineBodies, sources: Sequence[Source], logger: logging.Logger
    ) -> None:
        self._machine, self._sources, self._logger = machine, tuple(sources), logger
        self._said = ""
        self._seen: float | None = None  # when ``update_other_arms`` read the machine last
        self._built: tuple[Scene, tuple[Body, ...], Scene] | None = None
        self._last: dict[tuple[Source, ...], tuple[Scene, Scene]] = {}

    def is_asked(self, also: tuple[Source, ...] = ()) -> bool:
        """Whether there is more to read than the arm's own scene."""
        return bool(self._sources or also) or self._machine.is_asked

    async def around(self, scene: Scene, also: tuple[Source, ...] = ()) -> Scene:
        """``scene`` with the present surroundings.

        Raises:
            SurroundingsUnknown: They cannot be read.
        """
        view = await self._machine.read()
        if self._machine.without and self._machine.without != self._said:
            self._logger.warning(
                "%s, so the machine's components are not planned around", self._machine.without
            )
        self._said = self._machine.without
        try:
            now = scene
            if view.bodies:
                now = await self._with_bodies(scene, view.bodies)
            for source in (*self._sources, *also):
                now = await source.added_to(now, view)
        except ConfigError as error:
            raise SurroundingsUnknown(f"a thing around the arm is not valid: {error}") from error
        self._last[also] = (scene, now)
        return now

    async def update_other_arms(self) -> None:
        """Read the positions of the other arms of this process, before this one moves.

        Reads the machine only if there are others and the last reading is older than
        ``_KNOWN_FOR``. If the machine does not answer, the last positions are used, with a warning.
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
            self._logger.warning("the last known positions of the other arms are used: %s", error)

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
        """Call ``plan`` with ``scene`` and the present surroundings, for an arm at rest.

        Args:
            scene: The arm's own scene.
            plan: Called with the scene to plan in, perhaps twice; may be cancelled.
            also: Further sources.

        Returns:
            The result of ``plan``.

        Raises:
            SurroundingsUnknown: The surroundings cannot be read.
            Exception: As ``plan`` raises it.
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
                guess.cancelled() or guess.exception()  # retrieved, so that asyncio does not warn
        return await plan(now)

    async def close(self) -> None:
        """Close the sources; may be called twice."""
        for source in self._sources:
            await source.close()
