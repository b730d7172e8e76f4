"""Follow a world-state store, so that a plan uses its present content.

The store's stream reports what comes, changes and goes; the earlier content is read once the stream
is open. A thing whose change is incomplete is read again. Now and then everything is, because a
stream may lose a change without a word: a store that has one queue of changes for all its readers,
as viam-server's own fake one, gives each to one only. The transforms of
``devrel:so101:world-state`` are no obstacles; they are recognised by their ids.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncGenerator, Awaitable, Iterable
from contextlib import aclosing, suppress
from typing import TypeVar, cast

from grpclib import GRPCError
from grpclib.exceptions import StreamTerminatedError
from viam.proto.common import Transform, WorldState
from viam.proto.service.worldstatestore import StreamTransformChangesResponse, TransformChangeType
from viam.services.worldstatestore import WorldStateStore

from so101_motion.common.errors import ConfigError, SurroundingsUnknown
from so101_motion.planning.collision.scene import Scene
from so101_motion.viam.conversion.geometries import is_ours
from so101_motion.viam.conversion.world_state import MOST_THINGS, UniqueNames, scene_with
from so101_motion.viam.surroundings.machine_bodies import LONGEST_READ
from so101_motion.viam.surroundings.machine_view import MachineView

_AGAIN = 0.2  # pause before a store that failed is read again [s]; chosen

_READ_AGAIN, _EACH = 5.0, 0.1
"""Least time between two readings of everything, and for each thing there is [s]. Chosen: reading
one takes a millisecond of viam-server, of the store and of this process."""

_GONE = (GRPCError, StreamTerminatedError, OSError, TimeoutError, asyncio.IncompleteReadError)

T = TypeVar("T")


class StoreWatch:
    """Keeps the content of a world-state store up to date."""

    is_steady = True

    def __init__(
        self,
        name: str,
        store: WorldStateStore | None,
        logger: logging.Logger,
    ) -> None:
        self._name, self._store, self._logger = name, store, logger
        self.origin = ("world_state_store", name)
        self._things: dict[bytes, Transform] = {}
        self._trouble = "does not run"
        self._known = asyncio.Event()
        self._following = asyncio.ensure_future(self._follow()) if store is not None else None

    async def added_to(self, scene: Scene, view: MachineView) -> Scene:
        if self._store is None:
            raise self._unknown("does not run")
        try:
            async with asyncio.timeout(LONGEST_READ):
                await self._known.wait()
        except TimeoutError as error:
            raise self._unknown(self._trouble) from error
        world = WorldState(transforms=self._named_apart(view))
        try:
            return await scene_with(scene, world, view.frames(world.transforms))
        except ConfigError as error:
            raise self._unknown(f"has something that is not valid: {error}") from error

    def _named_apart(self, view: MachineView) -> list[Transform]:
        """The things with unique names; in a store only their ids are unique."""
        names = UniqueNames(taken=view.own_frames)
        apart = []
        for thing in self._things.values():
            if not is_ours(thing):
                name = names.new(thing.reference_frame)
                if name != thing.reference_frame:
                    copy = Transform()
                    copy.CopyFrom(thing)
                    copy.reference_frame = name
                    thing = copy
                apart.append(thing)
        return apart

    async def close(self) -> None:
        if self._following is not None:
            self._following.cancel()
            with suppress(asyncio.CancelledError):
                await self._following

    def _unknown(self, why: str) -> SurroundingsUnknown:
        return SurroundingsUnknown(
            f'the world-state store "{self._name}" {why}',
            remedy="fix that, or remove the store from the configuration",
        )

    async def _follow(self) -> None:
        store, said = self._store, ""
        assert store is not None, "started only with a store"
        while True:
            try:
                await self._follow_once(store)
                self._trouble = "has ended its stream of changes"
            except _GONE as error:
                reason = error.message if isinstance(error, GRPCError) else str(error)
                self._trouble = f"does not answer: {reason or type(error).__name__}"
            self._known.clear()
            if self._trouble != said:
                self._logger.warning('the world-state store "%s" %s', self._name, self._trouble)
                said = self._trouble
            await asyncio.sleep(_AGAIN)

    async def _follow_once(self, store: WorldStateStore) -> None:
        # The SDK declares its async generator as a coroutine that returns one.
        opened = cast(
            AsyncGenerator[StreamTransformChangesResponse, None], store.stream_transform_changes()
        )
        arrived: list[StreamTransformChangesResponse] = []
        heard = asyncio.Event()

        async def listen() -> None:
            try:
                async with aclosing(opened) as stream:
                    async for change in stream:
                        arrived.append(change)
                        self._known.clear()  # until the change has been applied
                        heard.set()
            finally:
                heard.set()

        listening = asyncio.ensure_future(listen())
        try:
            await asyncio.sleep(0)  # so that the stream is requested before the list
            now, read_at = asyncio.get_running_loop().time, 0.0
            while arrived or not listening.done():
                heard.clear()
                if now() >= read_at:
                    await self._read_all(store)
                    read_at = now() + max(_READ_AGAIN, _EACH * len(self._things))
                changes, arrived[:] = arrived[:], []
                await self._take(store, changes)
                if not arrived:
                    self._trouble = "is being read"
                    self._known.set()
                with suppress(TimeoutError):
                    async with asyncio.timeout(read_at - now()):
                        await heard.wait()
            await listening  # raises its error
        finally:
            listening.cancel()
            with suppress(asyncio.CancelledError, *_GONE):
                await listening

    async def _take(
        self, store: WorldStateStore, changes: Iterable[StreamTransformChangesResponse]
    ) -> None:
        """Apply changes in their order; what they do not say is read once, after all of them."""
        incomplete = set[bytes]()
        is_all = False
        for change in changes:
            thing = change.transform
            incomplete.discard(thing.uuid)
            if change.change_type == TransformChangeType.TRANSFORM_CHANGE_TYPE_REMOVED:
                self._things.pop(thing.uuid, None)
            elif not thing.uuid:  # viam-server's first message, sent when it has dropped a change
                is_all = True
            elif (
                thing.reference_frame
                and thing.HasField("pose_in_observer_frame")
                and thing.HasField("physical_object")
            ):
                self._things[thing.uuid] = thing
            else:
                incomplete.add(thing.uuid)
        await (self._read_all(store) if is_all else self._read_those(store, incomplete))

    async def _read_all(self, store: WorldStateStore) -> None:
        listed = await self._listed(store)
        for gone in self._things.keys() - listed:
            del self._things[gone]
        await self._read_those(store, listed)

    async def _listed(self, store: WorldStateStore) -> set[bytes]:
        try:
            listed = set(await _in_time(store.list_uuids()))
        except GRPCError as error:
            if "nil response" not in (error.message or ""):  # viam-server's error for an empty list
                raise
            return set()
        if len(listed) > MOST_THINGS:
            return set(sorted(listed)[: MOST_THINGS + 1])  # one too many: ``scene_with`` refuses
        return listed

    async def _read_those(self, store: WorldStateStore, uuids: Iterable[bytes]) -> None:
        await asyncio.gather(*(self._read(store, uuid) for uuid in sorted(uuids)))

    async def _read(self, store: WorldStateStore, uuid: bytes) -> None:
        try:
            thing = await _in_time(store.get_transform(uuid))
        except GRPCError:
            if uuid in await self._listed(store):
                raise
            self._things.pop(uuid, None)
        else:
            self._things[uuid] = thing


async def _in_time(asked: Awaitable[T]) -> T:
    async with asyncio.timeout(LONGEST_READ):
        return await asked
