"""Messages between this process and the planning process: a kind, and any number of parts.

A request and its answer are pickled. Large arrays are parts of their own, so that neither end
copies them while it holds the interpreter lock.
"""

from __future__ import annotations

import pickle
import select
import socket
import struct
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any

Part = bytes | bytearray | memoryview

_LARGE = 16_384  # arrays of at least so many bytes are parts of their own; chosen

_HEAD = struct.Struct("<BI")  # kind, number of parts
_SIZE = struct.Struct("<Q")


class Kind(IntEnum):
    """What a message is about."""

    READY = 1
    """The child has loaded everything; it holds an error instead of None if it could not."""
    REQUEST = 2
    GIVE_UP = 3
    """The last request is not wanted any more."""
    ALIVE = 4
    """The child is still working."""
    ANSWER = 5
    """A plan, an error, or None for what was given up."""
    COPY = 6
    """The child shall make a copy of itself, which answers on the socket that comes next."""


def packed(value: object) -> list[Part]:
    arrays: list[Part] = []

    def stays(array: pickle.PickleBuffer) -> bool:
        raw = array.raw()
        if raw.nbytes >= _LARGE:
            arrays.append(raw)
        return raw.nbytes < _LARGE

    return [pickle.dumps(value, pickle.HIGHEST_PROTOCOL, buffer_callback=stays), *arrays]


def unpacked(parts: Sequence[Part]) -> Any:
    """What ``packed`` packed at the other end."""
    # Read-only, so that the arrays made from them are.
    return pickle.loads(parts[0], buffers=[memoryview(each).toreadonly() for each in parts[1:]])


Wait = Callable[[bool], None]
"""Waits until the other end takes more (True) or sends more (False); raises to end that."""


class MessageSocket:
    """One end of the socket. ``wait`` waits for the other end; as long as it takes if not given."""

    def __init__(self, end: socket.socket, wait: Wait | None = None) -> None:
        end.setblocking(False)
        self._end = end
        self._wait = wait or self._forever

    def fileno(self) -> int:
        return self._end.fileno()

    def send(self, kind: Kind, parts: Sequence[Part] = ()) -> None:
        """Send a message; ``OSError`` if the other end is gone."""
        views = [memoryview(part).cast("B") for part in parts]
        head = _HEAD.pack(kind, len(views)) + b"".join(_SIZE.pack(len(view)) for view in views)
        for view in (memoryview(head), *views):
            sent = 0
            while sent < len(view):
                try:
                    sent += self._end.send(view[sent:])
                except BlockingIOError:
                    self._wait(True)

    def send_copy(self, line: socket.socket) -> None:
        """Ask the other end for a copy of itself that answers on ``line``; never waits.

        ``OSError`` if the other end is gone, or takes nothing at present.
        """
        head = _HEAD.pack(Kind.COPY, 0)
        if self._end.send(head) < len(head):
            raise BrokenPipeError("the other end takes nothing")
        socket.send_fds(self._end, [b"\0"], [line.fileno()])

    def receive_line(self) -> socket.socket:
        """The socket that comes behind ``Kind.COPY``."""
        while not self.has_more():
            self._wait(False)
        _, (line,), _, _ = socket.recv_fds(self._end, 1, 1)
        return socket.socket(fileno=line)

    def receive(self) -> tuple[Kind, list[bytearray]]:
        """The next message; ``EOFError`` if the other end is gone."""
        kind, count = _HEAD.unpack(self._received(_HEAD.size))
        sizes = self._received(count * _SIZE.size)
        return Kind(kind), [self._received(size) for (size,) in _SIZE.iter_unpack(sizes)]

    def has_more(self) -> bool:
        """Whether there is something to receive, or the other end is gone; never waits."""
        return bool(select.select([self._end], [], [], 0.0)[0])

    def close(self) -> None:
        self._end.close()

    def _received(self, size: int) -> bytearray:
        data = bytearray(size)
        view, got = memoryview(data), 0
        while got < size:
            try:
                count = self._end.recv_into(view[got:])
            except BlockingIOError:
                self._wait(False)
                continue
            except ConnectionError as error:
                raise EOFError("the other end is gone") from error
            if count == 0:
                raise EOFError("the other end is gone")
            got += count
        return data

    def _forever(self, for_writing: bool) -> None:
        select.select([] if for_writing else [self._end], [self._end] if for_writing else [], [])
