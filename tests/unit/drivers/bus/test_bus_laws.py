"""Laws of the bus: it believes no wrong answer, whatever happens on the wire."""

from contextlib import suppress
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from so101_motion.common.errors import BusError
from so101_motion.drivers.bus import bus as bus_module
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus

READABLE = (
    reg.PRESENT_POSITION,
    reg.GOAL_POSITION,
    reg.PRESENT_VOLTAGE,
    reg.P_GAIN,
    reg.TORQUE_LIMIT,
)
WRITABLE = (reg.ACCELERATION, reg.GOAL_VELOCITY, reg.TORQUE_LIMIT)
ids = st.integers(1, 6)

requests = st.one_of(
    st.tuples(st.just("read"), ids, st.sampled_from(READABLE)),
    st.tuples(st.just("write"), ids, st.sampled_from(WRITABLE), st.integers(1, 100)),
    st.tuples(st.just("sync"), st.sampled_from(READABLE)),
    st.tuples(st.just("goal"), ids, st.integers(0, 4095)),
    st.tuples(st.just("ping"), ids),
)

faults = st.fixed_dictionaries(
    {
        "loss": st.sampled_from([0.0, 0.05, 0.4]),
        "request_loss": st.sampled_from([0.0, 0.1]),
        "corrupt": st.sampled_from([0.0, 0.02, 0.4]),
        "duplicate": st.sampled_from([0.0, 0.3]),
        "late": st.sampled_from([0.0, 0.3]),
    }
)


@pytest.fixture(autouse=True)
def no_time_passes(monkeypatch):
    """The late answers of these servos are counted in packets, however long a computer pauses."""
    monkeypatch.setattr(bus_module, "time", SimpleNamespace(monotonic=lambda: 0.0))


def make(wired, seed, late_by):
    """Servos that all differ in every register that is asked for."""
    port = wired(late_by=late_by)
    port.faults.__init__(seed=seed)
    for number, servo in enumerate(port.world.servos, start=1):
        servo.drive.shaft.output += 37.0 * number
        for row, value in ((reg.GOAL_VELOCITY, 60 + number), (reg.P_GAIN, 20 + number)):
            servo.write(bytes((row.address, *row.encode(value))))
        servo.drive.volts = 7.0 + 0.3 * number
    return port, Bus(port, reply_timeout=0.0)


def believe(port, bus, request):
    """Carry out one request; whatever is believed must be true."""
    match request:
        case "read", servo_id, row:
            assert bus.read(servo_id, row) == port.memory(servo_id, row)
        case "write", servo_id, row, value:
            bus.write(servo_id, row, value)
            assert port.memory(servo_id, row) == value
        case "sync", row:
            for servo_id, answer in bus.sync_read(range(1, 7), row.address, row.size).items():
                assert row.decode(answer.data) == port.memory(servo_id, row)
        case "goal", servo_id, tick:
            row = reg.GOAL_POSITION
            bus.sync_write(row.address, {servo_id: row.encode(tick)})
        case "ping", servo_id:
            bus.ping(servo_id)


def trouble(port, bus, shares, sequence):
    for name, share in shares.items():
        setattr(port.faults, name, share)
    for request in sequence:
        with suppress(BusError):
            believe(port, bus, request)


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(requests, min_size=1, max_size=25),
    faults,
    st.integers(0, 2**16),
    st.integers(1, 4),
    st.sampled_from([1, 3, 4096]),
)
def test_a_value_is_right_or_there_is_none(wired, sequence, shares, seed, late_by, chunk):
    port, bus = make(wired, seed, late_by)
    port.chunk = chunk
    trouble(port, bus, shares, sequence)


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(requests, max_size=6), faults, st.integers(0, 2**16), requests)
def test_when_the_wire_is_well_again_the_next_request_works(wired, before, shares, seed, request_):
    port, bus = make(wired, seed, late_by=1)
    trouble(port, bus, shares, before)
    for name in shares:
        setattr(port.faults, name, 0.0)
    believe(port, bus, request_)


def test_at_five_percent_loss_and_two_percent_corruption_a_read_practically_never_fails(wired):
    port, bus = make(wired, 11, 3)
    port.faults.loss, port.faults.corrupt = 0.05, 0.02
    for _ in range(3000):
        assert bus.read(3, reg.P_GAIN) == 23
    counter = bus.counters[3]
    assert counter.answers == 3000
    assert counter.lost + counter.corrupt == counter.retries == pytest.approx(226, abs=60)
