"""The servo's side of the protocol: decode instructions, encode status packets.

How it works
    An instruction is ``FF FF id length code params... checksum`` with ``length = params + 2`` and
    ``checksum = ~(id + length + code + params) & FF``; a status packet is the same with the status
    byte in place of the code. The listener is a table-like state machine fed one byte at a time,
    so any chunking gives the same instructions, and it never raises: like a servo, it answers
    what it does not understand with silence.

    Two habits of the real firmware matter to a client and are kept:

    - ``FF FF x`` starts a packet *wherever* it occurs, even inside the parameters of another. A
      payload must therefore never hold two 255 in a row; a client that sends one is not heard.
    - The id of a packet is fixed when its id byte passes, so a servo acknowledges the write that
      renames it under its old id.

    This codec is the emulator's own. The driver has another, written from the same document by
    other hands, and the tests play them against each other and against the vendor's library.

Source: Feetech, STS/SMS protocol manual; github.com/0o8o0-blip/sts3215-firmware, uart_protocol.c
(behaviour only).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

BROADCAST = 0xFE
MAX_PARAMS = 128
"""Longest parameter list of any instruction but a sync write [bytes] (firmware buffer)."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Instruction:
    """One well-formed instruction heard on the wire.

    Attributes:
        servo_id: Addressee, 254 for everybody.
        code: What to do; may be a code no servo knows.
        params: What follows the code.
        end: How many bytes into the chunk given to ``hear`` its last byte was.
    """

    servo_id: int
    code: int
    params: bytes
    end: int


def checksum(body: bytes) -> int:
    """Check byte over everything between the two header bytes and itself."""
    return ~sum(body) & 0xFF


def frame(servo_id: int, code: int, params: bytes = b"") -> bytes:
    """A complete packet; ``code`` is the instruction, or the status byte of a reply."""
    body = bytes((servo_id, len(params) + 2, code)) + params
    return b"\xff\xff" + body + bytes((checksum(body),))


class Listener:
    """Turns the bytes of one direction of the wire into instructions."""

    def __init__(self) -> None:
        self.state = State.HUNT
        self._run_of_ff = 0
        self._id = self._length = self._code = 0
        self._params = bytearray()

    def hear(self, data: bytes) -> list[Instruction]:
        """Parse the next bytes; return the instructions that they complete, in order."""
        heard = []
        for position, byte in enumerate(data, start=1):
            instruction = self._byte(byte, position)
            if instruction is not None:
                heard.append(instruction)
        return heard

    def _byte(self, byte: int, position: int) -> Instruction | None:
        if self._run_of_ff >= 2:
            self.state = State.ID
        self._run_of_ff = self._run_of_ff + 1 if byte == 0xFF else 0
        match self.state:
            case State.HUNT:
                pass
            case State.ID:
                self._id = byte
                self.state = State.LENGTH if byte <= BROADCAST else State.HUNT
            case State.LENGTH:
                self._length = byte
                self.state = State.CODE if byte >= 2 else State.HUNT
            case State.CODE:
                self._code, self._params = byte, bytearray()
                self.state = self._after_code()
            case State.PARAMS:
                self._params.append(byte)
                if len(self._params) == self._length - 2:
                    self.state = State.CHECKSUM
            case State.CHECKSUM:
                self.state = State.HUNT
                return self._finished(byte, position)
        return None

    def _after_code(self) -> State:
        count = self._length - 2
        if count > MAX_PARAMS and self._code != Code.SYNC_WRITE:
            return State.HUNT
        return State.PARAMS if count else State.CHECKSUM

    def _finished(self, byte: int, position: int) -> Instruction | None:
        params = bytes(self._params)
        if byte != checksum(bytes((self._id, self._length, self._code)) + params):
            return None
        return Instruction(servo_id=self._id, code=self._code, params=params, end=position)
