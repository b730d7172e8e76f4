"""Keep requests from holding up the event loop, which answers Stop.

- A message that is too large is refused before it is received: protobuf decodes it in one piece and
  holds the interpreter lock meanwhile. One whose structs (``extra``, ``command``) are too large or
  have too many values is refused, because the SDK converts them on the event loop.
- Error messages are cut to a length that gRPC can encode without delay.
- Of calls that arrive together one is begun in each turn of the loop, Stops before them.
- A connection has room for more calls than a client may keep open, and each call has its own
  buffer, so that a Stop never waits behind calls that stay open (``_RoomForStop``).
- A request to a component or a service is marked, so that a stop that comes while it is prepared
  ends it (``arm/stop_order.py``).
- Requests leave no reference cycles behind: with 200 clients the garbage collector had 45,000
  objects to free and stopped every thread for 90 ms.
"""

from __future__ import annotations

from asyncio import BaseTransport
from collections.abc import Awaitable, Callable, Iterable
from functools import partial
from numbers import Real
from typing import Any
from weakref import WeakKeyDictionary

import viam.utils
from google.protobuf.message import DecodeError, Message
from google.protobuf.struct_pb2 import Struct, Value
from grpclib import GRPCError, Status
from grpclib.config import Configuration
from grpclib.events import RecvRequest, listen
from grpclib.protocol import Connection, H2Protocol
from grpclib.server import Handler, Stream
from h2.settings import SettingCodes
from viam.rpc.server import Server

from so101_motion.arm.stop_order import mark_request
from so101_motion.common.errors import ConfigError
from so101_motion.viam.conversion.convert import grpc_statuses, on_the_wire
from so101_motion.viam.requests.await_motion import TurnQueue

LARGEST = 1 << 24
"""Most bytes of a message. Chosen: a million points have 16 MB, as have 300,000 triangles. A mesh
of that size takes 0.5 ms to decode, a struct 26 ms."""

LARGEST_STRUCT = 1 << 18
"""Most bytes of a struct. The most values that are read take 200 kB as numbers; a text of a
megabyte keeps the event loop for 10 ms."""

MOST_VALUES = 10_000
"""Most values in the structs of a request. Chosen: the SDK takes 15 ms to read so many."""

_SMALL = 2_000  # structs of fewer bytes than this have few values; they are not counted

DEEPEST = 32
"""Most levels of nested structs: protobuf gives up at 100 messages, and a level has three."""

MOST_OPEN = 2_000
"""Most calls that a connection keeps open, Stops not counted. Chosen: viam-server has one
connection for all its clients, and passes on a hundred calls to each resource."""

_MOST_STREAMS = 2**31 - 1
"""How many calls a client may begin: HTTP/2's largest. A client that has reached the limit waits
and tells nobody, so the limit here is ``MOST_OPEN``, which is answered, and which Stop passes."""

_WINDOW, _CONNECTION_WINDOW = 2**18, 2**31 - 1
"""How much a client may send before it is read, in one call and in all [byte]. Chosen: all calls
together cannot use up the connection's window, which the message of a Stop needs as well."""

_STOP = "/Stop"  # how the names of the methods end that never wait for other calls

_MOVING = ("/viam.component.", "/viam.service.")
"""How the names of the methods begin that may move something for a client; those that configure the
module do not."""


def guard(server: Server) -> None:
    """Check every call of ``server``; call it before the server serves."""
    inner = server._server  # the SDK has no interface for either
    inner._config = Configuration(
        http2_stream_window_size=_WINDOW, http2_connection_window_size=_CONNECTION_WINDOW
    ).__for_server__()
    _make_room(inner)
    Handler.__gc_interval__ = 1  # a connection drops a request at the next one, not at the tenth
    listen(inner, RecvRequest, _Guard().check)
    convert_answers_fast()


def _make_room(server: Any) -> None:
    """Let each client of a server begin as many calls as HTTP/2 can count."""
    factory = server._protocol_factory

    def protocol() -> H2Protocol:
        made = factory()
        return _RoomForStop(made.handler, made.config, made.h2_config)

    server._protocol_factory = protocol


