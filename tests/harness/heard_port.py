"""A pseudo-terminal with emulated servos that never misses an answer, however busy the machine is.

The port is the driver's own on a real pseudo-terminal. Its client lets the servos answer on its own
thread as soon as it has written. So it waits for no other thread, only for bytes that the terminal
still holds, or that are due on an emulated wire before the client gives up. If there are none, it
reports silence at once: a silent servo costs no time, and a busy machine loses no answer.
"""

import os
import time
import weakref
from functools import partial

from so101_motion.drivers.emulator.pty_port import PtyPort
from so101_motion.drivers.port.serial_port import PortOpener, SerialPort
from so101_motion.setup import discovery

_PATIENCE = 60.0  # [s] for bytes that are on their way through the terminal


class HeardPort(SerialPort):
    """A serial port on a terminal of this process, which it serves as long as it is open."""

    def __init__(self, name, baud, *, terminal):
        self._terminal, self._taken = terminal, terminal.delivered
        self._device = terminal.device
        super().__init__(name, baud)
        terminal.leave_to_client(left=True)
        super().discard()  # what was left for others
        self._taken = terminal.delivered

    def write(self, data):
        sent = self._terminal.received + len(data)
        super().write(data)
        until = time.monotonic() + _PATIENCE
        while self._terminal.device != self._device and time.monotonic() < until:
            time.sleep(1e-5)  # unplugged, but open until the thread that looked at it runs again
            super().write(data)  # raises then
        self._terminal.serve_now()
        while self._terminal.received < sent and self._terminal.device and time.monotonic() < until:
            time.sleep(1e-5)  # the kernel hands them over in a thread of its own
            self._terminal.serve_now()

    def read(self, until):
        due = self._terminal.serve_now()
        if self._is_arriving or due <= until:
            return self._take(time.monotonic() + _PATIENCE)
        return b""

    def discard(self):
        # All is counted that is taken; what a flush dropped would be waited for.
        while self._is_arriving and self._take(time.monotonic() + _PATIENCE):
            pass

    def close(self):
        self._terminal.leave_to_client(left=False)
        super().close()

    @property
    def _is_arriving(self):
        return self._terminal.delivered > self._taken

    def _take(self, until):
        data = super().read(until)
        self._taken += len(data)
        return data


_terminals = weakref.WeakSet()
"""All terminals of this process."""


def open_heard(name, baud=1_000_000):
    """Opens a port: a terminal of this process as a ``HeardPort``, any other as it is."""
    device = os.path.realpath(name)
    for terminal in tuple(_terminals):
        if terminal.device == device:
            return HeardPort(name, baud, terminal=terminal)
    return SerialPort(name, baud)


def hear_terminals_of_this_process(patch):
    """From now on, whatever the product opens by name is opened by ``open_heard``."""
    init = PtyPort.__init__

    def noted(self, *args, **options):
        init(self, *args, **options)
        _terminals.add(self)

    patch.setattr(PtyPort, "__init__", noted)
    patch.setattr(PortOpener.__init__, "__defaults__", (1_000_000, open_heard))
    patch.setattr(discovery, "SerialPort", open_heard)


def opener_of(emulator, baud=1_000_000):
    """Opens an emulator's port as a ``HeardPort``, wherever it is plugged in."""
    return PortOpener(emulator.port, baud, partial(HeardPort, terminal=emulator._port))
