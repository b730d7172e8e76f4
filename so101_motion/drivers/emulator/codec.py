"""The servo's side of the protocol: decode instructions, encode status packets.

An instruction is ``FF FF id length code params... checksum`` with ``length = params + 2``; a status
packet has the status byte in place of the code. The listener is fed one byte at a time, so any
chunking gives the same instructions, and like a servo it answers what it does not understand with
silence. A packet that arrives whole is taken out in one piece, with the same result.

Two habits of the real firmware matter to a client and are kept:

- ``FF FF x`` starts a packet *wherever* it occurs, even inside the parameters of another. A
  payload must therefore never hold two 255 in a row; a client that sends one is not heard.
- The id of a packet is fixed when its id byte passes, so a servo acknowledges the write that
  renames it under its old id.

The driver has another codec, written from the same document by other hands; the tests play them
against each other and against the vendor's library.

Source: Feetech, STS/SMS protocol manual; github.com/0o8o0-blip/sts3215-firmware, uart_protocol.c
(behaviour only).
"""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import NamedTuple

BROADCAST = 0xFE
MAX_PARAMS = 128
"""Longest parameter list of any instruction but a sync write [bytes] (firmware buffer)."""

_HEADER = b"\xff\xff"


class Code(IntEnum):
    """Instruction codes a servo knows."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    RESTORE_DEFAULTS = 0x06
    REBOOT = 0x08
    SAVE_BACKUP = 0x09
    CLEAR_TURNS = 0x0A
    CALIBRATE = 0x0B
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class State(Enum):
    """The meaning of the next byte to a listener."""

    HUNT = "looking for FF FF"
    ID = "id"
    LENGTH = "length"
    CODE = "code"
    PARAMS = "parameters"
    CHECKSUM = "checksum"


class Instruction(NamedTuple):
    """One well-formed instruction heard on the wire, to servo ``servo_id``, 254 for all.

    ``code`` may be one no servo knows. Its last byte was the ``end``-th of the chunk that was
    heard.
    """

    servo_id: int
    code: int
    params: bytes
    end: int


def checksum(body: bytes) -> int:
    return ~sum(body) & 0xFF


def frame(servo_id: int, code: int, params: bytes = b"") -> bytes:
    """A complete packet; ``code`` is the instruction, or the status byte of a reply."""
    body = bytes((servo_id, len(params) + 2, code)) + params
    return _HEADER + body + bytes((checksum(body),))


class Listener:
    """Turns the bytes of one direction of the wire into instructions."""

    def __init__(self) -> None:
        self.state = State.HUNT
        self._run_of_ff = 0
        self._packet = bytearray()  # what has been heard of it, from its id on

    def hear(self, data: bytes) -> list[Instruction]:
        """Parse the next bytes; return the instructions that they complete, in order."""
        heard, position = [], 0
        while position < len(data):
            end = self._end_of_whole(data, position)
            if end:
                instruction = _instruction(data[position + 2 : end - 1], data[end - 1], end)
                self._run_of_ff = int(data[end - 1] == 0xFF)
                position = end
            else:
                instruction = self._byte(data[position], position + 1)
                position += 1
            if instruction is not None:
                heard.append(instruction)
        return heard

    def _end_of_whole(self, data: bytes, start: int) -> int:
        """Where the packet that starts here ends, if it is whole and no other starts in it; or 0.

        Only what gives the same instruction in one piece as byte by byte.
        """
        if self.state is not State.HUNT or self._run_of_ff or data[start : start + 2] != _HEADER:
            return 0
        servo_id, count, code = data[start + 2 : start + 5].ljust(3, b"\xff")
        end = start + 4 + count
        if servo_id > BROADCAST or end > len(data) or data.find(_HEADER, start + 2, end) >= 0:
            return 0
        return end if _may_have(code, count - 2) else 0

    def _byte(self, byte: int, position: int) -> Instruction | None:
        if self._run_of_ff >= 2:
            self.state, self._packet = State.ID, bytearray()
        self._run_of_ff = self._run_of_ff + 1 if byte == 0xFF else 0
        packet = self._packet
        match self.state:
            case State.HUNT:
                return None
            case State.ID:
                self.state = State.LENGTH if byte <= BROADCAST else State.HUNT
            case State.LENGTH:
                self.state = State.CODE if byte >= 2 else State.HUNT
            case State.CODE:
                count = packet[1] - 2
                following = State.PARAMS if count else State.CHECKSUM
                self.state = following if _may_have(byte, count) else State.HUNT
            case State.PARAMS:
                if len(packet) == packet[1]:
                    self.state = State.CHECKSUM
            case State.CHECKSUM:
                self.state = State.HUNT
                return _instruction(bytes(packet), byte, position)
        packet.append(byte)
        return None


def _may_have(code: int, count: int) -> bool:
    return 0 <= count <= MAX_PARAMS or (code == Code.SYNC_WRITE and count >= 0)


def _instruction(body: bytes, check: int, end: int) -> Instruction | None:
    if check != checksum(body):
        return None
    return Instruction(body[0], body[2], body[3:], end)
