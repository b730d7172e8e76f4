"""The bytes of a control cycle: goals as they go out, answers in what arrives; and no port.

A status packet is ``FF FF id length flags data... checksum``, where ``length`` is the number of
data bytes plus 2 and the checksum is the inverted sum of everything between header and itself.
It names the servo but neither the question nor the register. So whoever asks must know what to
expect, and takes only that: ``Answers`` looks for packets from given servos with a given number of
data bytes, and skips everything else a byte at a time: noise, broken packets, packets of other
lengths. A broken packet can therefore cost its own servo's answer and nobody else's.

``sync_write_packet`` is the one packet that the vendor's SDK does not build for us: a hundred times
a second, byte by byte, it took more time than all the rest of sending. A test compares the two.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import NamedTuple

from so101_motion.drivers.registers import BROADCAST

_SYNC_WRITE = 0x83
_HEADER = b"\xff\xff"
_OVERHEAD = 6  # header 2, id, length, flags, checksum


def packet_size(count: int) -> int:
    """Bytes of a status packet with ``count`` data bytes."""
    return count + _OVERHEAD


def checksum(body: bytes | bytearray) -> int:
    """The last byte of a packet whose bytes between header and checksum are ``body``."""
    return ~sum(body) & 0xFF


def sync_write_packet(start: int, data: Mapping[int, bytes]) -> bytes:
    """The packet that writes to several servos at once.

    Args:
        start: The first address.
        data: What to write, by servo id; the same number of bytes for each.
    """
    count = len(next(iter(data.values())))
    length = 4 + len(data) * (1 + count)
    body = bytearray((BROADCAST, length, _SYNC_WRITE, start, count))
    for servo_id, share in data.items():
        body.append(servo_id)
        body += share
    body.append(checksum(body))
    return _HEADER + bytes(body)


class Answer(NamedTuple):  # six are made in every cycle, and this is the fastest kind
    """What one servo said.

    Attributes:
        data: The bytes it was asked for.
        faults: Its status byte, see ``Fault``: true of the servo, and no blemish of the data.
    """

    data: bytes
    faults: int


class Answers:
    """Collects one question's answers from what arrives, however it is cut.

    Args:
        servo_ids: Whose answers are awaited.
        count: How many data bytes each has.

    Attributes:
        found: The answers so far, by servo id. Of two from one servo the later one counts.
        skipped: How many bytes were no part of an awaited answer.
    """

    def __init__(self, servo_ids: Collection[int], count: int) -> None:
        self.found: dict[int, Answer] = {}
        self.skipped = 0
        self._awaited, self._count, self._size = servo_ids, count, packet_size(count)
        self._buffer = bytearray()

    @property
    def is_complete(self) -> bool:
        """Whether all have answered."""
        return len(self.found) == len(self._awaited)

    @property
    def rest(self) -> bytes:
        """What has arrived and is not (yet) an answer."""
        return bytes(self._buffer)

    def feed(self, data: bytes) -> None:
        """Take in what has arrived."""
        buffer, size = self._buffer, self._size
        buffer += data
        begin = 0
        while True:
            start = buffer.find(_HEADER, begin)
            if start < 0:  # the last byte may be the first half of a header
                start = max(len(buffer) - 1, begin) if buffer.endswith(b"\xff") else len(buffer)
            self.skipped += start - begin
            begin = start
            if len(buffer) - begin < size:
                break
            if self._take(bytes(buffer[begin + 2 : begin + size])):
                begin += size
            else:
                begin += 1
                self.skipped += 1
        del buffer[:begin]

    def _take(self, packet: bytes) -> bool:
        """Take in what follows a header, if it is an awaited answer."""
        servo_id = packet[0]
        if servo_id not in self._awaited or packet[1] != self._count + 2:
            return False
        if sum(packet) & 0xFF != 0xFF:  # as it must be together with its checksum
            return False
        self.found[servo_id] = Answer(packet[3:-1], packet[2])
        return True
