"""A port without waiting: the emulated servos answer inside the call that asks.

A late reply comes after the next few packets have been sent.
"""

from collections import deque

import pytest
from harness.direct_port import DirectPort

from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.emulator.bus import Bus as EmulatedBus
from so101_motion.drivers.emulator.emulator import EmulatorOptions, build_world
from so101_motion.drivers.emulator.faults import WireFaults


class WiredPort(DirectPort):
    """A port that keeps what passes.

    Args:
        now: What time it is for the servos [s].
        late_by: How many packets are sent before a late reply arrives.

    Attributes:
        world: The servos.
        faults: What goes wrong on the wire.
        sent: Every packet.
        limits: Until when reads were willing to wait [s], each once.
        chunk: How much a read gives at most [byte].
    """

    name = "/dev/wired"

    def __init__(self, now=lambda: 0.0, late_by=3, gravity=None, **options):
        settings = {} if gravity is None else {"gravity": gravity}
        self.world = build_world(EmulatorOptions(**options), t=now(), **settings)
        self.faults = WireFaults()
        super().__init__(EmulatedBus(self.world, self.faults), now)
        self.sent, self.limits, self.chunk, self.closed = [], [], 4096, False
        self._late_by, self._late = late_by, deque()

    def passed(self, request, replies):
        self.sent.append(bytes(request))
        arrived = []
        while self._late and self._late[0][0] <= len(self.sent):
            arrived.append(self._late.popleft()[1])
        for reply in replies:
            if reply.held:
                self._late.append((len(self.sent) + self._late_by, reply.data))
            else:
                arrived.append(reply.data)
        return arrived

    def read(self, until):
        self.check()
        if until not in self.limits:
            self.limits.append(until)
        data, self._arrived = self._arrived[: self.chunk], self._arrived[self.chunk :]
        return data

    def close(self):
        self.closed = True

    def memory(self, servo, row):
        """What the driver's ``row`` holds in the emulated servo."""
        data = self.world.servo(servo).memory.read(row.address, row.size)
        return row.decode(data)


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
