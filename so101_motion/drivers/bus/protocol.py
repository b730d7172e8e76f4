"""Encode instructions and decode status packets; no port here.

A status packet is ``FF FF id length flags data... checksum``, where ``length`` is the number of
data bytes plus 2 and the checksum is the inverted sum of everything between header and itself.
It names the servo but neither the question nor the register. ``Answers`` therefore looks for
packets from given servos with a given number of data bytes, and skips everything else a byte at a
time. A broken packet can cost its own servo's answer and no other.

The checksum alone does not reveal a packet that broke off. If the next packet follows at once, the
FF FF of its header stands in the place of the missing bytes, and for one value in 256 the checksum
is right. So a packet that contains the beginning of another is refused (``is_cut_short``), and an
answer whose checksum FF turns out to be the first byte of the next header is taken back.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Container, Iterator, Mapping
from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple

from so101_motion.drivers.bus.registers import BROADCAST

_HEADER = b"\xff\xff"
_OVERHEAD = 6  # header 2, id, length, flags, checksum


class Instruction(IntEnum):
    """The instructions that the driver sends (STS memory table and protocol manual)."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


def packet_size(count: int) -> int:
    return count + _OVERHEAD


def checksum(body: bytes | bytearray) -> int:
    return ~sum(body) & 0xFF


def is_cut_short(packet: bytes, servo_ids: Container[int]) -> bool:
    """Whether ``packet``, whose checksum is right, broke off and ends with the next one's bytes.

    ``servo_ids`` are those whose packets may have followed.
    """
    at = packet.find(_HEADER, 2)
    while at >= 0:
        if at + 2 == len(packet) or packet[at + 2] in servo_ids:
            return True
        at = packet.find(_HEADER, at + 1)
    return False


def instruction_packet(servo_id: int, instruction: Instruction, params: bytes = b"") -> bytes:
    body = bytes((servo_id, len(params) + 2, instruction)) + params
    return _HEADER + body + bytes((checksum(body),))


@lru_cache(maxsize=64)  # each control cycle asks the same few questions
def sync_read_packet(servo_ids: tuple[int, ...], start: int, count: int) -> bytes:
    """The packet that asks several servos at once for ``count`` bytes from address ``start``."""
    return instruction_packet(BROADCAST, Instruction.SYNC_READ, bytes((start, count, *servo_ids)))


def sync_write_packet(start: int, data: Mapping[int, bytes]) -> bytes:
    """The packet that writes each servo's bytes, equally many, from address ``start``."""
    params = bytearray((start, len(next(iter(data.values())))))
    for servo_id, share in data.items():
        params.append(servo_id)
        params += share
    return instruction_packet(BROADCAST, Instruction.SYNC_WRITE, bytes(params))


def sync_write_words_packet(start: int, words: Mapping[int, int]) -> bytes:
    """The same for numbers of two bytes; of many servos in one step, for every cycle."""
    pairs = [each for pair in words.items() for each in pair]
    params = struct.pack("<BB" + "BH" * len(words), start, 2, *pairs)
    return instruction_packet(BROADCAST, Instruction.SYNC_WRITE, params)


def whole_packets(data: bytes) -> Iterator[tuple[int, int]]:
    """Find status packets of any servo; yield its id and the number of data bytes."""
    at = data.find(_HEADER)
    while 0 <= at <= len(data) - _OVERHEAD:
        end = at + 4 + data[at + 3]
        if end - at >= _OVERHEAD and end <= len(data) and sum(data[at:end]) & 0xFF == 0xFD:
            yield data[at + 2], end - at - _OVERHEAD
            at = data.find(_HEADER, end)
        else:
            at = data.find(_HEADER, at + 1)


class Answer(NamedTuple):  # six are made in every cycle, and this is the fastest kind
    """The bytes that a servo was asked for; they are valid even if a bit of ``faults`` is set.

    ``faults`` is its status byte, see ``Fault``.
    """

    data: bytes
    faults: int


class Answers:
    """Collects answers of ``count`` data bytes of ``servo_ids`` from bytes in chunks of any size.

    ``found`` has the answers so far, by servo id; a second one from a servo replaces the first.
    ``skipped`` counts the bytes that belonged to no expected answer.
    """

    def __init__(self, servo_ids: Collection[int], count: int) -> None:
        self.found: dict[int, Answer] = {}
        self.skipped = 0
        self._awaited, self._count, self._size = servo_ids, count, packet_size(count)
        self._buffer = bytearray()
        # The servo whose answer ends with the buffer's first byte, an FF: checksum or next header.
        self._doubtful: int | None = None

    @property
    def is_complete(self) -> bool:
        return len(self.found) == len(self._awaited)

    @property
    def rest(self) -> bytes:
        """The bytes that have arrived and are not (yet) an answer."""
        return bytes(self._buffer if self._doubtful is None else self._buffer[1:])

    def feed(self, data: bytes) -> None:
        """Parse received bytes; they may be cut anywhere."""
        buffer, size = self._buffer, self._size
        buffer += data
        begin = 0
        while True:
            if self._doubtful is not None:
                follows = bytes(buffer[begin + 1 : begin + 3])
                if follows in (b"", b"\xff"):
                    break  # the next byte decides
                begin += self._decide(self._doubtful, follows)
            start = buffer.find(_HEADER, begin)
            if start < 0:  # the last byte may be the first half of a header
                start = max(len(buffer) - 1, begin) if buffer.endswith(b"\xff") else len(buffer)
            self.skipped += start - begin
            begin = start
            if len(buffer) - begin < size:
                break
            packet = bytes(buffer[begin : begin + size])
            if not self._take(packet):
                begin += 1
                self.skipped += 1
            elif packet[-1] == 0xFF:
                self._doubtful = packet[2]
                begin += size - 1
            else:
                begin += size
        del buffer[:begin]

    def _decide(self, servo_id: int, follows: bytes) -> int:
        """Keep or take back an answer that ends in FF; return how many bytes of it are consumed."""
        self._doubtful = None
        if follows[:1] == b"\xff" and follows != b"\xff\xff":
            del self.found[servo_id]
            self.skipped += self._size - 1
            return 0
        return 1

    def _take(self, packet: bytes) -> bool:
        servo_id = packet[2]
        if servo_id not in self._awaited or packet[3] != self._count + 2:
            return False
        if sum(packet) & 0xFF != 0xFD:  # FF FF, and FF together with its checksum
            return False
        if _HEADER in packet[3:] and is_cut_short(packet, self._awaited):
            return False
        self.found[servo_id] = Answer(packet[5:-1], packet[4])
        return True
