"""Read single keys from this program's terminal, on Windows too."""

from __future__ import annotations

import os
import select
import sys
import time
from typing import Any

if sys.platform == "win32":
    import msvcrt
else:
    import termios
    import tty

_LOOK = 0.01  # [s] between two looks for a key on Windows, which cannot wait for one; chosen


class Keys:
    """The keys of standard input, which must be a terminal. They are not shown.

    Ctrl-C still interrupts the program.
    """

    def __init__(self) -> None:
        self._before: list[Any] = []
        if sys.platform != "win32":
            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)

    def read(self, seconds: float) -> str:
        """Return what was typed, as soon as there is something; empty after ``seconds``."""
        if sys.platform == "win32":
            until = time.monotonic() + seconds
            while not msvcrt.kbhit() and time.monotonic() < until:
                time.sleep(_LOOK)
            return msvcrt.getwch() if msvcrt.kbhit() else ""
        if not select.select([sys.stdin], [], [], seconds)[0]:
            return ""
        return os.read(sys.stdin.fileno(), 256).decode(errors="replace")

    def close(self) -> None:
        """Leave the terminal as it was."""
        if sys.platform != "win32":
            termios.tcsetattr(sys.stdin, termios.TCSAFLUSH, self._before)
