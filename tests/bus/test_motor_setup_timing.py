"""How long motor setup waits for servos that do not answer, counted instead of timed."""

import time
from contextlib import nullcontext

import pytest
from harness.heard_port import open_heard

from so101_motion.common.clock import ManualClock
from so101_motion.common.errors import MotorSetupError
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.emulator import registers as emulated
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.setup.motor_operation import MotorOperation


class CountedWaits:
    """A lent bus, and how long its client waited in vain or on purpose [s]; fits ``BusAccess``."""

    def __init__(self, port):
        self.port, self.clock = port, ManualClock()
        self._silence, self._port = 0.0, None
        self.at_baud(1_000_000)

    @property
    def waited(self):
        return self._silence + self.clock.now()

    def call(self, job):
        return job(self._bus)

    def close(self):
        if self._port is not None:
            self._port.close()

    def at_baud(self, baud):
        self.close()
        self._port = port = open_heard(self.port, baud)
        read = port.read

        def counted(until):
            patience = max(0.0, until - time.monotonic())
            data = read(until)
            if not data:
                self._silence += patience
            return data

        port.read = counted
        self._bus = Bus(port)


@pytest.fixture
def loose():
    """Makes one servo on an adapter, talking at a rate, and its setup."""
    made = []

    def make(baud):
        emulator = Emulator(EmulatorOptions(ids={6: 1}, calibrated=False))
        memory = emulator.world.servo("6").memory
        memory.keep(emulated.BAUD, reg.BAUDS.index(baud))
        bus = CountedWaits(emulator.port)
        made.extend((emulator, bus))
        return emulator, bus, MotorOperation(lambda: nullcontext(bus))

    yield make
    for one in reversed(made):
        one.close()


def test_a_servo_at_the_likeliest_rate_is_found_at_once(loose):
    _, bus, setup = loose(1_000_000)
    setup.discover("gripper")
    assert bus.waited < 1.0


def test_a_servo_at_the_rate_that_is_looked_at_last_is_found_within_three_seconds(loose):
    _, bus, setup = loose(76_800)
    assert setup.discover("gripper")["found_baudrate"] == 76_800
    assert bus.waited < 3.0


def test_silence_is_reported_within_three_seconds(loose):
    emulator, bus, setup = loose(1_000_000)
    emulator.world.power(0.0)
    with pytest.raises(MotorSetupError, match="power supply"):
        setup.discover("gripper")
    assert bus.waited < 3.0
