"""Collect an arm's surroundings when a plan is made: its scene, components, stores, cameras.

Reading them takes some milliseconds, as long as a plan. So planning begins with the last known
surroundings, and the plan is used only if they are unchanged. A motion of the arm begins it on its
own thread, because the event loop is busy with the reading.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Iterable, Sequence
from concurrent.futures import Future
from typing import Protocol, TypeVar

from so101_motion.common.errors import ConfigError, SurroundingsUnknown
from so101_motion.planning.collision.scene import Scene
from so101_motion.viam.surroundings.machine_bodies import MachineBodies
from so101_motion.viam.surroundings.machine_view import Body, MachineView, scene_around

T = TypeVar("T")

_KNOWN_FOR = 5.0
"""How long the positions of other arms may be used for streamed targets and jogs [s]; chosen."""


class Source(Protocol):
    """A store or camera that reports things around the arm, or raises ``SurroundingsUnknown``.

    Two with the same ``origin`` report the same; a steady one does while nothing changes.
    """

    @property
    def origin(self) -> tuple[str, ...]: ...
    @property
    def is_steady(self) -> bool: ...
    async def added_to(self, scene: Scene, view: MachineView) -> Scene: ...
    async def close(self) -> None: ...


class Surroundings:
    """The surroundings of one arm. Lives in the event loop, except ``start_planning``."""

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
        """``scene`` with the present surroundings."""
        own = {source.origin for source in self._sources}
        others = [source for source in also if source.origin not in own]
        now = await self._collected(scene, (*self._sources, *others))
        self._last[also] = (scene, now)
        return now

    async def standing(self, scene: Scene) -> Scene:
        """Like ``around``, but without what changes all the time: the points of a camera."""
        return await self._collected(scene, [each for each in self._sources if each.is_steady])

    async def _collected(self, scene: Scene, sources: Iterable[Source]) -> Scene:
        view = await self._machine.read()
        if self._machine.without and self._machine.without != self._said:
            self._logger.warning(
                "%s, so the machine's components are not planned around", self._machine.without
            )
        self._said = self._machine.without
        try:
            now, bodies, built = scene, view.bodies, self._built
            if bodies:
                if built is None or built[0] != scene or built[1] is not bodies:
                    now = await asyncio.to_thread(scene_around, scene, bodies)
                    built = self._built = (scene, bodies, now)
                now = built[2]
            for source in sources:
                now = await source.added_to(now, view)
        except ConfigError as error:
            raise SurroundingsUnknown(
                f"an obstacle around the arm is not valid: {error}"
            ) from error
        return now

    async def update_other_arms(self) -> None:
        """Read the positions of the other arms of this process, if they may be too old.

        If the machine does not answer, the last ones are used, with a warning.
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

    async def planned(
        self, scene: Scene, plan: Callable[[Scene], Awaitable[T]], also: tuple[Source, ...] = ()
    ) -> T:
        """Call ``plan``, perhaps twice, with ``scene`` and the present surroundings."""
        if not self.is_asked(also):
            return await plan(scene)
        guess = self._guess(scene, also)
        early = None if guess is None else asyncio.ensure_future(plan(guess[0]))
        try:
            now = await self.around(scene, also)
            if early is not None and guess == (now, self._machine.company):
                return await early
        finally:
            if early is not None:
                early.cancel()
                await asyncio.wait([early])
                early.cancelled() or early.exception()  # retrieved, so that asyncio does not warn
        return await plan(now)

    def start_planning(
        self,
        scene: Scene,
        plan: Callable[[Scene], Future[T]],
        wait_for: Callable[[Future[Scene]], Scene],
        loop: asyncio.AbstractEventLoop,
    ) -> Future[T]:
        """Like ``planned``, from the motion's thread; ``wait_for`` may raise to end the wait."""
        guess = self._guess(scene, ())
        early = None if guess is None else plan(guess[0])
        is_right = False
        try:
            now = wait_for(asyncio.run_coroutine_threadsafe(self.around(scene), loop))
            is_right = guess == (now, self._machine.company)
        finally:
            if early is not None and not is_right:
                early.cancel()
        return early if early is not None and is_right else plan(now)

    def _guess(self, scene: Scene, also: tuple[Source, ...]) -> tuple[Scene, object] | None:
        """The scene as last read, and ``company`` now; None if it is not known or not steady."""
        company, last = self._machine.company, self._last.get(also)
        is_steady = all(source.is_steady for source in (*self._sources, *also))
        if last is None or last[0] != scene or not is_steady:
            return None
        return last[1], company

    async def close(self) -> None:
        for source in self._sources:
            await source.close()
