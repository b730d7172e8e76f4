import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.registers import REGISTERS, Fault, Memory, Register
from so101_motion.drivers.emulator import registers as theirs
from so101_motion.drivers.emulator.registers import Keep

rows = st.sampled_from(sorted(REGISTERS.values(), key=lambda row: row.address))


def test_no_two_registers_share_a_byte():
    ordered = sorted(REGISTERS.values(), key=lambda row: row.address)
    for row, following in pairwise(ordered):
        assert row.address + row.size <= following.address, (row.name, following.name)
    assert ordered[-1].address + ordered[-1].size <= reg.END


NAMED_OTHERWISE = {
    "model_number": "MODEL", "baud_rate": "BAUD", "unloading_condition": "UNLOADING",
    "angular_resolution": "RESOLUTION", "homing_offset": "OFFSET", "operating_mode": "MODE",
}  # fmt: skip


def test_the_table_agrees_with_the_emulators_own():
    same = {Memory.MEASURED: Keep.READ_ONLY, Memory.RAM: Keep.RAM, Memory.EEPROM: Keep.EEPROM}
    for row in REGISTERS.values():
        other = theirs.REGISTERS[NAMED_OTHERWISE.get(row.name, row.name.upper())]
        assert (row.address, row.size) == (other.address, other.size), row.name
        assert same[row.memory] == other.keep, row.name
        if row is not reg.HOMING_OFFSET:  # the emulator encodes it by hand
            assert row.sign_bit == other.sign_bit, row.name
            assert other.lower <= row.lower < row.upper <= other.upper, row.name


@pytest.mark.parametrize(
    ("row", "count", "worth"),
    [
        (reg.GOAL_POSITION, 4096, 2.0 * math.pi),
        (reg.MIN_POSITION, 2048, math.pi),
        (reg.HOMING_OFFSET, 1024, math.pi / 2.0),
        (reg.GOAL_VELOCITY, 4096, 2.0 * math.pi),  # a turn a second
        (reg.PRESENT_VELOCITY, 4096, 2.0 * math.pi),
        (reg.MAX_SPEED, 80, 2.0 * math.pi * 4000 / 4096),
        (reg.ACCELERATION, 10, 2.0 * math.pi * 1000 / 4096),
        (reg.MAX_ACCELERATION, 10, 2.0 * math.pi * 1000 / 4096),
        (reg.TORQUE_LIMIT, 1000, 1.0),
        (reg.MAX_TORQUE, 500, 0.5),
        (reg.PRESENT_LOAD, 1000, -1.0),  # towards lower ticks
        (reg.PROTECTIVE_TORQUE, 20, 0.2),
        (reg.OVERLOAD_TORQUE, 80, 0.8),
        (reg.PROTECTION_TIME, 200, 2.0),
        (reg.PROTECTION_CURRENT, 500, 3.25),
        (reg.PRESENT_CURRENT, 100, 0.65),
        (reg.PRESENT_VOLTAGE, 121, 12.1),
        (reg.MAX_TEMPERATURE, 70, 70.0),
    ],
)
def test_counts_of_a_register_are_worth_what_the_data_sheet_says(row, count, worth):
    assert count * row.scale == pytest.approx(worth)


@given(rows, st.data())
def test_what_is_written_reads_back(row, data):
    value = data.draw(st.integers(row.lower, row.upper))
    assert row.decode(row.encode(value)) == value
    assert len(row.encode(value)) == row.size


@given(rows)
def test_values_outside_the_range_are_refused_by_name(row):
    for value in (row.lower - 1, row.upper + 1):
        with pytest.raises(ValueError, match=row.name):
            row.encode(value)


@pytest.mark.parametrize(
    ("row", "raw", "value"),
    [
        (reg.PRESENT_POSITION, b"\x18\x05", 1304),  # the manual's example
        (reg.PRESENT_POSITION, b"\x01\x80", -1),
        (reg.PRESENT_LOAD, b"\x64\x04", -100),
        (reg.PRESENT_LOAD, b"\xe8\x03", 1000),
        (reg.HOMING_OFFSET, b"\x64\x08", -100),
        (reg.HOMING_OFFSET, b"\x01\x10", 2049),  # firmware 3.10 goes beyond 11 bits
        (reg.MODEL_NUMBER, b"\x09\x03", 777),
    ],
)
def test_signs_are_where_the_servo_puts_them(row, raw, value):
    assert row.decode(raw) == value


def test_zero_speed_and_zero_acceleration_cannot_be_written():
    for row in (reg.GOAL_VELOCITY, reg.ACCELERATION):
        with pytest.raises(ValueError, match="1 to"):
            row.encode(0)


def test_a_register_is_cut_out_of_a_block_and_decodes_exactly_its_bytes():
    with pytest.raises(ValueError, match="2 bytes"):
        reg.PRESENT_POSITION.decode(b"\x01")
    block = bytes(range(56, 71))
    assert reg.PRESENT_TEMPERATURE.cut(block, 56) == 63
    assert reg.PRESENT_CURRENT.cut(block, 56) == 69 + 256 * 70


def test_faults_have_names_and_unknown_bits_do_no_harm():
    assert Fault(0x21).names == ("voltage", "overload")
    assert Fault(0x40).names == ()
    assert Fault(0).names == ()
    assert isinstance(reg.ID, Register)
