"""A port without a pseudo-terminal: what is written is answered at once, and nothing waits.

Bytes and servos are the emulator's. Subclasses spoil or count what passes through.
"""

from so101_motion.common.errors import PortUnavailable


class DirectPort:
    """Fits ``Port``.

    Args:
        bus: What answers.
        now: What time it is for the servos [s].
        wait: Called with the time until which an answer was waited for that did not come.

    Attributes:
        unplugged: Set it to pull the plug.
    """

    name, baud = "/dev/direct", 1_000_000

    def __init__(self, bus, now, wait=lambda until: None):
        self._bus, self._now, self._wait = bus, now, wait
        self._arrived = b""
        self.unplugged = False

    def write(self, data):
        self.check()
        replies = self._bus.feed(data, self._now(), baud=self.baud)
        self._arrived += b"".join(self.passed(data, replies))

    def passed(self, request, replies):
        """What arrives of the replies to a request."""
        return [reply.data for reply in replies]

    def read(self, until):
        self.check()
        data, self._arrived = self._arrived, b""
        if not data:
            self._wait(until)
        return data

    def discard(self):
        self.check()
        self._arrived = b""

    def close(self):
        pass

    def check(self):
        if self.unplugged:
            raise PortUnavailable(self.name, "the port went away; check the USB cable")


def waiting(clock):
    """Lets time pass that is waited for an answer in vain."""
    return lambda until: clock.jump(max(until - clock.now(), 0.0))


class Socket:
    """Where an emulator's port can be plugged in and out; opens ``DirectPort``."""

    port = DirectPort.name

    def __init__(self, bus, clock, now):
        self._bus, self._clock, self._now = bus, clock, now
        self._is_plugged, self._opened = True, None
        self.on_write = None  # called before each request

    def open(self, baud=None):
        if not self._is_plugged:
            raise PortUnavailable(self.port, "it is not there")
        self._opened = _Plugged(self._bus, self._now, waiting(self._clock))
        self._opened.on_write = lambda: self.on_write and self.on_write()
        return self._opened

    def plug(self):
        self._is_plugged = True

    def unplug(self):
        self._is_plugged = False
        self.close()

    def close(self):
        if self._opened is not None:
            self._opened.unplugged = True


class _Plugged(DirectPort):
    on_write = None

    def write(self, data):
        self.on_write()
        super().write(data)

    def close(self):
        self.unplugged = True
