"""The connection to a running machine, and the thread that owns it.

A task on the thread's event loop, the *keeper*, dials the machine and passes the client to
``poll``, which runs as long as the machine answers. When it stops answering, the keeper drops the
client, calls ``lost`` and dials again, at first soon, then less and less often. Motions that were
under way have failed and are not repeated.

With an API key the machine is dialled as Viam's SDK does it, over TLS and, for an address in the
cloud, WebRTC; the key is never sent over a plain connection. Without a key the connection is plain
and direct, as a ``viam-server`` on this computer or without a cloud configuration needs it.
"""

from __future__ import annotations

import asyncio
import itertools
import socket
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator
from concurrent.futures import Future
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, TypeVar

from grpclib import GRPCError, Status
from grpclib.exceptions import ProtocolError, StreamTerminatedError
from viam import logging
from viam.errors import ViamError
from viam.robot.client import RobotClient
from viam.rpc.dial import DialOptions, dial

from so101_motion.common.clock import Clock
from so101_motion.common.errors import ConfigError, MachineRefused, MachineUnavailable
from so101_motion.rig.protocols import ArmConnection

T = TypeVar("T")

LOSSES = (OSError, TimeoutError, ConnectionError, ProtocolError, StreamTerminatedError, ViamError)
"""The errors of a lost connection; a machine that answers raises ``GRPCError``."""

PATIENCE = 2.0
"""How long a machine may take to report its state [s]; chosen, thrice what a bad network takes."""

DIALLING = 10.0
"""How long connecting may take [s]; chosen. WebRTC takes a few seconds."""

FIRST_PAUSE, LONGEST_PAUSE = 0.5, 10.0
"""How long to wait before dialling again [s]; it doubles from the first to the longest. Chosen."""

