"""What a client writes on the wire: bytes to writes of registers.

Written from the published packet format alone, so that a mistake in the driver's codec or in the
emulator's does not hide itself here. An instruction is ``FF FF id length code parameters check``;
``length`` counts what follows it, and the check byte makes the sum from the id on end in FF.
"""

from dataclasses import dataclass

EVERYBODY = 254
WRITE, REG_WRITE, ACTION, SYNC_WRITE = 3, 4, 5, 0x83


@dataclass(frozen=True)
class Packet:
    servo_id: int
    code: int
    params: bytes


@dataclass(frozen=True)
class Written:
    """Bytes that a servo (or all, 254) is told to keep from ``address`` on."""

    servo_id: int
    address: int
    data: bytes

    def value(self, address, size):
        """The little-endian number written to a register, None if it was not written whole."""
        first = address - self.address
        if first < 0 or first + size > len(self.data):
            return None
        return int.from_bytes(self.data[first : first + size], "little")


class Parser:
    """Cuts a client's bytes into packets, however they are chunked."""

    def __init__(self):
        self._rest = b""

    def feed(self, data):
        """The packets that ``data`` completes."""
        self._rest += data
        found = []
        while True:
            start = self._rest.find(b"\xff\xff")
            if start < 0:
                self._rest = self._rest[-1:] if self._rest.endswith(b"\xff") else b""
                return found
            body = self._rest[start + 2 :]
            if body[:1] == b"\xff":  # three in a row: the packet begins with the last two
                self._rest = self._rest[start + 1 :]
                continue
            if len(body) < 2 or len(body) < body[1] + 2:
                self._rest = self._rest[start:]
                return found
            whole, rest = body[: body[1] + 2], body[body[1] + 2 :]
            if len(whole) >= 4 and sum(whole) & 0xFF == 0xFF:
                found.append(Packet(whole[0], whole[2], whole[3:-1]))
                self._rest = rest
            else:
                self._rest = self._rest[start + 1 :]


class Writes:
    """The writes in a client's bytes; those that wait for an ACTION come with it."""

    def __init__(self):
        self._parser, self._waiting = Parser(), []

    def feed(self, data):
        found = []
        for packet in self._parser.feed(data):
            if packet.code == WRITE and len(packet.params) > 1:
                found.append(Written(packet.servo_id, packet.params[0], packet.params[1:]))
            elif packet.code == REG_WRITE and len(packet.params) > 1:
                written = Written(packet.servo_id, packet.params[0], packet.params[1:])
                self._waiting.append(written)
            elif packet.code == ACTION:
                found += self._waiting
                self._waiting = []
            elif packet.code == SYNC_WRITE and len(packet.params) > 2:
                address, size, shares = packet.params[0], packet.params[1], packet.params[2:]
                step = size + 1
                found += [
                    Written(shares[k], address, shares[k + 1 : k + step])
                    for k in range(0, len(shares) - size, step)
                ]
        return found
