"""Serve the emulated bus on a pseudo-terminal.

One thread waits for bytes, hands them to the bus and writes the replies when they are due. In real
time that is when the last byte would have left the wire; otherwise at once. On top comes the
adapter's latency: like a USB adapter it holds what it received until that long after the first
byte, and then hands over everything it has by then.

A client's baud rate is read back from the terminal, so a client at the wrong rate is not heard, and
a reply that comes after it has changed its rate is lost.
Unplugging closes the pseudo-terminal while a client may have it open; plugging in opens another,
usually under another name, and ``link`` follows it.

The thread keeps the client's side open too, so that settings survive between clients. So would an
exclusive lock (TIOCEXCL) of a client that died: where inotify can tell when the last client closes,
the lock is lifted then. All of this is Linux.
"""

from __future__ import annotations

import contextlib
import ctypes
import heapq
import math
import os
import select
import struct
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from so101_motion.common.errors import ConfigError
from so101_motion.common.realtime import use_realtime_priority
from so101_motion.drivers.emulator.bus import Bus, Reply

if sys.platform != "win32":
    import fcntl
    import termios
    import tty

FASTEST = 1_000_000
"""Baud rate of the port before a client sets it [bit/s]."""

_TCGETS2, _TCSETS2 = 0x802C542A, 0x402C542B
_BOTHER, _CBAUD = 0o010000, 0o010017
_IN_CLOSE, _IN_OPEN = 0x18, 0x20
_CHUNK = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class Pacing:
    """Delays with which replies reach the client."""

    realtime: bool = False  # whether bytes take the time they would take on the wire
    latency: float = 0.0  # how long the adapter holds received bytes [s]


class _Terminal:
    """Both ends of one pseudo-terminal."""

    def __init__(self) -> None:
        if sys.platform == "win32":
            raise ConfigError(
                "emulate", None, "needs a pseudo-terminal, and Windows has none; use WSL2"
            )
        self.master, self._client_side = os.openpty()
        tty.setraw(self._client_side)
        self.name = os.ttyname(self._client_side)
        os.set_blocking(self.master, False)
        self._set_fastest()
        self.watch = _watch(self.name)
        self._clients = 0
        self._settings = bytearray(44)

    def _set_fastest(self) -> None:
        settings = bytearray(44)
        fcntl.ioctl(self.master, _TCGETS2, settings)
        flags = struct.unpack_from("I", settings, 8)[0]
        struct.pack_into("I", settings, 8, flags & ~_CBAUD | _BOTHER)
        struct.pack_into("II", settings, 36, FASTEST, FASTEST)
        fcntl.ioctl(self.master, _TCSETS2, settings)

    def baud(self) -> int:
        fcntl.ioctl(self.master, _TCGETS2, self._settings)
        return int.from_bytes(self._settings[40:44], sys.byteorder)

    def clients_changed(self) -> None:
        """Read the events of ``watch``; lift the exclusive lock when the last client has closed."""
        assert self.watch is not None
        events = os.read(self.watch, _CHUNK)
        while events:
            mask, length = (
                struct.unpack_from("II", events, 4)[0],
                struct.unpack_from("I", events, 12)[0],
            )
            self._clients += bool(mask & _IN_OPEN) - bool(mask & _IN_CLOSE)
            events = events[16 + length :]
            if self._clients <= 0:
                self._clients = 0
                fcntl.ioctl(self._client_side, termios.TIOCNXCL)

    def close(self) -> None:
        for fd in (self.master, self._client_side, self.watch):
            if fd is not None:
                os.close(fd)


def _watch(path: str) -> int | None:
    libc = ctypes.CDLL(None, use_errno=True)
    if not hasattr(libc, "inotify_init1"):
        return None
    fd = int(libc.inotify_init1(os.O_CLOEXEC))
    if fd >= 0 and libc.inotify_add_watch(fd, os.fsencode(path), _IN_OPEN | _IN_CLOSE) >= 0:
        return fd
    if fd >= 0:
        os.close(fd)
    return None


