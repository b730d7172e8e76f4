from dataclasses import replace
from itertools import pairwise

import pytest

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.bus import TURNAROUND
from so101_motion.drivers.emulator.codec import BROADCAST, Code, frame
from so101_motion.drivers.emulator.joint_figures import SO101
from so101_motion.drivers.emulator.memory import Memory
from so101_motion.drivers.emulator.registers import REGISTERS

BYTE = 10e-6  # one byte on the wire at 1 Mbaud [s]


def word(value):
    return value.to_bytes(2, "little")


def test_ping_and_position_are_answered_as_in_the_manual(bench):
    (reply,) = bench.raw(bytes.fromhex("FF FF 01 02 01 FB"))
    assert reply.data == bytes.fromhex("FF FF 01 02 00 FC")
    assert reply.after == pytest.approx(12 * BYTE + TURNAROUND)
    (reply,) = bench.raw(bytes.fromhex("FF FF 01 04 02 38 02 BE"))
    assert reply.data == bytes.fromhex("FF FF 01 04 00 00 08 F2")


@pytest.mark.parametrize(
    "packet",
    [
        frame(9, Code.PING),  # nobody's id
        bytes.fromhex("FF FF 01 02 01 FA"),  # wrong checksum
        frame(1, Code.READ, bytes((56,))),  # a read needs address and count
        frame(1, Code.READ, bytes((56, 2, 0))),
        frame(1, Code.READ, bytes((90, 2))),  # beyond the last register
        frame(BROADCAST, Code.READ, bytes((56, 2))),
        frame(BROADCAST, Code.WRITE, bytes((40, 0))),
        frame(BROADCAST, Code.SYNC_WRITE, bytes((40, 1, 1, 0))),
        frame(1, Code.REBOOT),
    ],
)
def test_silence(bench, packet):
    assert bench.raw(packet) == []


def test_every_register_can_be_read_and_nobody_hears_a_terminal_that_is_hung_up(bench):
    whole = bench.ask_one(3, Code.READ, bytes((0, 87))).data
    assert len(whole) == 87
    assert whole[:6] == bytes((3, 10, 0, 9, 3, 3))  # firmware 3.10, model 777, id 3
    assert bench.ask_one(1, 0x63).data == b""
    assert bench.raw(frame(1, Code.PING), baud=0) == []
    assert bench.ask_one(1, Code.PING).servo_id == 1


def test_status_level_zero_leaves_only_ping_and_read_answered(bench):
    assert bench.ask(1, Code.WRITE, bytes((reg.STATUS_LEVEL.address, 0))) == []
    assert bench.ask(1, Code.WRITE, bytes((40, 1))) == []
    assert len(bench.ask(1, Code.PING)) == 1
    assert bench.read(1, reg.TORQUE_ENABLE) == 1


def test_id_change_is_acknowledged_under_the_old_id(bench):
    assert bench.ask_one(6, Code.WRITE, bytes((reg.ID.address, 17))).servo_id == 6
    assert bench.ask(6, Code.PING) == []
    assert bench.ask_one(17, Code.PING).servo_id == 17


def test_registered_write_waits_for_action(bench):
    params = bytes((reg.GOAL_POSITION.address,)) + word(2100)
    assert bench.ask_one(1, Code.REG_WRITE, params).data == b""
    assert bench.read(1, reg.PENDING) == 1
    assert bench.read(1, reg.GOAL_POSITION) == 0
    assert bench.ask(BROADCAST, Code.ACTION) == []
    assert bench.read(1, reg.PENDING) == 0
    assert bench.read(1, reg.GOAL_POSITION) == 2100


def test_sync_read_is_answered_in_list_order_and_in_slots_a_silent_servos_too(bench):
    request = frame(BROADCAST, Code.SYNC_READ, bytes((56, 2, 3, 1, 6)))
    replies = bench.raw(request)
    assert [reply.data[2] for reply in replies] == [3, 1, 6]
    slot = (2 + 6 + 3) * BYTE
    start = len(request) * BYTE + TURNAROUND + 8 * BYTE
    assert [reply.after for reply in replies] == pytest.approx(
        [start, start + slot, start + 2 * slot]
    )
    bench.world.disconnect("shoulder_pan")
    holed = {reply.data[2]: reply.after for reply in bench.raw(request)}
    assert holed == {3: replies[0].after, 6: replies[2].after}


def test_broadcast_ping_is_answered_in_slots_by_id(bench):
    replies = bench.raw(frame(BROADCAST, Code.PING))
    assert [reply.data[2] for reply in replies] == [1, 2, 3, 4, 5, 6]
    gaps = {round((b.after - a.after) / BYTE, 6) for a, b in pairwise(replies)}
    assert gaps == {9.0}


def test_reboot_is_silent_for_most_of_a_second_and_forgets_ram(bench):
    bench.write(1, reg.TORQUE_ENABLE, 1)
    bench.write(1, reg.ACCELERATION, 50)
    bench.ask(1, Code.REBOOT)
    bench.advance(0.7)
    assert bench.ask(1, Code.PING) == []
    bench.advance(0.2)
    assert bench.read(1, reg.TORQUE_ENABLE) == 0
    assert bench.read(1, reg.ACCELERATION) == 0
    assert bench.read(1, reg.LOCK) == 1


