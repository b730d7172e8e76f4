"""Encode instructions and decode status packets; no port here.

A status packet is ``FF FF id length flags data... checksum``, where ``length`` is the number of
data bytes plus 2 and the checksum is the inverted sum of everything between header and itself.
It names the servo but neither the question nor the register. ``Answers`` therefore looks for
packets from given servos with a given number of data bytes, and skips everything else a byte at a
time. A broken packet can cost its own servo's answer and no other.

The checksum alone does not reveal a packet that broke off. If the next packet follows at once, the
FF FF of its header stands in the place of the missing bytes, and for one value in 256 the checksum
is right. So a packet that contains the beginning of another is refused, and an answer whose
checksum FF turns out to be the first byte of the next header is taken back.
"""

from __future__ import annotations

import ctypes
from collections.abc import Collection, Iterator, Mapping
from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple

from so101_motion.drivers.bus.registers import BROADCAST
from so101_motion.native.library import quick

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


class Answer(NamedTuple):
    """The bytes that a servo was asked for; they are valid even if a bit of ``faults`` is set.

    ``faults`` is its status byte, see ``Fault``.
    """

    data: bytes
    faults: int


class Answers(ctypes.Structure):
    """Collects answers of ``servo_ids`` from bytes in chunks of any size; ``begin`` starts anew.

    A second answer from a servo replaces the first. Found in ``servo_packets.c``.

    Attributes:
        servo_ids: The servos that were asked, in their order.
        count: How many bytes of data an answer has.
        found_count: How many servos have answered.
        is_over: Whether the last one has.
        faults: All bits that are set in their status bytes.
        skipped: How many bytes belonged to no expected answer.
        rest_count: How many bytes at the end are not (yet) an answer.
        received: All bytes since the question.
        ref: For C.
    """

    _fields_ = [
        *((name, ctypes.c_int) for name in ("count", "skip", "asked", "found_count", "skipped")),
        *((name, ctypes.c_int) for name in ("rest_count", "faults", "is_over")),
        ("at", ctypes.c_int * 256),
        ("servo", ctypes.c_ubyte * 256),
    ]
    at: list[int]
    count: int
    asked: int
    found_count: int
    skipped: int
    rest_count: int
    faults: int
    is_over: int

    def __init__(self, servo_ids: Collection[int], count: int) -> None:
        self.servo_ids = tuple(servo_ids)
        super().__init__(asked=len(self.servo_ids), at=(-1,) * 256, servo=self.servo_ids)
        self._find, self.ref = quick().so101_answers_find, ctypes.byref(self)
        self.begin(count)

    def begin(self, count: int, skip: int = 0, wanted: int | None = None) -> None:
        """Expect ``count`` bytes from each; ``wanted`` are so many of them after the first.

        Who has answered is known from the next ``feed`` on.
        """
        self.count, self.skip, self._wanted = count, skip, count if wanted is None else wanted
        self.received, self.found_count, self.is_over = b"", 0, 0

    def feed(self, data: bytes) -> None:
        """Parse received bytes; they may be cut anywhere."""
        self.received += data
        self._find(self.ref, self.received, len(self.received))

    def is_from(self, servo_id: int) -> bool:
        return self.at[servo_id] > 0

    @property
    def missing(self) -> list[int]:
        """The servos that have not answered."""
        return [servo_id for servo_id in self.servo_ids if self.at[servo_id] <= 0]

    @property
    def found(self) -> dict[int, Answer]:
        """The answers so far, by servo id."""
        received, skip, found = self.received, self.skip + 1, {}
        for servo_id in self.servo_ids:
            if (at := self.at[servo_id]) > 0:
                found[servo_id] = Answer(received[at : at + self._wanted], received[at - skip])
        return found
