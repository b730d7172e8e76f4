import random

import pytest
import scservo_sdk
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.protocol import (
    Answer,
    Answers,
    Instruction,
    checksum,
    instruction_packet,
    packet_size,
    sync_read_packet,
    sync_write_packet,
    whole_packets,
)
from so101_motion.drivers.bus.registers import Fault


def packet(servo_id, data, faults=0):
    body = bytes((servo_id, len(data) + 2, faults)) + data
    return b"\xff\xff" + body + bytes((checksum(body),))


ids = st.integers(0, 253)
positions = st.integers(0, 4095).map(lambda tick: tick.to_bytes(2, "little"))


@st.composite
def chunked(draw, data):
    cuts = sorted(draw(st.lists(st.integers(0, len(data)), max_size=8)))
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


class Recorder(scservo_sdk.PortHandler):
    """A port that keeps the packet."""

    def clearPort(self):
        """There is nothing to clear."""

    def writePort(self, packet):
        self.packet = bytes(packet)
        return len(packet)


@given(st.integers(0, 79), st.integers(1, 7), st.sets(ids, min_size=1, max_size=6), st.data())
def test_a_sync_write_is_built_as_the_vendors_sdk_builds_it(start, count, servo_ids, data):
    shares = {i: data.draw(st.binary(min_size=count, max_size=count)) for i in servo_ids}
    params = [byte for i, share in shares.items() for byte in (i, *share)]
    port = Recorder("")
    scservo_sdk.PacketHandler(0).syncWriteTxOnly(port, start, count, params, len(params))
    assert sync_write_packet(start, shares) == port.packet


@given(ids, st.sampled_from([1, 2, 3]), st.binary(max_size=20))
def test_an_instruction_is_built_as_the_vendors_sdk_builds_it(servo_id, code, params):
    port = Recorder("")
    wanted = [0, 0, servo_id, len(params) + 2, code, *params, 0]
    scservo_sdk.PacketHandler(0).txPacket(port, wanted)
    assert instruction_packet(servo_id, Instruction(code), params) == port.packet


@given(st.integers(0, 79), st.integers(1, 7), st.lists(ids, min_size=1, max_size=6, unique=True))
def test_a_sync_read_is_built_as_the_vendors_sdk_builds_it(start, count, servo_ids):
    port = Recorder("")
    scservo_sdk.PacketHandler(0).syncReadTx(port, start, count, servo_ids, len(servo_ids))
    assert sync_read_packet(tuple(servo_ids), start, count) == port.packet


def test_whole_packets_are_found_among_broken_ones():
    broken = packet(3, b"\x01\x02")[:-1] + b"\x00"
    data = b"\x07" + packet(1, b"") + broken + packet(2, b"\x05") + packet(4, b"\x05")[:-1]
    assert list(whole_packets(data)) == [(1, 0), (2, 1)]


@given(st.dictionaries(ids, positions, min_size=1, max_size=6), st.data())
def test_all_answers_are_found_however_they_are_cut(sent, data):
    answers = Answers(sent.keys(), 2)
    stream = b"".join(packet(servo_id, value) for servo_id, value in sent.items())
    for piece in data.draw(chunked(stream)):
        answers.feed(piece)
    assert {i: answer.data for i, answer in answers.found.items()} == sent
    assert answers.skipped == 0
    assert answers.rest_count == 0


