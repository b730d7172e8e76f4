"""The transactions on the servo bus, with retries and counters; only this file retries.

An answer that comes after its timeout is late, not lost: its length is that of an overdue question
(``stale_replies.py``), and from then on answers are waited for longer (``Lateness``): an adapter
with a latency timer, a virtual machine or a hub may be 16 ms away.

Four rules keep a wrong value from being believed:

* Input is discarded before every question and after every wrong answer.
* An answer that broke off, and ends with the beginning of the next, is refused (``protocol.py``).
* An answer must come from the right servo and have the right length. The length is the only mark
  a question leaves on its answer, so it is varied while an old answer may still be on its way.
* A value written to one servo is read back. The acknowledgement alone proves little: it may be a
  late one, or be lost although the servo obeyed.

No servo acknowledges a sync write; they are for setpoints, and the next one comes soon. The status
byte of an answer is kept as telemetry and never turns a reading into an error.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

from so101_motion.common.errors import BusError, CorruptReply, NoReply, PortUnavailable, ServoFault
from so101_motion.drivers.bus.protocol import (
    Answer,
    Answers,
    Instruction,
    instruction_packet,
    packet_size,
    sync_read_packet,
    sync_write_packet,
    whole_packets,
)
from so101_motion.drivers.bus.registers import BROADCAST, ID, LOCK, MODEL_NUMBER, Fault, Register
from so101_motion.drivers.bus.reply_counters import ReplyCounters
from so101_motion.drivers.bus.stale_replies import StaleReplies

__all__ = ["REPLY_TIMEOUT", "RETRIES", "Bus", "PingAnswers", "Port", "reply_timeout_in"]

_log = logging.getLogger(__name__)

_WARNED = set[str]()  # ports of which the user knows that answers come late; each is opened often

RETRIES = 3
"""How often a question to one servo is repeated. Chosen: with 7 % of the answers spoiled, one
transaction in 40,000 fails."""

REPLY_TIMEOUT = 0.007
"""How long to wait beyond the time the wire takes [s]. A USB adapter needs 1 to 2 ms; chosen to
leave room for a busy machine, and so that a cycle without any answer still fits into 10 ms."""

_SHARE = 0.7
"""Share of a control period that may be spent waiting. Chosen: the rest is for computing."""

_PERSISTENCE = (1, 1, 4, 24)
"""Factors of the timeout for the tries of one question. The first tries are short, so a lost answer
is soon asked for again; the last is long, so a computer that was busy for 0.2 s makes no servo
silent. Chosen: kernels were seen to hand over received bytes that late."""

_LONGEST = 0.2
"""Longest timeout of one try [s]."""

_PROMPT = 0.7
"""Answers are prompt as long as most take no longer than this share of the timeout. Chosen: the
rest is for the time on the wire."""

_REST = 0.003
"""How long to wait for the others once the first answers to a sync read have come, beyond the time
the wire takes [s]: an adapter hands over its bytes every millisecond or two. Chosen."""

_GAP = 3  # byte times between two answers to a sync read (FW)
_PING_SLOT = packet_size(0) + _GAP


class Port(Protocol):
    """An open serial port. Every method may raise ``PortUnavailable``."""

    @property
    def name(self) -> str: ...

    @property
    def baud(self) -> int:
        """Baud rate [bit/s]."""

    def write(self, data: bytes) -> None: ...

    def read(self, until: float) -> bytes:
        """Read received bytes; none if none came by ``until``, on ``time.monotonic`` [s]."""

    def discard(self) -> None: ...

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class PingAnswers:
    """The ``ids`` whose answers to a broadcast ping were valid, in order.

    ``garbled`` is whether other bytes came too: from servos that share an id, or noise.
    """

    ids: tuple[int, ...]
    garbled: bool


def reply_timeout_in(period: float) -> float:
    """The reply timeout for which a control cycle of ``period`` [s] has room [s]."""
    return min(REPLY_TIMEOUT, _SHARE * period)


class Bus:
    """The servos on one open port, which is the bus's own now. Used by one thread at a time.

    ``names`` are used in messages, by id; ``counters`` are continued, for a bus that comes back on
    a new port. Answers are waited for ``reply_timeout`` beyond the time on the wire [s]; for a sync
    read it includes that time, where it is short enough.
    """

    def __init__(
        self,
        port: Port,
        *,
        names: Mapping[int, str] | None = None,
        counters: ReplyCounters | None = None,
        reply_timeout: float = REPLY_TIMEOUT,
    ) -> None:
        self.port = port
        self.counters = ReplyCounters() if counters is None else counters
        self._names = names or {}
        self._reply_timeout, self._prompt = reply_timeout, _PROMPT * reply_timeout
        # of answers that are prompt: for each try of a question, and once the first have come
        self._timeouts = [
            min(reply_timeout * k, max(reply_timeout, _LONGEST)) for k in _PERSISTENCE
        ]
        self._rest = min(_REST, 0.5 * reply_timeout)
        self._stale_replies = StaleReplies()

    def label(self, servo_id: int) -> str:
        name = self._names.get(servo_id)
        return f"servo {servo_id}" + (f" ({name})" if name else "")

    def close(self) -> None:
        self.port.close()

    # One servo

    def ping(self, servo_id: int) -> Fault:
        """Ping a servo; return its status byte. Raises as ``read`` does."""
        for tried in range(1 + RETRIES):
            answer = self._once(servo_id, Instruction.PING, b"", 0, tried)
            if isinstance(answer, Answer):
                return Fault(answer.faults)
            self.counters[servo_id].retries += 1
        raise self._failure(servo_id, answer, "a ping")

    def read(self, servo_id: int, register: Register) -> int:
        """Read a register.

        Raises:
            NoReply: The servo is silent.
            CorruptReply: No answer was sound.
        """
        block = self.read_block(servo_id, register.address, register.size, what=register.name)
        return register.decode(block)

    def read_block(self, servo_id: int, start: int, count: int, *, what: str = "a block") -> bytes:
        """Read ``count`` bytes from address ``start``; raises as ``read`` does."""
        for tried in range(1 + RETRIES):
            now = time.monotonic()
            begin, length = self._stale_replies.span((servo_id,), start, count, now)
            question = bytes((begin, length))
            answer = self._once(servo_id, Instruction.READ, question, length, tried)
            if isinstance(answer, Answer):
                return answer.data[start - begin : start - begin + count]
            self.counters[servo_id].retries += 1
        raise self._failure(servo_id, answer, what)

    def write(self, servo_id: int, register: Register, value: int) -> None:
        """Write a register and read it back.

        A servo saves an EEPROM register only while it is unlocked; see ``store``. ``ServoFault`` is
        raised if the register holds something else then, otherwise as by ``read``.
        """
        params = bytes((register.address, *register.encode(value)))
        held = None
        for tried in range(1 + RETRIES):
            self._once(servo_id, Instruction.WRITE, params, 0, tried)
            held = self.read(servo_id, register)
            if held == value:
                return
            self.counters[servo_id].retries += 1
        faults = Fault(self.counters[servo_id].faults)
        reports = f" and reports {', '.join(faults.names)}" if faults.names else ""
        raise ServoFault(
            f"{self.label(servo_id)} was sent {register.name} = {value} but holds {held}{reports};"
            " let it cool and free its joint, or switch its power off and on, then try again",
            servo_id=servo_id,
            flags=faults,
        )

    def write_each(self, register: Register, values: Mapping[int, int]) -> None:
        """Write a register of many servos, by id; all are tried before ``BusError`` is raised."""
        failures: list[BusError] = []
        for servo_id, value in values.items():
            try:
                self.write(servo_id, register, value)
            except PortUnavailable:
                raise
            except BusError as error:
                failures.append(error)
        if failures:
            raise failures[0]

    def store(
        self, servo_id: int, values: Mapping[Register, int], *, anew: bool = False
    ) -> tuple[str, ...]:
        """Store ``values`` in EEPROM registers for good; writes only those that differ.

        With ``anew`` the others are written too: what a register holds may be forgotten at
        power-off. Whatever fails, the servo is locked again as far as it can be reached. Returns
        the names of those that differed.
        """
        held = {row: self.read(servo_id, row) for row in values}
        differing = {row: want for row, want in values.items() if held[row] != want}
        if not (differing or anew):
            return ()
        try:
            self.write(servo_id, LOCK, 0)
            for register, value in (values if anew else differing).items():
                self.write(servo_id, register, value)
        finally:
            self.write(servo_id, LOCK, 1)
        said = ", ".join(f"{row.name} {held[row]} -> {want}" for row, want in differing.items())
        _log.info("%s: stored %s", self.label(servo_id), said or "what it holds")
        return tuple(row.name for row in differing)

    def overlay(self, servo_id: int, values: Mapping[Register, int]) -> tuple[str, ...]:
        """Write EEPROM registers that differ, in force until the servo loses its power.

        Nothing is stored, because the servo is locked. Returns the names of those that were
        written.
        """
        differing = {row: want for row, want in values.items() if self.read(servo_id, row) != want}
        if differing and self.read(servo_id, LOCK) != 1:  # another program left it open
            self.write(servo_id, LOCK, 1)
        for register, value in differing.items():
            self.write(servo_id, register, value)
        return tuple(row.name for row in differing)

    def change_id(self, servo_id: int, new_id: int) -> None:
        """Give a servo another id for good.

        Raises:
            ServoFault: Another servo has that id, or the servo did not take it.
            BusError: See ``write``.
        """
        if new_id in self.answering((new_id,)):
            raise ServoFault(
                f"there is a servo {new_id} already; unplug it or choose another id",
                servo_id=new_id,
            )
        self.write(servo_id, LOCK, 0)
        for _ in range(1 + RETRIES):
            self.post(servo_id, ID, new_id)
            if new_id in self.answering((new_id,)):
                self.write(new_id, LOCK, 1)  # where the servo answers from now on
                return
        self.write(servo_id, LOCK, 1)
        raise ServoFault(
            f"{self.label(servo_id)} did not take the id {new_id}; check that it is the only"
            " servo plugged in, then try again",
            servo_id=servo_id,
        )

    def post(self, servo_id: int, register: Register, value: int) -> None:
        """Write a register without reading it back.

        For the id and the baud rate: from then on the servo answers under the new one.
        """
        params = bytes((register.address, *register.encode(value)))
        self._once(servo_id, Instruction.WRITE, params, 0)

    # All servos

    def ping_all(self) -> PingAnswers:
        """Ping all servos that listen at this baud rate; each answers in a slot of its own."""
        answers = Answers(range(BROADCAST), 0)
        self._hear_late()
        self.port.discard()
        self.port.write(instruction_packet(BROADCAST, Instruction.PING))
        wire = 10.0 * (packet_size(0) + BROADCAST * _PING_SLOT) / self.port.baud
        until = time.monotonic() + wire + self._reply_timeout_for(0)
        while data := self.port.read(until):
            answers.feed(data)
        garbled = answers.skipped + answers.rest_count > 0
        return PingAnswers(tuple(sorted(answers.found)), garbled)

    def answering(self, servo_ids: Iterable[int], *, tries: int = 1 + RETRIES) -> list[int]:
        """Which of ``servo_ids`` answer; ``tries`` as in ``sync_read``."""
        row = MODEL_NUMBER
        found = self.sync_read(tuple(servo_ids), row.address, row.size, tries=tries)
        return sorted(found)

    def sync_read(
        self,
        servo_ids: Collection[int],
        start: int,
        count: int,
        *,
        tries: int = 1,
        given_up: Collection[int] = (),
    ) -> dict[int, Answer]:
        """Read ``count`` bytes from ``start`` of many servos, in one transaction.

        Servos answer in the order they are listed, each in its own time slot. Once the last one has
        answered, no other will, so waiting ends. A servo that did not answer is missing.

        Silent ones are asked 1 to 4 ``tries``; later tries wait longer. A control loop has time for
        one only, and asks again in its next cycle. Those ``given_up`` are asked only once.
        """
        found: dict[int, Answer] = {}
        # The silent ones first, so that the last one is there to be waited for.
        asked = sorted(servo_ids, key=lambda i: i not in given_up) if given_up else [*servo_ids]
        for attempt in range(tries):
            if attempt:
                for servo_id in asked:
                    self.counters[servo_id].retries += 1
            answers = Answers(asked, count)
            self.ask(answers, start, count, attempt)
            found.update(answers.found)
            asked = [i for i in asked if i not in found and i not in given_up]
            if not asked:
                break
        return found

    def ask(self, answers: Answers, start: int, count: int, tried: int = 0) -> None:
        """Ask the servos of ``answers`` once for ``count`` bytes from ``start``."""
        asked = answers.servo_ids
        begin, length = self._stale_replies.span(
            asked, start, count, time.monotonic(), again=True, longest=self._longest
        )
        answers.begin(length, start - begin, count)
        self._transact(sync_read_packet(asked, begin, length), answers, tried)

    def sync_write(self, start: int, data: Mapping[int, bytes]) -> None:
        """Write each servo's bytes in ``data`` from address ``start``; without acknowledgement."""
        self.port.write(sync_write_packet(start, data))

    # How

    def _once(
        self, servo_id: int, instruction: Instruction, params: bytes, count: int, tried: int = 0
    ) -> Answer | bytes:
        """Ask one servo once; return its answer, or the bytes that were no valid answer."""
        answers = Answers((servo_id,), count)
        received = self._transact(instruction_packet(servo_id, instruction, params), answers, tried)
        return answers.found.get(servo_id, received)

    def _reply_timeout_for(self, tried: int) -> float:
        """How long to wait for an answer after ``tried`` earlier tries [s]."""
        late = self._lateness
        if not late:
            return self._timeouts[tried]
        first = max(self._reply_timeout, 1.5 * late + 0.001)  # chosen, for jitter
        return min(first * _PERSISTENCE[tried], max(self._reply_timeout, _LONGEST))

    def _waits(self, tried: int, wire: float) -> tuple[float, float]:
        """How long to wait for the first answers, and once they have come for the rest [s].

        ``wire``: how long all of them take on the wire [s].
        """
        if self.counters.lateness.longest <= self._prompt:
            rest = wire + self._rest
            return max(self._timeouts[tried], rest), rest
        rest = wire + max(self._rest, self._lateness)
        return max(self._reply_timeout_for(tried), rest), rest

    def _longest(self, servos: int) -> int:
        """How many bytes each of ``servos`` can send within the timeout of a control cycle."""
        # A port in a test has a timeout of 0, because its answers are there at once.
        reply_timeout = self._reply_timeout or REPLY_TIMEOUT
        room = (reply_timeout - min(_REST, 0.5 * reply_timeout)) * self.port.baud / 10.0
        return int((room - 8) / servos) - 1 - packet_size(0) - _GAP

    @property
    def _lateness(self) -> float:
        """How late answers come [s]; 0 while most come within the timeout.

        A control loop that misses a few answers need not wait for them.
        """
        lateness = self.counters.lateness
        if lateness.longest <= self._prompt or lateness.typical <= self._prompt:
            return 0.0
        if self.port.name not in _WARNED and self._reply_timeout:
            _WARNED.add(self.port.name)
            _log.warning(
                "the servos on %s answer %.0f ms late, so the arm moves less smoothly; so101 doctor"
                " says what to do",
                self.port.name,
                1e3 * lateness.typical,
            )
        return lateness.longest

    def _transact(self, packet: bytes, answers: Answers, tried: int) -> bytes:
        """Send a question and collect its answers; return all bytes if not all of them are late."""
        asked, count, counters = answers.servo_ids, answers.count, self.counters
        if self._stale_replies.overdue:
            self._hear_late()
        self.port.discard()
        self.port.write(packet)
        sent, late = time.monotonic(), 0
        wire = 10.0 * (len(packet) + len(asked) * (count + _PING_SLOT)) / self.port.baud
        until = sent + self._waits(tried, wire)[0]
        while data := self.port.read(until):
            now, is_first = time.monotonic(), not answers.found_count
            answers.feed(data)
            if is_first and self._stale_replies.overdue:
                late += self._take_late(answers.received, now, but=count)
            if is_first and answers.found_count and now <= until:  # else this computer was late
                counters.lateness.measured(now - sent - wire, len(asked))
            if answers.is_over:
                break
            if is_first:
                first, rest = self._waits(tried, wire)
                until = min(sent + first, now + rest)
        if not answers.received:
            answers.feed(b"")
        if answers.found_count == answers.asked and not answers.faults:
            counters.all_heard(asked)
            return answers.received if late < len(answers.received) else b""
        for servo_id, answer in answers.found.items():
            counters[servo_id].heard(answer.faults)
        if missing := answers.missing:
            self._stale_replies.missed(missing, count, sent)
            garbled = answers.skipped + answers.rest_count > late
            for servo_id in missing:
                counters[servo_id].missed(garbled=garbled)
        return answers.received if late < len(answers.received) else b""

    def _hear_late(self) -> None:
        """Count late answers among the bytes that have been received."""
        if self._stale_replies.awaits(time.monotonic()):
            received = b""
            while data := self.port.read(0.0):
                received += data
            self._take_late(received, time.monotonic())

    def _take_late(self, received: bytes, now: float, *, but: int | None = None) -> int:
        """Return the length of the answers to earlier questions in ``received``; count them.

        Those with ``but`` bytes of data answer the present question.
        """
        if not self._stale_replies.awaits(now):
            return 0
        size = 0
        for servo_id, count in whole_packets(received):
            asked = None if count == but else self._stale_replies.came(servo_id, count, now)
            if asked is not None:
                self.counters[servo_id].came_late()
                size += packet_size(count)
                # It may have come long ago, so waiting is prolonged step by step.
                delay = min(now - asked, 2.0 * self._reply_timeout_for(0))
                self.counters.lateness.measured(delay, 1)
        return size

    def _failure(self, servo_id: int, answer: Answer | bytes, what: str) -> NoReply | CorruptReply:
        label, tries = self.label(servo_id), 1 + RETRIES
        if answer:
            assert isinstance(answer, bytes)
            return CorruptReply(
                f"{label} on {self.port.name} answered with nonsense {tries} times; check the"
                f" plugs of its cable, and that no other servo has the id {servo_id}",
                raw=answer,
            )
        return NoReply(
            f"no reply from {label} on {self.port.name} after {tries} tries; check that it has"
            " power and that the cable from the servo before it is plugged in",
            servo_id=servo_id,
            register=what,
        )
