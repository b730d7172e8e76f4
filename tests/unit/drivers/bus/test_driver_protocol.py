import pytest
import scservo_sdk
from hypothesis import given
from hypothesis import strategies as st

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


def test_the_manuals_example_is_understood():
    answers = Answers({1}, 2)
    answers.feed(bytes.fromhex("FF FF 01 04 00 18 05 DD"))
    assert answers.found == {1: Answer(b"\x18\x05", Fault.NONE)}
    assert answers.is_complete


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
    assert answers.rest == b""


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
    assert answers.skipped + len(answers.rest) > 0


@given(st.binary(max_size=30).filter(lambda noise: b"\xff" not in noise), st.binary(max_size=20))
def test_noise_before_and_between_answers_loses_none(noise, more):
    more = more.replace(b"\xff", b"\x00")
    answers = Answers({3, 4}, 2)
    answers.feed(noise + packet(3, b"\x01\x02") + more + packet(4, b"\x03\x04"))
    assert answers.is_complete
    assert answers.skipped == len(noise) + len(more)


def test_answers_of_another_length_or_servo_are_skipped():
    answers = Answers({1, 2}, 2)
    answers.feed(packet(1, b"\x01\x02\x03") + packet(9, b"\x01\x02") + packet(2, b"\x07\x08"))
    assert answers.found.keys() == {2}


def test_status_bits_come_with_a_valid_reading():
    answers = Answers({6}, 2)
    answers.feed(packet(6, b"\x00\x08", faults=0x20))
    assert answers.found[6] == Answer(b"\x00\x08", Fault.OVERLOAD)


def test_of_two_answers_the_later_one_counts():
    answers = Answers({1}, 2)
    answers.feed(packet(1, b"\x01\x00") + packet(1, b"\x02\x00"))
    assert answers.found[1].data == b"\x02\x00"


@pytest.mark.parametrize(("count", "size"), [(0, 6), (2, 8), (15, 21)])
def test_packets_have_six_bytes_besides_their_data(count, size):
    assert packet_size(count) == size == len(packet(1, bytes(count)))
