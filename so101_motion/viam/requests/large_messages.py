"""Read large messages without holding up the event loop.

Protobuf decodes a message in one piece and holds the interpreter lock meanwhile: 15 ms for a mesh
of 31 MiB or for 100,000 boxes, and reading the mesh copies it once more; grpclib joins the pieces
of that mesh in one go, which takes as long again. So ``receive_in_pieces`` puts them together one
by one, and ``LargeCodec`` scans a large message before it is decoded. Large contents (meshes, point
clouds) are taken out without a copy; a short reference is decoded in their place, and
``content_of`` gives the content for it. The rest of the message has at most ``LARGEST_REST`` bytes
and ``MOST_FIELDS`` fields, or is refused before it is decoded.

The wire format: https://protobuf.dev/programming-guides/encoding
"""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable
from contextvars import ContextVar
from mmap import mmap
from typing import Any

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import DecodeError
from grpclib.encoding.proto import ProtoCodec

from so101_motion.common.errors import ConfigError

LARGE = 1 << 16
"""Messages and contents of fewer bytes are decoded as they are [byte]. Chosen."""

LARGEST_REST = 1 << 20
"""Most bytes of a message besides large contents. Chosen: a plan of a thousand steps has a tenth of
that, and protobuf takes a millisecond to decode it."""

LARGEST_STRUCT = 1 << 18
"""Most bytes of a struct. The most values that are read (``request_guard``) take 200 kB as numbers;
a text of a megabyte keeps the event loop for 10 ms."""

_PIECE = 1 << 16
"""Size of the pieces that a large message is put together from [byte]. Chosen: it takes 20 us."""

MOST_FIELDS = 5_000
"""Most fields of a large message. Chosen: they take 4 ms to scan; 1,000 geometries have fewer."""

_REFERENCE = os.urandom(16)
"""The beginning of every reference; no client can know it."""

_contents: ContextVar[list[memoryview]] = ContextVar("contents")
"""The large contents of the message that the current task has received."""

_STRUCT = "google.protobuf.Struct"
"""Counted as one field here; ``request_guard`` counts the values in it."""

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5  # wire types


async def receive_in_pieces(
    receive: Callable[[int], Awaitable[bytes]], size: int
) -> bytes | memoryview:
    """Receive ``size`` bytes without holding the interpreter lock for long.

    Args:
        receive: Receives up to the given number of bytes of a message.
        size: The number of bytes to receive.

    Returns:
        The bytes; fewer if the message ends early.
    """
    if size <= LARGE:
        return await receive(size)
    whole = memoryview(mmap(-1, size))  # its pages are made when they are written
    at = 0
    while at < size:
        piece = await receive(min(_PIECE, size - at))
        if not piece:
            break
        whole[at : at + len(piece)] = piece
        at += len(piece)
    return whole[:at]


class LargeCodec(ProtoCodec):
    """The protobuf codec of gRPC; takes large contents out of received messages."""

    def decode(self, data: bytes | memoryview, message_type: Any) -> Any:
        """Decode the message in ``data``.

        Raises:
            DecodeError: It is not valid protobuf.
            ConfigError: It has too many bytes or fields, or a struct in it is too large.
        """
        if len(data) <= LARGE:
            return message_type.FromString(data)
        contents: list[memoryview] = []
        count = _Count()
        slim = _without_contents(memoryview(data), message_type.DESCRIPTOR, contents, count)
        _contents.set(contents)
        return message_type.FromString(slim)


def content_of(value: bytes) -> bytes | memoryview:
    """The content of a field of the message that the current task has received.

    Args:
        value: The field's value: the content itself, or a reference to it.
    """
    if not value.startswith(_REFERENCE):
        return value
    return _contents.get()[int.from_bytes(value[len(_REFERENCE) :], "big")]


class _Count:
    """Counts the fields and bytes of a message, and refuses too many."""

    def __init__(self) -> None:
        self._fields = self._bytes = 0

    def add(self, size: int) -> None:
        """Count a field of ``size`` bytes."""
        self._fields += 1
        self._bytes += size
        if self._fields > MOST_FIELDS:
            raise ConfigError(
                "request", f"over {MOST_FIELDS} fields", "is more than is read; send fewer"
            )
        if self._bytes > LARGEST_REST:
            raise ConfigError(
                "request",
                f"over {LARGEST_REST} bytes besides meshes and point clouds",
                "is more than is read; send less",
            )


def _without_contents(
    data: memoryview, kind: Descriptor, contents: list[memoryview], count: _Count
) -> bytes:
    """A message with references in place of its large contents, which go into ``contents``."""
    fields = kind.fields_by_number
    kept = bytearray()
    at, end = 0, len(data)
    while at < end:
        begin = at
        tag, at = _varint(data, at)
        wire = tag & 7
        if wire != _BYTES:
            at = _after_number(data, at, wire)
            value = None
        else:
            size, at = _varint(data, at)
            value = data[at : at + size]
            at += size
        if at > end:
            raise DecodeError("a field ends behind its message")
        field = fields.get(tag >> 3)
        if value is None or len(value) <= LARGE or field is None:
            count.add(at - begin)
            kept += data[begin:at]
            continue
        kept += _encoded(tag) + _slim(value, field, contents, count)
    return bytes(kept)


def _slim(
    value: memoryview, field: FieldDescriptor, contents: list[memoryview], count: _Count
) -> bytes:
    """The replacement of a large value: its length and bytes."""
    slim: bytes | memoryview = value
    if field.type == FieldDescriptor.TYPE_BYTES:
        slim = _REFERENCE + len(contents).to_bytes(4, "big")
        contents.append(value)
        count.add(len(slim))
    elif field.message_type is None:
        count.add(len(value))
    elif field.message_type.full_name == _STRUCT:
        if len(value) > LARGEST_STRUCT:
            raise ConfigError(
                field.name,
                f"{len(value)} bytes",
                f"is more than the {LARGEST_STRUCT} bytes that are read; send less",
            )
        count.add(len(value))
    else:
        slim = _without_contents(value, field.message_type, contents, count)
    return _encoded(len(slim)) + bytes(slim)


def _after_number(data: memoryview, at: int, wire: int) -> int:
    """The position behind the number that begins ``at``."""
    if wire == _VARINT:
        return _varint(data, at)[1]
    if wire == _FIXED64:
        return at + 8
    if wire == _FIXED32:
        return at + 4
    raise DecodeError(f"no field has the wire type {wire}")


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """The number that begins ``at``, and the position behind it."""
    value = shift = 0
    try:
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value, at
            shift += 7
            if shift > 63:
                raise DecodeError("a number is longer than 10 bytes")
    except IndexError:
        raise DecodeError("a number ends behind its message") from None


def _encoded(number: int) -> bytes:
    """A number as a varint."""
    parts = bytearray()
    while number > 0x7F:
        parts.append(number & 0x7F | 0x80)
        number >>= 7
    parts.append(number)
    return bytes(parts)
