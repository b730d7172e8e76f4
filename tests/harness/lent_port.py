"""A lent bus on a real port, for tests that measure real time."""

from so101_motion.common.clock import MonotonicClock
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.port.serial_port import SerialPort

PATIENCE = 0.03
"""Above what a busy machine takes to run the emulator's thread [s]."""


class PortAccess:
    """Fits ``BusAccess``."""

    def __init__(self, port, baud=1_000_000):
        self.port, self.clock = port, MonotonicClock()
        self._bus = Bus(SerialPort(port, baud), reply_timeout=PATIENCE)

    def call(self, job):
        return job(self._bus)

    def watch(self, job):
        raise NotImplementedError

    def at_baud(self, baud):
        self._bus.close()
        self._bus = Bus(SerialPort(self.port, baud), reply_timeout=PATIENCE)

    def close(self):
        self._bus.close()
