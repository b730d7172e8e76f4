"""The emulated bus: which servos hear an instruction, which answer, and when.

Times are those of a half-duplex wire at ten bits a byte. A single reply starts right after the
request. Sync-read replies come in fixed slots, ``len + 9`` byte times each in the order of the
list, and broadcast pings in slots by id, so a silent servo leaves a hole and delays nobody. Servos
that share an id answer together and pull the wire low over each other: what arrives is the bitwise
AND, and the checksum tells. Equal answers survive unless the servos are a bit apart, which they are
now and then, because each has its own clock.

A servo hears only its own baud rate. Broadcasts are carried out by all and acknowledged by none,
except ping and sync read.

Source: as in ``codec.py``; slot times: firmware arithmetic, bench-tested by its author.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from itertools import zip_longest
from typing import NamedTuple

from so101_motion.drivers.emulator.codec import BROADCAST, Code, Instruction, Listener, frame
from so101_motion.drivers.emulator.faults import WireFaults
from so101_motion.drivers.emulator.servo import Servo
from so101_motion.drivers.emulator.world import World

TURNAROUND = 20e-6
"""From the end of a request to the first bit of the reply [s] (sync reads on an arm: under 100 us
with everything)."""

_BIT_APART = 0.3
"""How often two servos that answer together are a bit apart. Chosen: each has its own clock, and a
bit takes 1 us."""

_BITS_PER_BYTE = 10
_SLOT_GAP = 3  # byte times between two slots
_STATUS_BYTES = len(frame(0, 0))  # of a reply without data
_LONGEST_SYNC_WRITE = 125  # bytes for each servo


class Reply(NamedTuple):
    """Bytes whose last comes ``after`` the request's first [s]; ``held`` is extra delay [s]."""

    after: float
    data: bytes
    held: float = 0.0


class _Answer(NamedTuple):
    slot: float  # start after the request, in byte times
    data: bytes


class Bus:
    """The cable with the servos of ``world``; ``faults`` may be changed while it runs.

    ``observers`` are called with the time [s] and the bytes of every chunk a client writes, after
    the world has caught up and before the chunk takes effect; the world's lock is held.
    """

    def __init__(self, world: World, faults: WireFaults | None = None) -> None:
        self._world = world
        self._listener = Listener()
        self._baud = 0
        self._wire_free = -math.inf
        self._random = random.Random(0)
        self.faults = faults or WireFaults()
        self.observers: list[Callable[[float, bytes], None]] = []

    def feed(self, data: bytes, now: float, *, baud: int = 1_000_000) -> list[Reply]:
        """Carry out the instructions in bytes that may be cut anywhere.

        ``now`` is on the emulator's clock [s], ``baud`` the client's. Returns the replies in the
        order in which they leave the wire.
        """
        if baud <= 0:  # a terminal at rate 0 is hung up: no servo hears it
            return []
        if baud != self._baud:
            self._listener, self._baud = Listener(), baud
        if self.observers:
            with self._world.lock:
                self._world.advance(now)
                for observe in self.observers:
                    observe(now, data)
        instructions = self._listener.hear(data)
        if not instructions:
            return []
        byte_time = _BITS_PER_BYTE / baud
        answers, request = [], 0.0
        with self._world.lock:
            self._world.advance(now)
            begin = max(now, self._wire_free)  # a clock that stands still does not stop the wire
            for instruction in instructions:
                if self.faults.loses_request():
                    continue
                request = instruction.end * byte_time + TURNAROUND
                for servo in self._world.servos:
                    servo.now = begin + request
                for slot, data in self._collide(self._carry_out(instruction, now)):
                    answers.append((request + (slot + len(data)) * byte_time, data))
            self._wire_free = begin + max([request, *(after for after, _ in answers)])
        replies = [
            Reply(after, arriving, held)
            for after, data in answers
            for held, arriving in self.faults.disturb(data)
        ]
        return sorted(replies, key=lambda reply: reply.after + reply.held)

    def _listening(self) -> list[Servo]:
        return [
            servo
            for servo in self._world.servos
            if servo.drive.powered and servo.baud == self._baud
        ]

    def _carry_out(self, instruction: Instruction, now: float) -> list[_Answer]:
        match instruction.code:
            case Code.SYNC_READ:
                return list(self._sync_read(instruction.params))
            case Code.SYNC_WRITE:
                self._sync_write(instruction.params)
                return []
            case code if instruction.servo_id == BROADCAST:
                return list(self._broadcast(code, instruction.params, now))
            case code:
                return [
                    # Under the id it was called by: a write to the id register is acknowledged
                    # with the old one.
                    _Answer(0, frame(instruction.servo_id, servo.status, reply))
                    for servo in self._listening()
                    if servo.servo_id == instruction.servo_id
                    and (reply := servo.execute(code, instruction.params, now)) is not None
                ]

    def _broadcast(self, code: int, params: bytes, now: float) -> Iterator[_Answer]:
        for servo in self._listening():
            own_id = servo.servo_id
            reply = servo.execute(code, params, now)
            if code == Code.PING and reply is not None:
                slot = own_id * (_STATUS_BYTES + _SLOT_GAP)
                yield _Answer(slot, frame(own_id, servo.status))

    def _sync_read(self, params: bytes) -> Iterator[_Answer]:
        if len(params) < 3:
            return
        address, count, ids = params[0], params[1], params[2:]
        for servo in self._listening():
            place = ids.find(servo.servo_id)
            data = servo.read(address, count) if place >= 0 else None
            if data is not None:
                slot = place * (_STATUS_BYTES + len(data) + _SLOT_GAP)
                yield _Answer(slot, frame(servo.servo_id, servo.status, data))

    def _sync_write(self, params: bytes) -> None:
        if len(params) < 3 or not 0 < params[1] <= _LONGEST_SYNC_WRITE:
            return
        address, size, rest = params[:1], params[1], params[2:]
        shares = {
            rest[start]: rest[start + 1 : start + 1 + size]
            for start in range(0, len(rest), size + 1)
        }
        for servo in self._listening():
            if share := shares.get(servo.servo_id):
                servo.write(address + share)

    def _collide(self, answers: list[_Answer]) -> list[_Answer]:
        """Merge answers that start together; a bit is low where any sender pulls it low."""
        slots: dict[float, bytes] = {}
        for slot, data in answers:
            if slot in slots:
                if self._random.random() < _BIT_APART:
                    bits = int.from_bytes(data, "little") << 1 | 1
                    data = bits.to_bytes(len(data) + 1, "little")[:-1]
                pairs = zip_longest(slots[slot], data, fillvalue=0xFF)
                data = bytes(one & other for one, other in pairs)
            slots[slot] = data
        return [_Answer(*each) for each in sorted(slots.items())]