class PtyPort:
    """Serves a bus on a pseudo-terminal, to whose present name ``link`` leads if it is given.

    ``now`` is the emulator's clock [s]. ``received`` counts the bytes that clients sent,
    ``delivered`` those handed to them. They open ``port``: the link if there is one, else the
    terminal's name.
    """

    def __init__(
        self,
        bus: Bus,
        now: Callable[[], float],
        *,
        pacing: Pacing,
        link: Path | None = None,
    ) -> None:
        self._bus, self._now, self._pacing, self._link = bus, now, pacing, link
        self._wake_read, self._wake_write = os.pipe()
        self._due: list[tuple[float, int, bytes, int]] = []  # ready time, order, bytes, baud rate
        self._order = count()
        self._wire_free = 0.0
        self._lock = threading.Lock()
        self._closing = False
        self._is_left_to_client = False
        self.received = self.delivered = 0
        self._terminal: _Terminal | None = None
        self.plug()
        self._thread = threading.Thread(target=self._serve, name="so101-emulator-port", daemon=True)
        self._thread.start()

    @property
    def device(self) -> str:
        return self._terminal.name if self._terminal is not None else ""

    @property
    def port(self) -> str:
        if self._link is not None:
            return str(self._link)
        return self.device

    # -- from outside ---------------------------------------------------------------------------

    def plug(self) -> None:
        with self._lock:
            if self._terminal is not None:
                return
            self._terminal = _Terminal()
            if self._link is not None:
                fresh = self._link.with_name(f".{self._link.name}.{os.getpid()}")
                fresh.symlink_to(self._terminal.name)
                fresh.replace(self._link)
        self._wake()

    def unplug(self) -> None:
        with self._lock:
            terminal, self._terminal = self._terminal, None
            self._due.clear()
            if terminal is not None:
                link = self._link  # by now it may lead to another emulator
                if link and link.is_symlink() and str(link.readlink()) == terminal.name:
                    link.unlink()
                terminal.close()
        self._wake()

    def leave_to_client(self, *, left: bool) -> None:
        """Let a client of this process call ``serve_now``, or the thread serve clients again.

        Returns once ``delivered`` counts all that former clients were handed.
        """
        with self._lock:
            self._is_left_to_client = left
        self._wake()

    def serve_now(self) -> float:
        """Answer written bytes in the calling thread; return when the next reply is due.

        By ``time.monotonic`` [s]; infinite when none is due.
        """
        with self._lock:
            if self._terminal is not None:
                with contextlib.suppress(BlockingIOError):
                    self._receive(self._terminal)
                self._deliver(self._terminal)
            due = self._due[0][0] + self._pacing.latency if self._due else math.inf
        if due < math.inf:
            self._wake()  # the thread delivers it
        return due

    def close(self) -> None:
        self._closing = True
        self._wake()
        self._thread.join()
        self.unplug()
        os.close(self._wake_read)
        os.close(self._wake_write)

    def _wake(self) -> None:
        os.write(self._wake_write, b"\0")

    # -- the thread -----------------------------------------------------------------------------

    def _serve(self) -> None:
        if self._pacing.realtime:
            use_realtime_priority()  # servos do not wait until a busy computer has time for them
        while not self._closing:
            with self._lock:
                terminal, sources = self._terminal, self._sources()
                timeout = self._next_delivery()
            # An unplugged terminal's descriptor may be gone by now: then look again.
            with contextlib.suppress(OSError, ValueError):
                while True:
                    readable = select.select(sources, [], [], timeout)[0]
                    if self._wake_read in readable:
                        os.read(self._wake_read, _CHUNK)
                        break
                    timeout = self._handle(terminal, readable)

    def _sources(self) -> list[int]:
        sources, terminal = [self._wake_read], self._terminal
        if terminal is not None and not self._is_left_to_client:
            sources.append(terminal.master)
        if terminal is not None and terminal.watch is not None:
            sources.append(terminal.watch)
        return sources

    def _handle(self, terminal: _Terminal | None, readable: list[int]) -> float | None:
        with self._lock:
            if terminal is not None and terminal is self._terminal:
                if readable and terminal.watch in readable:
                    terminal.clients_changed()
                if readable and terminal.master in readable:
                    self._receive(terminal)
                self._deliver(terminal)
            return self._next_delivery()

    def _receive(self, terminal: _Terminal) -> None:
        arrival = time.monotonic()
        data = os.read(terminal.master, _CHUNK)
        self.received += len(data)
        baud = terminal.baud()
        replies = self._bus.feed(data, self._now(), baud=baud)
        start = max(arrival, self._wire_free)
        for reply in replies:
            ready = self._ready(reply, start if self._pacing.realtime else arrival)
            heapq.heappush(self._due, (ready, next(self._order), reply.data, baud))
        if replies:
            self._wire_free = start + max(reply.after for reply in replies)

    def _ready(self, reply: Reply, start: float) -> float:
        return start + reply.held + (reply.after if self._pacing.realtime else 0.0)

    def _next_delivery(self) -> float | None:
        """Seconds until the adapter delivers bytes, None if it holds none."""
        if not self._due:
            return None
        return max(self._due[0][0] + self._pacing.latency - time.monotonic(), 0.0)

    def _deliver(self, terminal: _Terminal) -> None:
        now = time.monotonic()
        if not self._due or self._due[0][0] + self._pacing.latency > now:
            return
        ready, hears = b"", terminal.baud()
        while self._due and self._due[0][0] <= now:
            _, _, data, baud = heapq.heappop(self._due)
            if baud == hears:  # a client that has changed its rate meanwhile hears noise
                ready += data
        # A client that never reads overruns its buffer, as on a real port.
        with contextlib.suppress(BlockingIOError):
            self.delivered += os.write(terminal.master, ready)