class _RoomForStop(H2Protocol):
    """A connection whose client may begin ``_MOST_STREAMS`` calls: grpclib cannot be told."""

    def connection_made(self, transport: BaseTransport) -> None:
        super().connection_made(transport)
        room: dict[SettingCodes | int, int] = {SettingCodes.MAX_CONCURRENT_STREAMS: _MOST_STREAMS}
        self.connection._connection.update_settings(room)
        self.connection.flush()


def convert_answers_fast() -> None:
    """Make the SDK recognise the numbers of an answer by their class.

    It checks them against a protocol of ``typing``, for which Python 3.11 inspects every method
    each time: 17 us a number on the event loop, 4 ms for the preview of a plan; with this, 3 us.
    """
    viam.utils.SupportsFloat = Real  # type: ignore[attr-defined]
    viam.utils.SupportsBytes = bytes  # type: ignore[attr-defined]


class _Guard:
    def __init__(self) -> None:
        self._turns = TurnQueue()
        self._open: WeakKeyDictionary[Connection, int] = WeakKeyDictionary()

    async def check(self, event: RecvRequest) -> None:
        answer, path = event.method_func, event.method_name

        async def answered(stream: Stream[Any, Any]) -> None:
            receive, transport = stream.recv_message, stream._stream
            transport.recv_data = partial(_at_most, transport.recv_data)  # type: ignore[method-assign]

            async def received() -> Any:
                return await _received(receive)

            stream.recv_message = received  # type: ignore[method-assign]  # as the SDK does it
            waits = path.startswith(_MOVING) and not path.endswith(_STOP)
            if path.startswith(_MOVING):
                mark_request()
            try:
                if waits:
                    await self._among_others(partial(answer, stream), transport.connection)
                else:
                    await answer(stream)
            except GRPCError as error:
                message = None if error.message is None else on_the_wire(error.message)
                raise GRPCError(error.status, message, error.details) from error
            finally:  # otherwise the streams refer to themselves until the garbage collector runs
                del stream.recv_message, transport.recv_data

        event.method_func = answered

    async def _among_others(self, run: Callable[[], Awaitable[None]], on: Connection) -> None:
        """Begin a call when its turn comes, if its connection has not too many already."""
        if self._open.get(on, 0) >= MOST_OPEN:
            reason = f"{MOST_OPEN} calls of this connection are open already; end some first"
            raise GRPCError(Status.RESOURCE_EXHAUSTED, reason)
        self._open[on] = self._open.get(on, 0) + 1
        try:
            await self._turns.passed()
            await run()
        finally:
            self._open[on] -= 1


async def _at_most(receive: Callable[[int], Awaitable[bytes]], size: int) -> bytes:
    if size > LARGEST:
        reason = f"is more than the {LARGEST} bytes that are read; send less"
        raise ConfigError("request", f"{size} bytes", reason)
    return await receive(size)


async def _received(receive: Callable[[], Awaitable[Any]]) -> Any:
    with grpc_statuses():
        try:
            message = await receive()
        except DecodeError as error:
            raise GRPCError(
                Status.INVALID_ARGUMENT,
                "the request cannot be read: it is not valid protobuf, or structs in it are"
                f" nested more than {DEEPEST} deep; send it with fewer levels",
            ) from error
        except NotImplementedError as error:  # grpclib's only one
            raise GRPCError(
                Status.UNIMPLEMENTED,
                "the request is compressed, which this module does not read; switch compression"
                " off in the client",
            ) from error
        check_size(message)
    return message


def check_size(message: Message | None) -> None:
    for field, value in message.ListFields() if message is not None else ():
        if not isinstance(value, Struct):
            continue
        size = value.ByteSize()
        if size > LARGEST_STRUCT:
            reason = f"is more than the {LARGEST_STRUCT} bytes that are read; send less"
            raise ConfigError(field.name, f"{size} bytes", reason)
        if size > _SMALL and _has_more_values(value, MOST_VALUES):
            raise ConfigError(
                field.name, f"{size} bytes", f"has more than the {MOST_VALUES} values that are read"
            )


def _has_more_values(struct: Struct, most: int) -> bool:
    todo: list[Iterable[Value]] = [struct.fields.values()]
    count = 0
    while todo:
        for value in todo.pop():
            count += 1
            if count > most:
                return True
            kind = value.WhichOneof("kind")
            if kind == "struct_value":
                todo.append(value.struct_value.fields.values())
            elif kind == "list_value":
                todo.append(value.list_value.values)
    return False
