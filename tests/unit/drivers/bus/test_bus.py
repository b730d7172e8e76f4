import pytest

from so101_motion.common.errors import CorruptReply, NoReply, PortUnavailable, ServoFault
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import RETRIES, Bus
from so101_motion.drivers.bus.registers import Fault

IDS = (1, 2, 3, 4, 5, 6)
POSITION = reg.PRESENT_POSITION
INSTRUCTION, WRITE = 4, 3


def positions(bus, ids=IDS, **how):
    found = bus.sync_read(ids, POSITION.address, POSITION.size, **how)
    return {servo_id: POSITION.decode(answer.data) for servo_id, answer in found.items()}


def test_registers_read_as_servos_hold_them_byte_by_byte_and_a_sync_write_reaches_all(port, bus):
    assert bus.read(1, POSITION) == 2048
    assert bus.read(6, reg.MODEL_NUMBER) == reg.STS3215_MODEL
    assert bus.read(2, reg.MAX_ACCELERATION) == 100
    port.chunk = 1
    assert positions(bus) == dict.fromkeys(IDS, 2048)
    assert bus.read(3, POSITION) == 2048
    bus.sync_write(reg.GOAL_POSITION.address, {i: bytes((i, 8)) for i in IDS})
    assert [port.memory(i, reg.GOAL_POSITION) for i in IDS] == [2048 + i for i in IDS]
    assert port.read(0.0) == b""


def test_a_port_that_says_that_nothing_came_is_not_asked_until_the_time_is_up(port):
    port.world.disconnect(3)
    with pytest.raises(NoReply):
        Bus(port, reply_timeout=600.0).read(3, POSITION)
    assert len(port.sent) == 1 + RETRIES


def test_a_dead_servo_costs_the_others_nothing(port, bus):
    port.world.disconnect(3)
    assert positions(bus).keys() == {1, 2, 4, 5, 6}
    assert bus.counters[3].lost == 1
    assert all(bus.counters[i].lost == 0 for i in IDS if i != 3)


def test_servos_given_up_are_asked_first_and_once(port, bus):
    port.world.disconnect(6)
    assert positions(bus, tries=2, given_up={6}).keys() == {1, 2, 3, 4, 5}
    assert len(port.sent) == 1
    assert port.sent[0][7:13] == bytes((6, 1, 2, 3, 4, 5))


def test_only_those_who_did_not_answer_are_asked_again(port, bus):
    port.world.disconnect(2)
    positions(bus, tries=3)
    assert [packet[7:-1] for packet in port.sent] == [bytes(IDS), b"\x02", b"\x02"]
    assert bus.counters[2].retries == 2


def test_a_silent_servo_is_an_error_that_names_servo_joint_port_and_tries(port, bus):
    port.world.disconnect(3)
    with pytest.raises(NoReply, match=r"servo 3 \(elbow_flex\) on .*4 tries; check") as info:
        bus.read(3, POSITION)
    assert (info.value.servo_id, info.value.register) == (3, "present_position")
    assert isinstance(info.value, TimeoutError)
    assert len(port.sent) == 1 + RETRIES
    bus = Bus(port, reply_timeout=0.001)  # it is given more time in the end
    port.limits.clear()
    with pytest.raises(NoReply):
        bus.read(3, POSITION)
    waited_until = [limit for limit in port.limits if limit]
    assert len(waited_until) == 1 + RETRIES
    assert waited_until[-1] - waited_until[-2] > 0.02


def test_answers_that_stay_garbled_are_an_error_with_the_bytes(port, bus):
    port.faults.corrupt = 1.0
    with pytest.raises(CorruptReply, match="nonsense") as info:
        bus.read(3, POSITION)
    assert info.value.raw
    assert bus.counters[3].corrupt == 1 + RETRIES


def test_status_bits_never_cost_a_reading_and_are_latched(port, bus):
    port.world.warm(3, 80.0)
    port.world.advance(1.0)
    assert bus.read(3, reg.PRESENT_TEMPERATURE) == 80
    assert bus.counters[3].faults == Fault.OVERHEATED
    port.world.servo(3).drive.motor.temperature = 30.0
    port.world.cool(3)
    port.world.advance(2.0)
    assert bus.ping(3) == Fault.NONE
    assert bus.counters[3].faults == Fault.NONE
    assert bus.counters[3].latched == Fault.OVERHEATED


