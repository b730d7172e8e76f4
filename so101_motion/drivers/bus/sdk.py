"""Run the vendor's SDK on our serial port.

``feetech-servo-sdk`` builds packets and runs transactions over a port handler. Its own handler
spins on the processor while it waits, and never discards stale input, so it takes a late answer for
the answer to the next question. ``WaitingHandler`` replaces it and has the same methods.
"""

from __future__ import annotations

import time
from functools import lru_cache
from typing import Protocol

import scservo_sdk


class Port(Protocol):
    """An open serial port. Every method may raise ``PortUnavailable``."""

    @property
    def name(self) -> str:
        """Name of the port."""

    @property
    def baud(self) -> int:
        """Baud rate [bit/s]."""

    def write(self, data: bytes) -> None:
        """Send ``data``."""

    def read(self, until: float) -> bytes:
        """Read received bytes; none if none came by ``until``, on ``time.monotonic`` [s]."""

    def discard(self) -> None:
        """Discard received bytes."""

    def close(self) -> None:
        """Close the port."""


class WaitingHandler(scservo_sdk.PortHandler):  # type: ignore[misc]  # the SDK ships no types
    """The SDK's port handler on our port: waits instead of spinning, and discards stale input.

    Attributes:
        reply_timeout: How long to wait for an answer beyond the time on the wire [s].
    """

    def __init__(self, port: Port, reply_timeout: float) -> None:
        super().__init__(port.name)
        self._port, self.reply_timeout = port, reply_timeout
        self._until = 0.0
        self._is_silent = False
        self._ahead = b""

    def clearPort(self) -> None:
        """Discard stale input."""
        self._ahead = b""
        self._port.discard()

    def writePort(self, packet: list[int]) -> int:
        """Send a packet; return the number of bytes sent."""
        self._port.write(bytes(packet))
        return len(packet)

    def readPort(self, length: int) -> bytes:
        """Read at most ``length`` bytes; waits for the first until the timeout."""
        if length <= 0:
            return b""
        if not self._ahead:
            self._ahead = self._port.read(self._until)
            self._is_silent = not self._ahead
        data, self._ahead = self._ahead[:length], self._ahead[length:]
        return data

    def setPacketTimeout(self, packet_length: int) -> None:
        """Start the timeout for ``packet_length`` bytes."""
        wire = 10.0 * packet_length / self._port.baud
        self._until, self._is_silent = time.monotonic() + wire + self.reply_timeout, False

    def isPacketTimeout(self) -> bool:
        """Whether the timeout has passed, or nothing came by it."""
        return self._is_silent or time.monotonic() >= self._until


class _Recorder(scservo_sdk.PortHandler):  # type: ignore[misc]  # the SDK ships no types
    """A port handler that keeps the packet instead of sending it."""

    def clearPort(self) -> None:
        """There is no port."""

    def writePort(self, packet: list[int]) -> int:
        """Keep the packet."""
        self.packet = bytes(packet)
        return len(packet)


@lru_cache(maxsize=64)
def sync_read_packet(servo_ids: tuple[int, ...], start: int, count: int) -> bytes:
    """The sync read packet that the SDK builds; cached, because each cycle sends the same few."""
    recorder = _Recorder("")
    scservo_sdk.PacketHandler(0).syncReadTx(recorder, start, count, servo_ids, len(servo_ids))
    return recorder.packet
