"""Answers that break off are never believed with a wrong value, though the next header may fit."""

import random

import pytest

from so101_motion.common.errors import BusError
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.protocol import Answers, checksum, packet_size


def packet(servo_id, data, faults=0):
    body = bytes((servo_id, len(data) + 2, faults)) + data
    return b"\xff\xff" + body + bytes((checksum(body),))


def position(ticks):
    return ticks.to_bytes(2, "little")


@pytest.mark.parametrize("servo_id", range(1, 6))
def test_a_cut_position_costs_its_own_servo_and_nobody_else(servo_id):
    behind = packet(servo_id + 1, position(2048))
    for ticks in range(4096):
        whole = packet(servo_id, position(ticks))
        for missing in range(1, packet_size(2)):
            answers = Answers({servo_id, servo_id + 1}, 2)
            answers.feed(whole[:-missing] + behind)
            found = {i: answer.data for i, answer in answers.found.items()}
            assert found.pop(servo_id + 1) == position(2048)
            assert found in ({}, {servo_id: position(ticks)})


def test_a_cut_block_of_figures_is_never_believed_with_a_wrong_one():
    rng = random.Random(16)
    for _ in range(20_000):
        sent = {i: rng.randbytes(15).replace(b"\xff", b"\x0f") for i in (1, 2)}
        whole, behind = (packet(i, data) for i, data in sent.items())
        answers = Answers(sent.keys(), 15)
        answers.feed(whole[: -rng.randrange(1, len(whole))] + behind)
        assert all(answer.data == sent[i] for i, answer in answers.found.items())


def test_a_byte_lost_anywhere_gives_no_wrong_answer_however_the_rest_is_cut():
    rng = random.Random(1617)
    for _ in range(5_000):
        sent = {i: rng.choices((0, 1, 2, 3, 0xF2, 0xFE, 0xFF), k=4) for i in (1, 2, 3)}
        begun = b"".join(packet(i, bytes(data)) for i, data in sent.items())
        at = rng.randrange(packet_size(4))
        stream = begun[:at] + begun[at + 1 :]
        found = []
        for size in (len(stream), 1, 2, 3, 7):
            answers = Answers(sent.keys(), 4)
            for start in range(0, len(stream), size):
                answers.feed(stream[start : start + size])
            found.append((answers.found, answers.skipped, answers.rest))
        assert all(each == found[0] for each in found)
        assert all(list(answer.data) == sent[i] for i, answer in answers.found.items())


def test_an_answer_that_ends_in_the_next_header_is_taken_back():
    lost_its_status = bytes.fromhex("FF FF 01 06 01 02 03 FF F4")
    answers = Answers({1, 2}, 4)
    answers.feed(lost_its_status + packet(2, b"\x01\x02\x03\x04"))
    assert answers.found.keys() == {2}


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


def test_an_answer_that_never_comes_whole_is_an_error():
    class AlwaysTorn(Torn):
        def write(self, data):
            self._asked = 0
            super().write(data)

    bus = Bus(AlwaysTorn(bytes(((-3 - 3) & 0xFF, 7)), 2), reply_timeout=0.0)
    with pytest.raises(BusError):
        bus.read(3, reg.PRESENT_POSITION)
