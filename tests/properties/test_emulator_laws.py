"""Laws of the emulated bus and its motion, whatever the traffic."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.bus import Bus
from so101_motion.drivers.emulator.codec import BROADCAST, Listener, frame
from so101_motion.drivers.emulator.emulator import EmulatorOptions, build_world
from so101_motion.drivers.emulator.motion import DT, Profile

packets = st.builds(
    frame, st.integers(0, BROADCAST), st.integers(0, 0xFE), st.binary(max_size=20)
).filter(lambda packet: b"\xff\xff" not in packet[2:] and packet[-1] != 0xFF)
# A payload with two 255 in a row is not heard by any servo; a checksum of 255 merges with the
# header that follows.


def heard(listener, data):
    return [frame(i.servo_id, i.code, i.params) for i in listener.hear(data)]


@given(packets, st.data())
def test_single_flipped_bit_never_yields_another_packet(packet, data):
    bit = data.draw(st.integers(0, 8 * len(packet) - 1))
    flipped = bytearray(packet)
    flipped[bit // 8] ^= 1 << bit % 8
    assert heard(Listener(), bytes(flipped)) == []


@given(st.binary(max_size=40), packets)
def test_garbage_before_a_packet_costs_nothing_but_itself(garbage, packet):
    listener = Listener()
    listener.hear(garbage)
    assert packet in heard(listener, b"\x00" + packet)


@settings(max_examples=40)
@given(
    address=st.integers(0, reg.SIZE + 3),
    count=st.integers(0, reg.SIZE),
    ms=st.integers(0, 400),
    multi_turn=st.booleans(),
)
def test_a_read_of_a_few_registers_shows_what_a_read_of_all_would(address, count, ms, multi_turn):
    world = build_world(EmulatorOptions(), gravity=lambda q: 0.3 * np.cos(q))
    servo = world.servos[1]
    if multi_turn:
        servo.memory.set(reg.PHASE, servo.memory.raw(reg.PHASE) | reg.PHASE_MULTI_TURN)
    servo.write(bytes((42,)) + (2500).to_bytes(2, "little"))
    world.advance(ms / 1000.0)
    some = servo.read(address, count)
    whole = servo.read(0, reg.SIZE)
    assert (some or b"") == whole[address : address + count]


@given(st.binary(max_size=300))
def test_servos_survive_any_bytes(data):
    world = build_world(EmulatorOptions())
    bus = Bus(world)
    bus.feed(data, 0.0)
    for servo in world.servos:
        servo.write(data[:128])
        servo.read(0, reg.SIZE)
    world.advance(0.05)
    assert np.isfinite(world.q).all()


@given(
    acceleration=st.floats(100, 8000),
    speed=st.floats(50, 7500),
    goals=st.lists(
        st.tuples(st.integers(-3000, 3000), st.integers(1, 800)), min_size=1, max_size=5
    ),
)
def test_profile_keeps_its_limits_and_ends_on_its_last_goal(acceleration, speed, goals):
    profile = Profile(0.0)
    profile.acceleration, profile.speed, profile.floor = acceleration, speed, 50.0
    velocities, target = [0.0], 0.0
    for goal, steps in goals:
        profile.target = target = float(goal)
        for _ in range(steps):
            profile.step()
            velocities.append(profile.velocity)
    while profile.running:
        profile.step()
        velocities.append(profile.velocity)
    assert profile.position == target
    assert np.abs(velocities).max() <= max(speed, profile.floor) + 1e-6
    # Off and onto the floor it jumps; everywhere else it accelerates within its limit.
    assert np.abs(np.diff(velocities)).max() <= acceleration * DT + 2 * profile.floor + 1e-6


@settings(max_examples=12)  # each computes seconds of six moving joints
@given(
    goals=st.lists(st.integers(1000, 3000), min_size=1, max_size=3),
    cuts=st.lists(st.integers(1, 400), min_size=1, max_size=12),
)
def test_looking_more_often_changes_nothing(goals, cuts):
    """The world is where it is, however many times somebody asked on the way."""
    end = sum(cuts) + 300
    states = []
    for looks in (cuts, [sum(cuts)]):
        world = build_world(EmulatorOptions(), gravity=lambda q: 0.3 * np.cos(q))
        for servo, goal in zip(world.servos, goals, strict=False):
            servo.write(bytes((42,)) + goal.to_bytes(2, "little"))
        ms = 0
        for look in looks:
            ms += look
            world.advance(ms / 1000.0)
        world.advance(end / 1000.0)
        states.append(world.q)
    np.testing.assert_array_equal(states[0], states[1])


@given(row=st.sampled_from(sorted(reg.REGISTERS.values(), key=lambda r: r.address)), data=st.data())
def test_every_register_decodes_what_it_encodes(row, data):
    top = 8 * row.size if row.sign_bit is None else row.sign_bit
    lowest = 0 if row.sign_bit is None else -(1 << top) + 1
    value = data.draw(st.integers(lowest, (1 << top) - 1))
    assert row.decode(row.encode(value)) == value
