"""A person at a terminal: sees what a command prints, presses keys, and holds an emulated arm."""

import contextlib
import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
PATIENT = (
    "from so101_motion.drivers.port.serial_port import SerialPort as Port; read = Port.read; "
    "Port.read = lambda port, until: read(port, until + 0.5); "
)
"""For a process that opens servos of the tests: these answer when a busy machine lets them."""
COMMAND = (sys.executable, "-c", f"{PATIENT}from so101_motion.cli import main; main()")

_ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


class Typist:
    """Runs ``so101`` on a terminal of its own, with changes to the environment."""

    def __init__(self, *arguments, **env):
        self._person, program = pty.openpty()
        fcntl.ioctl(program, termios.TIOCSWINSZ, struct.pack("HHHH", 50, 160, 0, 0))
        self.command = subprocess.Popen(
            [*COMMAND, *arguments], stdin=program, stdout=program, stderr=program, cwd=ROOT,
            env={**os.environ, "TERM": "xterm", **env},
        )  # fmt: skip
        os.close(program)
        self._seen = ""

    def sees(self, words, within=60.0):
        """Wait for words on the screen; what was there before they came is not looked at again."""
        until = time.monotonic() + within
        while words not in self._seen:
            assert time.monotonic() < until, f"no {words!r} in: {self._seen[-1500:]}"
            if not self._look(0.1) and self.command.poll() is not None:
                assert words in self._seen, f"ended without {words!r}: {self._seen[-1500:]}"
        self._seen = self._seen[self._seen.index(words) + len(words) :]

    def presses(self, keys):
        os.write(self._person, keys.encode())

    def interrupts(self):
        self.command.send_signal(signal.SIGINT)

    def code(self, within=60.0):
        """The exit code, once it has ended."""
        until = time.monotonic() + within
        while self.command.poll() is None:
            assert time.monotonic() < until, f"does not end: {self._seen[-1500:]}"
            self._look(0.05)
        return self.command.returncode

    def close(self):
        if self.command.poll() is None:
            self.command.kill()
            self.command.wait()
        os.close(self._person)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def _look(self, seconds):
        """Read on; whether there was anything."""
        with contextlib.suppress(OSError):  # the last reader has gone
            if select.select([self._person], [], [], seconds)[0]:
                data = os.read(self._person, 65536).decode(errors="replace")
                self._seen += _ESCAPES.sub("", data)
                return bool(data)
        return False