@pytest.mark.parametrize("encoder", [0, 85, 2047, 2048, 3000, 4095])
def test_writing_128_makes_here_the_middle_and_survives(make_bench, encoder):
    bench = make_bench(joints=tuple(replace(joint, zero_ticks=encoder) for joint in SO101))
    bench.write(5, reg.TORQUE_ENABLE, 128)
    bench.advance(0.002)
    assert bench.read(5, reg.PRESENT_POSITION) == 2048
    assert bench.read(5, reg.TORQUE_ENABLE) == 0
    assert reg.decode_offset(bench.read(5, reg.OFFSET)) == encoder - 2048
    bench.ask(5, Code.REBOOT)
    bench.advance(1.0)
    assert bench.read(5, reg.PRESENT_POSITION) == 2048


def test_offset_moves_the_position_frame_from_the_next_control_period_on(bench):
    bench.ask_one(5, Code.CALIBRATE, word(1000))
    bench.advance(0.002)
    assert bench.read(5, reg.PRESENT_POSITION) == 1000
    bench.write(1, reg.OFFSET, reg.encode_offset(-500))
    assert bench.read(1, reg.PRESENT_POSITION) == 2048
    for _ in range(8):  # the clock stands still, the wire does not
        bench.ask_one(1, Code.PING)
    assert bench.read(1, reg.PRESENT_POSITION) == 2548
    bench.write(1, reg.OFFSET, reg.encode_offset(2047))
    bench.advance(0.01)
    assert bench.read(1, reg.PRESENT_POSITION) == 1


def test_turns_are_counted_until_cleared(bench):
    drive = bench.world.servo(5).drive
    drive.shaft.lower, drive.shaft.upper = -1e6, 1e6
    for position in range(2048, 6000, 500):
        drive.shaft.put(float(position))
    bench.write(5, reg.PHASE, 12 | reg.PHASE_MULTI_TURN)
    assert bench.read(5, reg.PRESENT_POSITION) == 5548
    bench.ask_one(5, Code.CLEAR_TURNS)
    assert bench.read(5, reg.PRESENT_POSITION) == 5548 - 4096
    bench.write(5, reg.PHASE, 12)
    assert bench.read(5, reg.PRESENT_POSITION) == 5548 - 4096


def test_defaults_or_a_saved_backup_come_back_except_the_id(bench):
    bench.write(1, reg.LOCK, 0)
    bench.write(1, reg.ID, 9)
    bench.write(9, reg.P_GAIN, 16)
    bench.ask_one(9, Code.RESTORE_DEFAULTS)
    assert bench.read(9, reg.P_GAIN) == 32
    for gain, code in ((16, Code.SAVE_BACKUP), (64, Code.RESTORE_DEFAULTS)):
        bench.write(9, reg.P_GAIN, gain)
        bench.ask_one(9, code)
    assert bench.read(9, reg.P_GAIN) == 16


def test_readings_scatter_when_asked_to(make_bench):
    bench = make_bench(dither=3)
    seen = {bench.read(1, reg.PRESENT_POSITION) for _ in range(200)}
    assert seen == set(range(2045, 2052))


def test_a_goal_switches_torque_on_unless_told_otherwise(make_bench):
    for is_firmware in (True, False):
        bench = make_bench(goal_enables_torque=is_firmware)
        bench.write(1, reg.GOAL_POSITION, 2300)
        bench.advance(1.0)
        assert bench.read(1, reg.TORQUE_ENABLE) == is_firmware
        assert bench.read(1, reg.PRESENT_POSITION) == (
            pytest.approx(2300, abs=3) if is_firmware else 2048
        )


ROLL = 5  # turns freely through most of a turn


def in_mode(bench, mode):
    bench.write(ROLL, reg.LOCK, 0)
    bench.write(ROLL, reg.MODE, mode)


def position(bench):
    return bench.read(ROLL, reg.PRESENT_POSITION)


@pytest.mark.parametrize("speed", [400, -400])
def test_in_speed_mode_it_turns_as_fast_as_it_is_told_and_stops(bench, speed):
    in_mode(bench, reg.SPEED_MODE)
    bench.write(ROLL, reg.ACCELERATION, 50)
    bench.write(ROLL, reg.GOAL_VELOCITY, speed)
    assert bench.read(ROLL, reg.TORQUE_ENABLE) == 1
    bench.advance(1.0)
    begin = position(bench)
    assert bench.read(ROLL, reg.PRESENT_VELOCITY) == pytest.approx(speed, abs=50)
    assert bench.read(ROLL, reg.MOVING) == 1
    bench.advance(1.0)
    assert position(bench) - begin == pytest.approx(speed, rel=0.05)
    bench.write(ROLL, reg.GOAL_VELOCITY, 0)
    bench.advance(1.0)
    stopped = position(bench)
    bench.advance(1.0)
    assert position(bench) == pytest.approx(stopped, abs=1)
    assert bench.read(ROLL, reg.MOVING) == 0


def test_in_step_mode_a_goal_is_so_much_farther(bench):
    in_mode(bench, reg.STEP_MODE)
    begin = position(bench)
    for _ in range(2):
        bench.write(ROLL, reg.GOAL_POSITION, 100)
        bench.advance(1.0)
    assert position(bench) - begin == pytest.approx(200, abs=10)
    bench.write(ROLL, reg.MAX_POSITION, begin + 250)
    bench.write(ROLL, reg.GOAL_POSITION, 100)
    bench.advance(1.0)
    assert position(bench) - begin == pytest.approx(250, abs=10), "clamped like any goal"


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
