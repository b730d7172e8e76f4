from itertools import pairwise

import pytest

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.memory import Memory
from so101_motion.drivers.emulator.registers import REGISTERS


def test_rows_do_not_overlap_stay_inside_the_map_and_have_defaults_in_their_range():
    rows = sorted(REGISTERS.values(), key=lambda row: row.address)
    assert all(a.address + a.size <= b.address for a, b in pairwise(rows))
    assert rows[-1].address + rows[-1].size == reg.SIZE
    for name, row in REGISTERS.items():
        assert row.lower <= row.decode(row.default) <= row.upper, name


@pytest.mark.parametrize(
    ("offset", "raw"), [(0, 0), (85, 85), (-85, 0x855), (2047, 0x7FF), (-2047, 0xFFF),
                        (2048, 0x1000), (-2048, 0x1800), (4095, 0x17FF), (-4095, 0x1FFF)],
)  # fmt: skip
def test_homing_offset_has_a_sign_and_one_extra_bit(offset, raw):
    assert reg.encode_offset(offset) == raw
    assert reg.decode_offset(raw) == offset


def test_writes_with_lock_open_survive_a_reboot_and_others_do_not():
    memory = Memory()
    memory.write(reg.P_GAIN.address, bytes((16,)))  # locked: effective, not kept
    assert memory.value(reg.P_GAIN) == 16
    memory.boot()
    assert memory.value(reg.P_GAIN) == 32
    memory.write(reg.LOCK.address, b"\0")
    memory.write(reg.P_GAIN.address, bytes((16,)))
    memory.boot()
    assert memory.value(reg.P_GAIN) == 16
    assert memory.value(reg.LOCK) == 1


def test_measured_bytes_inside_a_written_span_are_skipped():
    memory = Memory()
    before = memory.read(56, 15)
    memory.write(55, bytes(16))
    assert memory.read(56, 15) == before
    assert memory.value(reg.LOCK) == 0


def test_torque_limit_follows_its_maximum_at_power_up_only():
    memory = Memory()
    memory.write(reg.LOCK.address, b"\0")
    memory.write(reg.MAX_TORQUE.address, (500).to_bytes(2, "little"))
    assert memory.value(reg.TORQUE_LIMIT) == 1000
    memory.boot()
    assert memory.value(reg.TORQUE_LIMIT) == 500