@given(st.data())
def test_one_flipped_bit_costs_its_own_answer_and_no_other(data):
    sent = {i: data.draw(positions) for i in range(1, 7)}
    size = packet_size(2)
    stream = bytearray(b"".join(packet(i, value) for i, value in sent.items()))
    bit = data.draw(st.integers(0, 8 * len(stream) - 1))
    stream[bit // 8] ^= 1 << bit % 8
    hurt = bit // 8 // size + 1
    answers = Answers(sent.keys(), 2)
    for piece in data.draw(chunked(bytes(stream))):
        answers.feed(piece)
    assert {i: answer.data for i, answer in answers.found.items()} == {
        i: value for i, value in sent.items() if i != hurt
    }
    assert answers.skipped + answers.rest_count > 0


@given(st.binary(max_size=30).filter(lambda noise: b"\xff" not in noise), st.binary(max_size=20))
def test_noise_before_and_between_answers_loses_none(noise, more):
    more = more.replace(b"\xff", b"\x00")
    answers = Answers({3, 4}, 2)
    answers.feed(noise + packet(3, b"\x01\x02") + more + packet(4, b"\x03\x04"))
    assert not answers.missing
    assert answers.skipped == len(noise) + len(more)


def test_answers_of_another_length_are_skipped_status_bits_kept_and_of_two_the_later_counts():
    answers = Answers({1, 2}, 2)
    answers.feed(packet(1, b"\x01\x02\x03") + packet(9, b"\x01\x02") + packet(2, b"\x07\x08"))
    assert answers.found.keys() == {2}
    answers = Answers({6}, 2)
    answers.feed(packet(6, b"\x01\x00") + packet(6, b"\x00\x08", faults=0x20))
    assert answers.found[6] == Answer(b"\x00\x08", Fault.OVERLOAD)


# Answers that break off, though the next header may fit


def as_bytes(ticks):
    return ticks.to_bytes(2, "little")


@pytest.mark.parametrize("servo_id", [1, 5])
def test_a_cut_position_costs_its_own_servo_and_nobody_else(servo_id):
    behind = packet(servo_id + 1, as_bytes(2048))
    for ticks in range(4096):
        whole = packet(servo_id, as_bytes(ticks))
        for missing in range(1, packet_size(2)):
            answers = Answers({servo_id, servo_id + 1}, 2)
            answers.feed(whole[:-missing] + behind)
            found = {i: answer.data for i, answer in answers.found.items()}
            assert found.pop(servo_id + 1) == as_bytes(2048)
            assert found in ({}, {servo_id: as_bytes(ticks)})


def test_a_byte_lost_anywhere_gives_no_wrong_answer_however_the_rest_is_cut():
    rng = random.Random(1617)
    for _ in range(1_000):
        sent = {i: rng.choices((0, 1, 2, 3, 0xF2, 0xFE, 0xFF), k=4) for i in (1, 2, 3)}
        begun = b"".join(packet(i, bytes(data)) for i, data in sent.items())
        at = rng.randrange(packet_size(4))
        stream = begun[:at] + begun[at + 1 :]
        found = []
        for size in (len(stream), 1, 2, 3, 7):
            answers = Answers(sent.keys(), 4)
            for start in range(0, len(stream), size):
                answers.feed(stream[start : start + size])
            found.append((answers.found, answers.skipped, answers.rest_count))
        assert all(each == found[0] for each in found)
        assert all(list(answer.data) == sent[i] for i, answer in answers.found.items())


class Torn:
    """A port on which every answer breaks off ``missing`` bytes before its end, once.

    What follows at once is a late answer of the same servo to another question.
    """

    name, baud = "/dev/torn", 1_000_000

    def __init__(self, data, missing):
        self._data, self._missing, self._asked = data, missing, 0
        self._arrived = b""

    def write(self, data):
        count = data[6]
        self._asked += 1
        answer = packet(data[2], self._data + bytes(count - len(self._data)))
        if self._asked == 1:
            answer = answer[: -self._missing] + packet(data[2], bytes(20))
        self._arrived = answer

    def read(self, until):
        data, self._arrived = self._arrived, b""
        return data

    def discard(self):
        self._arrived = b""

    def close(self):
        pass


@pytest.mark.parametrize("missing", range(1, 8))
@pytest.mark.parametrize("servo_id", range(1, 7))
def test_a_cut_answer_to_one_servo_is_asked_for_again(servo_id, missing):
    low = (-3 - servo_id) & 0xFF  # with FF FF in the place of what is missing, this adds up
    for high in range(16):
        bus = Bus(Torn(bytes((low, high)), missing), reply_timeout=0.0)
        assert bus.read(servo_id, reg.PRESENT_POSITION) == low + 256 * high


def test_a_register_that_looks_like_a_header_can_be_read_even_so():
    bus = Bus(Torn(b"\xff\xff\x00\x00\x00", 1), reply_timeout=0.0)
    assert bus.read_block(3, 50, 5) == b"\xff\xff\x00\x00\x00"