def test_a_late_answer_is_not_taken_for_the_answer_to_the_next_question(port, bus):
    port.faults.late = 1.0
    with pytest.raises(NoReply):
        bus.read(1, reg.PRESENT_POSITION)
    port.faults.late = 0.0
    # The stale replies hold 2048 and arrive while these questions are under way.
    for _ in range(6):
        assert bus.read(1, reg.PRESENT_LOAD) == 0


def test_a_write_whose_acknowledgement_is_lost_counts_when_the_register_holds_it(port, bus):
    port.faults.loss = 0.3
    for value in range(1, 40):
        bus.write(2, reg.ACCELERATION, value)
        assert port.memory(2, reg.ACCELERATION) == value


def test_a_register_that_keeps_another_value_is_a_fault_that_says_which(port, bus):
    with pytest.raises(ServoFault, match="acceleration = 200 but holds 100"):
        bus.write(2, reg.ACCELERATION, 200)  # cut at register 85


def test_eeprom_is_written_only_where_it_differs_and_locked_again(port, bus):
    assert bus.store(4, {reg.P_GAIN: 16, reg.D_GAIN: 32}) == ("p_gain",)
    port.world.servo(4).boot()
    assert port.memory(4, reg.P_GAIN) == 16
    assert port.memory(4, reg.LOCK) == 1


def test_eeprom_that_is_right_is_not_even_unlocked_and_is_locked_after_a_failed_write(port, bus):
    assert bus.store(4, {reg.P_GAIN: 32, reg.MAX_TEMPERATURE: 70}) == ()
    assert all(packet[INSTRUCTION] != WRITE for packet in port.sent)
    with pytest.raises(ValueError, match="p_gain"):
        bus.store(4, {reg.P_GAIN: 255})
    assert port.memory(4, reg.LOCK) == 1


def written(port):
    """The addresses that were written, in order."""
    return [packet[5] for packet in port.sent if packet[INSTRUCTION] == WRITE]


@pytest.mark.parametrize("left_open", [False, True])
def test_what_is_overlaid_ends_with_the_power_though_another_program_left_the_servo_unlocked(
    port, bus, left_open
):
    bus.write(4, reg.LOCK, 0 if left_open else 1)
    port.sent.clear()
    assert bus.overlay(4, {reg.P_GAIN: 16, reg.D_GAIN: 32}) == ("p_gain",)
    lock = [reg.LOCK.address] if left_open else []
    assert written(port) == [*lock, reg.P_GAIN.address]
    assert port.memory(4, reg.P_GAIN) == 16
    port.world.servo(4).boot()
    assert port.memory(4, reg.P_GAIN) == 32
    assert bus.overlay(4, {reg.P_GAIN: 32}) == ()


def test_stored_anew_is_also_what_a_register_seems_to_hold_already(port, bus):
    assert bus.store(4, {reg.P_GAIN: 32, reg.D_GAIN: 32}, anew=True) == ()
    lock, gains = reg.LOCK.address, [reg.P_GAIN.address, reg.D_GAIN.address]
    assert written(port) == [lock, *gains, lock]


def test_a_new_id_is_kept_and_locked_at_the_new_id_unless_it_is_taken(port, bus):
    with pytest.raises(ServoFault, match="servo 5 already"):
        bus.change_id(6, 5)
    assert bus.ping_all().ids == tuple(IDS)
    bus.change_id(6, 9)
    assert bus.ping_all().ids == (1, 2, 3, 4, 5, 9)
    port.world.servo("gripper").boot()
    assert bus.ping(9) == Fault.NONE
    assert port.memory("gripper", reg.LOCK) == 1


def test_every_kind_of_question_reports_that_the_port_is_gone_and_works_after(port, bus):
    questions = [
        lambda: bus.ping(1),
        lambda: bus.read(1, POSITION),
        lambda: bus.write(1, reg.ACCELERATION, 5),
        lambda: positions(bus),
        lambda: bus.sync_write(reg.GOAL_POSITION.address, {1: b"\x00\x08"}),
        bus.ping_all,
    ]
    for ask in questions:
        port.unplugged = True
        with pytest.raises(PortUnavailable):
            ask()
        port.unplugged = False
        ask()


def test_two_servos_with_one_id_are_noticed_as_garbage(port, bus):
    port.world.servo(2).memory.set(
        __import__("so101_motion.drivers.emulator.registers", fromlist=["ID"]).ID, 1
    )
    port.world.servo(2).drive.shaft.output += 700.0
    with pytest.raises(CorruptReply, match="other servo has the id 1"):
        bus.read(1, POSITION)