_numbers = itertools.count(1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """A machine's address, or host and port, and its API key; None for one that needs none."""

    address: str
    api_key_id: str | None = None
    api_key: str | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if not self.address.strip():
            raise ConfigError("address", self.address, "is empty; give host:port")
        if (self.api_key_id is None) != (self.api_key is None):
            missing = "api_key" if self.api_key is None else "api_key_id"
            raise ConfigError(missing, None, "is missing; a key and its id belong together")

    def options(self) -> RobotClient.Options:
        if self.api_key is None or self.api_key_id is None:
            dialling = DialOptions(disable_webrtc=True, insecure=True)
        else:
            try:
                dialling = DialOptions.with_api_key(self.api_key, self.api_key_id)
            except ValueError as error:
                raise ConfigError(
                    "api_key_id", self.api_key_id, "is not the id of a key, which is a UUID"
                ) from error
        dialling.initial_connection_attempts = 1  # the keeper tries again
        dialling.timeout = dialling.initial_connection_attempt_timeout = DIALLING
        return RobotClient.Options(
            dial_options=dialling,
            check_connection_interval=0,
            attempt_reconnect_interval=0,
            log_level=logging.LOG_LEVEL,  # that of every logger the SDK has made; not ours to set
        )


class Link:
    """A thread with an event loop, and the machine's client while it is connected.

    ``poll`` reads the machine as long as it answers, then raises one of ``LOSSES``; it calls its
    second argument after the first complete reading. ``lost`` is called on the loop's thread.
    """

    def __init__(
        self,
        access: Access,
        clock: Clock,
        poll: Callable[[RobotClient, Callable[[], None]], Awaitable[None]],
        lost: Callable[[str], None],
    ) -> None:
        self.access, self._clock = access, clock
        self._poll, self._lost = poll, lost
        for name, logger in logging.LOGGERS.items():
            if name.startswith("viam."):
                logger.disabled = True  # keeps the SDK's log lines off standard output
        self._options = access.options()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(
            target=self._live, name=f"so101-machine-{next(_numbers)}", daemon=True
        )
        self._client: RobotClient | None = None
        self._keeper: asyncio.Task[None] | None = None
        self._ready: Future[None] = Future()
        self.connection = ArmConnection(
            to=f"machine {access.address}", problem="not connected yet", lost_at=clock.now()
        )

    # Any thread

    def open(self) -> None:
        """Connect; returns when the machine has been read once."""
        self._thread.start()
        try:
            self._ready.result()
        except BaseException:
            self.close()
            raise

    def post(self, call: Callable[[], object]) -> None:
        """Run ``call`` on the loop's thread soon; does nothing after ``close``."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(call)

    def run(self, work: Coroutine[Any, Any, T]) -> Future[T]:
        """Run ``work`` on the loop and return its result; refused after ``close``."""
        try:
            return asyncio.run_coroutine_threadsafe(work, self._loop)
        except RuntimeError as error:
            work.close()
            raise MachineUnavailable(self.access.address, "the connection was closed") from error

    def close(self) -> None:
        """Disconnect and end the thread; may be called twice."""
        self.post(lambda: self._keeper is not None and self._keeper.cancel())
        self._thread.join()

    # The loop's thread

    def client(self) -> RobotClient:
        """The machine's client; ``MachineUnavailable`` while it is not connected."""
        if self._client is None:
            raise MachineUnavailable(self.access.address, self.connection.problem or "closed")
        return self._client

    @contextmanager
    def asking(self, what: str) -> Iterator[None]:
        """Turn the SDK's errors in this block into ours; ``what`` names the request."""
        try:
            yield
        except GRPCError as error:
            raise MachineRefused(what, error.status.name, error.message or "no reason") from error
        except LOSSES as error:
            raise MachineUnavailable(self.access.address, _why(error)) from error

    def _live(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._keeper = self._loop.create_task(self._keep())
            self._loop.run_until_complete(self._end())
        finally:
            asyncio.set_event_loop(None)
            self._loop.close()

    async def _end(self) -> None:
        """Wait until the keeper has ended, then end all other tasks."""
        assert self._keeper is not None
        await asyncio.wait([self._keeper])
        rest = asyncio.all_tasks() - {asyncio.current_task()}
        for task in rest:
            task.cancel()
        await asyncio.gather(*rest, return_exceptions=True)
        await self._loop.shutdown_asyncgens()
        await self._loop.shutdown_default_executor()

    async def _keep(self) -> None:
        pause = FIRST_PAUSE
        while True:
            try:
                async with self._dialled() as client:
                    await self._poll(client, lambda: self._connected(client))
            except LOSSES as error:
                pause = FIRST_PAUSE if self.connection.is_up else pause
                self._note_loss(_why(error))
            except Exception as error:  # at the first connection ``open`` raises it
                if self._ready.done():
                    self._note_loss(str(error))
                else:
                    self._ready.set_exception(error)
            if not self._ready.done():
                problem = self.connection.problem or "no answer"
                self._ready.set_exception(MachineUnavailable(self.access.address, problem))
            await asyncio.sleep(pause)
            pause = min(2.0 * pause, LONGEST_PAUSE)

    @asynccontextmanager
    async def _dialled(self) -> AsyncIterator[RobotClient]:
        async with asyncio.timeout(DIALLING):
            channel = await dial(self.access.address, self._options.dial_options)
        client = None
        try:
            async with asyncio.timeout(DIALLING):
                client = await RobotClient.with_channel(channel, self._options)
            yield client
        finally:
            self._client = None
            if client is not None:
                await client.close()  # type: ignore[no-untyped-call]  # the SDK's
            channel.close()  # type: ignore[no-untyped-call]  # the SDK's

    def _connected(self, client: RobotClient) -> None:
        if self._client is client:
            return
        self._client = client
        self.connection = ArmConnection(to=self.connection.to)
        if not self._ready.done():
            self._ready.set_result(None)

    def _note_loss(self, problem: str) -> None:
        since = self.connection.lost_at
        self.connection = ArmConnection(
            to=self.connection.to,
            problem=problem,
            lost_at=self._clock.now() if since is None else since,
        )
        self._client = None
        self._lost(problem)


def _why(error: BaseException) -> str:
    if type(error) is ConnectionError and error.__context__ is not None:
        error = error.__context__  # the SDK's general word hides what happened
    if isinstance(error, GRPCError) and error.status is Status.UNAUTHENTICATED:
        return "it requires a valid API key; check the key and its id"
    if isinstance(error, TimeoutError):
        reason = "it does not answer in time"
    elif isinstance(error, ConnectionRefusedError):
        reason = "no program listens at this address"
    elif isinstance(error, socket.gaierror):
        reason = "no computer of this name is known"
    elif isinstance(error, GRPCError) and error.status is Status.UNIMPLEMENTED:
        reason = "the program that answers there is not a Viam machine"
    else:
        reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
    return f"{reason}; check that the machine runs and that this is its address"
