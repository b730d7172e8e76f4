"""A port without a pseudo-terminal: what is written is answered at once, and nothing waits.

``DirectPort`` is what a driver opens. An answer that does not come lets the simulated time pass for
which it was waited. Subclasses spoil or count what passes through.
"""

from so101_motion.common.errors import PortUnavailable


class DirectPort:
    """Fits ``Port``.

    Args:
        bus: What answers.
        clock: What time it is for the client, and passes while it waits; None to let none pass.
        now: What time it is for the servos; the client's time if not given.
    """

    name, baud = "/dev/direct", 1_000_000

    def __init__(self, bus, clock, now=None):
        self._bus, self._clock, self._now = bus, clock, now or clock.now
        self._arrived = b""
        self.is_gone = False

    def write(self, data):
        self._look()
        replies = self._bus.feed(data, self._now())
        self._arrived += b"".join(self.passed(data, replies))

    def passed(self, request, replies):
        """What arrives of the replies to a request."""
        return [reply.data for reply in replies]

    def read(self, until):
        self._look()
        data, self._arrived = self._arrived, b""
        if not data:
            self._clock.jump(max(until - self._clock.now(), 0.0))
        return data

    def discard(self):
        self._look()
        self._arrived = b""

    def close(self):
        self.is_gone = True

    def _look(self):
        if self.is_gone:
            raise PortUnavailable(self.name, "the port went away")


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
        self._opened = _Plugged(self._bus, self._clock, self._now)
        self._opened.on_write = lambda: self.on_write and self.on_write()
        return self._opened

    def plug(self):
        self._is_plugged = True

    def unplug(self):
        self._is_plugged = False
        self.close()

    def close(self):
        if self._opened is not None:
            self._opened.close()


class _Plugged(DirectPort):
    on_write = None

    def write(self, data):
        self.on_write()
        super().write(data)
