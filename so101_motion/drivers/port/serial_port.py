"""Open a serial port exclusively and read it without spinning; only this file imports pyserial.

``flock`` refuses other programs that lock (pyserial can), ``TIOCEXCL`` those that just open.
Reading sleeps until bytes arrive or the timeout ends (``serial_read.c``). A port that goes away
(USB unplugged) shows as a hang-up, an I/O error or an end of file; all become ``PortUnavailable``.

Writing and discarding never wait (the port is non-blocking) and keep Python's interpreter lock: a
thread that releases it waits half a millisecond for each busy thread to get it back, and a control
cycle makes six such calls. Only reading releases it. On Windows, pyserial does all this.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import select
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import serial
from serial.tools import list_ports

from so101_motion.common.errors import PortUnavailable
from so101_motion.drivers.port.port_list import open_error_text
from so101_motion.native.library import native

if sys.platform != "win32":
    import fcntl
    import termios

    _libc = ctypes.PyDLL(None, use_errno=True)  # PyDLL keeps the interpreter lock
    _libc.write.restype = ctypes.c_ssize_t
    _libc.write.argtypes = (ctypes.c_int, ctypes.c_char_p, ctypes.c_size_t)
    _libc.tcflush.argtypes = (ctypes.c_int, ctypes.c_int)

_log = logging.getLogger(__name__)

_CHUNK = 4096
_LOOK = 0.0005  # [s] between two looks for received bytes on Windows; chosen: a reply takes as long


class UsbIdentity(NamedTuple):
    """Identifies an adapter, whatever its port is called; cheap CH340 ones have no number."""

    vendor: int
    product: int
    serial_number: str


class SerialPort:
    """A serial port that is open exclusively.

    ``name`` is the device to open, or a link to one, ``baud`` in bits per second. Raises
    ``PortUnavailable``: it is not there, not allowed, or in use, and by whom.
    """

    def __init__(self, name: str, baud: int = 1_000_000) -> None:
        self.name, self.baud = name, baud
        try:
            self._serial = serial.Serial(name, baud, timeout=0, exclusive=True)
        except (OSError, ValueError) as error:
            raise PortUnavailable(name, open_error_text(name, error)) from None
        if sys.platform == "win32":  # nobody else can open it now
            self.discard()
            return
        self._fd = int(self._serial.fileno())
        try:
            fcntl.ioctl(self._fd, termios.TIOCEXCL)
        except OSError as error:
            self._serial.close()
            raise PortUnavailable(name, open_error_text(name, error)) from error
        # FTDI adapters hold bytes back for 16 ms unless told not to; others do not know the call.
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            self._serial.set_low_latency_mode(True)
        self._read = native().library.so101_serial_read
        self._received: Any = ctypes.create_string_buffer(_CHUNK)
        self.discard()

    def write(self, data: bytes) -> None:
        try:
            if sys.platform == "win32":
                self._serial.write(data)
                return
            sent = _checked(_libc.write(self._fd, data, len(data)))
            while sent < len(data):  # a full output buffer: rare, the driver sends 60 bytes
                select.select([], [self._fd], [], 1.0)
                sent += os.write(self._fd, data[sent:])
        except OSError as error:
            raise self._gone(error) from error

    def read(self, until: float) -> bytes:
        """Read received bytes; waits for at least one until ``until`` (``time.monotonic``, [s])."""
        # poll counts whole milliseconds; rounded up it never returns early to be asked again.
        wait_ms = max(0.0, (until - time.monotonic()) * 1000.0)
        try:
            if sys.platform == "win32":
                while not (size := self._serial.in_waiting) and time.monotonic() < until:
                    time.sleep(_LOOK)
                return bytes(self._serial.read(size))
            wait = int(wait_ms) + 1 if wait_ms else 0
            size = self._read(self._fd, self._received, _CHUNK, wait)
            if size < 0:
                raise OSError(-size, os.strerror(-size))
        except OSError as error:
            raise self._gone(error) from error
        return self._received[:size] if size else b""

    def discard(self) -> None:
        try:
            if sys.platform == "win32":
                self._serial.reset_input_buffer()
                return
            _checked(_libc.tcflush(self._fd, termios.TCIFLUSH))
        except OSError as error:
            raise self._gone(error) from error

    def close(self) -> None:
        """Close the port. May be called twice."""
        if self._serial.is_open:
            if sys.platform != "win32":
                with contextlib.suppress(OSError):
                    fcntl.ioctl(self._fd, termios.TIOCNXCL)
            with contextlib.suppress(OSError):
                self._serial.close()

    def _gone(self, error: Exception) -> PortUnavailable:
        _log.debug("%s failed: %s", self.name, error)
        return PortUnavailable(self.name, _UNPLUGGED)


def _checked(result: int) -> int:
    if result < 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    return result


_UNPLUGGED = "the port went away; check the USB cable and plug it in again"


class PortOpener:
    """Opens the same adapter each time, even if it was plugged into another socket.

    ``make`` opens a port by its name and rate; ``baud`` may be set.
    """

    def __init__(
        self,
        name: str,
        baud: int = 1_000_000,
        make: Callable[[str, int], SerialPort] = SerialPort,
    ) -> None:
        self.baud = baud
        self._name, self._make = name, make
        self._usb: UsbIdentity | None = None

    def __call__(self, baud: int | None = None) -> SerialPort:
        """Open the port, this once at another ``baud`` if it is given."""
        name = find_again(self._name, self._usb)
        if name is None:
            raise PortUnavailable(self._name, "its adapter is not plugged in; plug it in again")
        port = self._make(name, self.baud if baud is None else baud)
        self._usb = self._usb or identity(name)
        return port


def identity(name: str) -> UsbIdentity | None:
    """The USB adapter behind a port, if it can be identified."""
    device = os.path.realpath(name)
    for port in list_ports.comports():
        if os.path.realpath(port.device) == device and port.serial_number and port.vid is not None:
            return UsbIdentity(port.vid, port.pid, port.serial_number)
    return None


def find_again(name: str, usb: UsbIdentity | None) -> str | None:
    """Find the present name of a port that was known as ``name``; None if it is not plugged in.

    If its adapter ``usb`` is known, only that will do, because after a replug another one may have
    got the name.
    """
    if usb is None or identity(name) == usb:
        return name
    for port in list_ports.comports():
        if (port.vid, port.pid, port.serial_number) == usb:
            return str(port.device)
    return None
