"""The manufacturer's own library on the emulated port: it must not notice anything.

The library spins while it waits and so starves the emulator's thread in the same process; it gets
more patience here than the 34 ms it has by itself, and threads take turns more often.
"""

import sys
import time

import pytest
import scservo_sdk as sdk

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.pty_port import Pacing

NO_REPLY = -6


class PatientPort(sdk.PortHandler):
    """The library's port with another reply time-out."""

    patience_ms = 10_000

    def setPacketTimeout(self, packet_length):
        self.setPacketTimeoutMillis(self.patience_ms)


class Client:
    """The library's calls as its examples make them."""

    def __init__(self, port, baud=1_000_000):
        self.port = PatientPort(port)
        self.packets = sdk.PacketHandler(0)
        assert self.port.openPort()
        assert self.port.setBaudRate(baud)

    def close(self):
        self.port.closePort()

    def ping(self, servo_id):
        model, result, error = self.packets.ping(self.port, servo_id)
        assert result == sdk.COMM_SUCCESS
        return model, error

    def is_silent(self, servo_id):
        self.port.patience_ms = 50
        _, result, _ = self.packets.ping(self.port, servo_id)
        self.port.patience_ms = PatientPort.patience_ms
        return result == NO_REPLY

    def read(self, servo_id, row):
        call = (None, self.packets.read1ByteTxRx, self.packets.read2ByteTxRx)[row.size]
        value, result, error = call(self.port, servo_id, row.address)
        assert (result, error) == (sdk.COMM_SUCCESS, 0)
        return value

    def write(self, servo_id, row, value):
        call = (None, self.packets.write1ByteTxRx, self.packets.write2ByteTxRx)[row.size]
        assert call(self.port, servo_id, row.address, value) == (sdk.COMM_SUCCESS, 0)

    def sync_read(self, row, ids):
        group = sdk.GroupSyncRead(self.port, self.packets, row.address, row.size)
        for servo_id in ids:
            assert group.addParam(servo_id)
        assert group.txRxPacket() == sdk.COMM_SUCCESS
        return [group.getData(servo_id, row.address, row.size) for servo_id in ids]

    def sync_write(self, row, values):
        group = sdk.GroupSyncWrite(self.port, self.packets, row.address, row.size)
        for servo_id, value in values.items():
            assert group.addParam(servo_id, list(value.to_bytes(row.size, "little")))
        assert group.txPacket() == sdk.COMM_SUCCESS


@pytest.fixture(autouse=True)
def threads_take_turns_often():
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)
    yield
    sys.setswitchinterval(interval)


@pytest.fixture
def emulator(clock):
    options = EmulatorOptions(pacing=Pacing(realtime=True))
    with Emulator(options, now=clock.now) as emulator:
        yield emulator


@pytest.fixture
def client(emulator):
    client = Client(emulator.port)
    yield client
    client.close()


def test_sdk_pings_everybody_and_misses_nobody_else(client):
    assert [client.ping(i) for i in range(1, 7)] == [(777, 0)] * 6
    assert client.is_silent(7)


def test_sdk_reads_and_writes(client):
    client.write(3, reg.ACCELERATION, 50)
    assert client.read(3, reg.ACCELERATION) == 50
    assert client.read(3, reg.PRESENT_POSITION) == 2048
    assert client.read(3, reg.PRESENT_VOLTAGE) == 120


@pytest.mark.breaks("seed", reason="this client does not look before it writes a goal")
def test_sdk_moves_all_joints_by_sync_write_and_watches_by_sync_read(client, emulator, clock):
    goals = {servo_id: 2048 + 40 * servo_id for servo_id in range(1, 7)}
    client.sync_write(reg.GOAL_POSITION, goals)
    assert client.sync_read(reg.PRESENT_POSITION, list(goals)) == [2048] * 6
    clock.advance(3.0)
    emulator.advance()
    reached = client.sync_read(reg.PRESENT_POSITION, list(goals))
    assert reached == [pytest.approx(goal, abs=2) for goal in goals.values()]


def test_real_time_takes_at_least_the_time_of_the_wire(clock):
    options = EmulatorOptions(pacing=Pacing(realtime=True))
    with Emulator(options, now=clock.now) as emulator:
        client = Client(emulator.port)
        start = time.perf_counter()
        client.sync_read(reg.PRESENT_POSITION, [1, 2, 3, 4, 5, 6])
        assert time.perf_counter() - start >= 790e-6  # 14 bytes out, six slots back
        client.close()
