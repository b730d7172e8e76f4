"""A stand-in for a port: the emulated servos answer inside the call that asks.

Nothing here waits. A reply is there at once or not at all, and a late one comes after the next
few packets have been sent. Bytes, faults and servos are the emulator's.
"""

from collections import deque

import pytest

from so101_motion.common.errors import PortUnavailable
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.emulator.bus import Bus as EmulatedBus
from so101_motion.drivers.emulator.emulator import EmulatorOptions, build_world
from so101_motion.drivers.emulator.faults import WireFaults


class WiredPort:
    """Fits ``Port``.

    Args:
        now: What time it is for the servos [s].
        late_by: How many packets are sent before a late reply arrives.

    Attributes:
        world: The servos.
        faults: What goes wrong on the wire.
        sent: Every packet.
        limits: Until when reads were willing to wait [s], each once.
        unplugged: Set it to pull the plug.
    """

    name, baud = "/dev/wired", 1_000_000

    def __init__(self, now=lambda: 0.0, late_by=3, gravity=None, **options):
        settings = {} if gravity is None else {"gravity": gravity}
        self.world = build_world(EmulatorOptions(**options), t=now(), **settings)
        self.faults = WireFaults()
        self.sent, self.limits = [], []
        self.unplugged = self.closed = False
        self.chunk = 4096
        self._bus = EmulatedBus(self.world, self.faults)
        self._now, self._late_by = now, late_by
        self._arrived = bytearray()
        self._late = deque()

    def write(self, data):
        self.check()
        self.sent.append(bytes(data))
        replies = self._bus.feed(data, self._now())
        while self._late and self._late[0][0] <= len(self.sent):
            self._arrived += self._late.popleft()[1]
        for reply in replies:
            if reply.held:
                self._late.append((len(self.sent) + self._late_by, reply.data))
            else:
                self._arrived += reply.data

    def read(self, until):
        self.check()
        if until not in self.limits:
            self.limits.append(until)
        data = bytes(self._arrived[: self.chunk])
        del self._arrived[: self.chunk]
        return data

    def discard(self):
        self.check()
        self._arrived.clear()

    def close(self):
        self.closed = True

    def memory(self, servo, row):
        """What the driver's ``row`` holds in the emulated servo."""
        data = self.world.servo(servo).memory.read(row.address, row.size)
        return row.decode(data)

    def check(self):
        if self.unplugged:
            raise PortUnavailable(self.name, "unplugged")


@pytest.fixture(scope="session")
def wired():
    """The class, for tests that make their own."""
    return WiredPort


@pytest.fixture
def port():
    """Six servos of a calibrated arm at its zero."""
    return WiredPort()


@pytest.fixture
def bus(port):
    """The driver's bus on ``port``."""
    return Bus(port, names={3: "elbow_flex"}, reply_timeout=0.0)
