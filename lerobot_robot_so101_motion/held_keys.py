"""Read the keys of this terminal or the sticks of a gamepad that a person holds.

A reading has seven numbers from -1 to 1: the tool along X, Y and Z, its turns about X, Y and Z, and
the jaw, where 1 opens it. A terminal never reports a release, so a key counts as held for ``HELD``
after each report. A gamepad moves the arm only while a shoulder button is held. Source: Linux
kernel, Documentation/input/joydev/joystick-api.rst.
"""

from __future__ import annotations

import os
import struct
import sys
from pathlib import Path

import numpy as np

from so101_motion.common.geometry import Array
from so101_motion.common.keys import Keys

AXES = 7

HELD = 0.12
"""How long a key counts as held after its last report [s]; chosen: terminals repeat keys every 0.03
to 0.05 s, and a loop at 15 Hz reads them every 0.07 s."""

KEYS = tuple(zip("sdfjklh", "waruioy", strict=True))  # for minus and plus of each, as on the page

HELP = (
    "Hold a key: w/s forward and back, a/d left and right, r/f up and down, j/u, k/i, l/o turn,"
    " y/h open and close the jaw. Ctrl-C ends it."
)

_EVENT = struct.Struct("=IhBB")  # time [ms], value, kind, number
_BUTTON, _AXIS, _INITIAL = 1, 2, 0x80
_SHOULDERS = (4, 5)
_FULL = 32767.0
_STILL = 0.15  # of a stick's travel


class TerminalKeys:
    """The keys of this program's terminal; ``ConnectionError`` if standard input is none.

    Ctrl-C still ends the program.
    """

    def __init__(self) -> None:
        if not sys.stdin.isatty():
            raise ConnectionError(
                "there is no keyboard, because standard input is not a terminal. Start the command"
                " in one, or give a gamepad: --teleop.device=/dev/input/js0"
            )
        self._keys = Keys()
        self._last: dict[str, float] = {}

    def read(self, now: float) -> Array:
        """The seven numbers at ``now`` [s], shape (``AXES``,), -1 to 1."""
        while typed := self._keys.read(0.0):
            self._last |= dict.fromkeys(typed.lower(), now)
        held = {key for key, then in self._last.items() if now - then < HELD}
        return np.array([float(more in held) - float(less in held) for less, more in KEYS])

    def close(self) -> None:
        self._keys.close()


class Gamepad:
    """The sticks of a gamepad: the left one along X and Y, the right one up and round Z.

    The cross turns about Y, the triggers open and close the jaw. ``ConnectionError`` if the device,
    such as ``/dev/input/js0``, cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        if sys.platform == "win32":
            raise ConnectionError(
                f"no gamepad at {path}: they are read on Linux only; use the keyboard"
            )
        try:
            self._fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise ConnectionError(f"no gamepad at {path}: {error.strerror}; plug it in") from error
        self._path = path
        self._axes = {2: -1.0, 5: -1.0}  # the triggers' rest
        self._pressed: set[int] = set()
        self._left = b""

    def read(self, now: float) -> Array:
        """The seven numbers, -1 to 1; ``ConnectionError`` if it was unplugged."""
        try:
            while found := _read(self._fd, 512 * _EVENT.size):
                self._take(found)
        except OSError as error:
            raise ConnectionError(
                f"the gamepad at {self._path} went away; plug it in again, then restart"
            ) from error
        held = np.zeros(AXES)
        if self._pressed.intersection(_SHOULDERS):
            at = [self._axes.get(i, 0.0) for i in range(8)]
            jaw = 0.5 * (at[5] - at[2])
            held[:] = (-at[1], -at[0], -at[4], 0.0, -at[7], -at[3], jaw)
        return np.where(np.abs(held) < _STILL, 0.0, np.clip(held, -1.0, 1.0))

    def close(self) -> None:
        os.close(self._fd)

    def _take(self, found: bytes) -> None:
        data = self._left + found
        whole = len(data) - len(data) % _EVENT.size
        self._left = data[whole:]
        for _, value, kind, number in _EVENT.iter_unpack(data[:whole]):
            if kind & ~_INITIAL == _AXIS:
                self._axes[number] = value / _FULL
            elif kind & ~_INITIAL == _BUTTON:
                (self._pressed.add if value else self._pressed.discard)(number)


Held = TerminalKeys | Gamepad


def open_held(device: str) -> Held:
    """Open ``keyboard`` or the gamepad at a path; ``ConnectionError`` if that cannot be opened."""
    return TerminalKeys() if device == "keyboard" else Gamepad(Path(device))


def _read(fd: int, most: int) -> bytes:
    try:
        return os.read(fd, most)
    except BlockingIOError:
        return b""
