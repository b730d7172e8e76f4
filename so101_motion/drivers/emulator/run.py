"""The emulator as a program: a port until somebody stops it, with faults on demand."""

from __future__ import annotations

import select
import threading
import time
from collections.abc import Callable
from typing import TextIO

from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.faults import FaultEvent, parse_fault
from so101_motion.drivers.emulator.world import Gravity, no_gravity
from so101_motion.errors import ConfigError

_LOOK_EVERY = 0.05  # [s], how often it looks whether it should stop, and lets physics catch up


class _Timetable:
    """Which fault begins or ends next."""

    def __init__(self, emulator: Emulator) -> None:
        self._emulator = emulator
        self._entries: list[tuple[float, Callable[[FaultEvent], None], FaultEvent]] = []

    def add(self, fault: FaultEvent) -> None:
        start = time.monotonic() + fault.at
        self._entries.append((start, self._emulator.begin, fault))
        if fault.duration is not None:
            self._entries.append((start + fault.duration, self._emulator.end, fault))
        self._entries.sort(key=lambda entry: entry[0])

    def run_due(self) -> None:
        while self._entries and self._entries[0][0] <= time.monotonic():
            _, happen, fault = self._entries.pop(0)
            happen(fault)

    def wait(self) -> float:
        """Seconds until the next entry, at most until the next look around."""
        if not self._entries:
            return _LOOK_EVERY
        return min(max(self._entries[0][0] - time.monotonic(), 0.0), _LOOK_EVERY)


def run_emulator(
    options: EmulatorOptions,
    *,
    announce: Callable[[str], None],
    stop: threading.Event,
    commands: TextIO | None = None,
    gravity: Gravity = no_gravity,
) -> None:
    """Emulate an arm until ``stop`` is set or Ctrl-C.

    Args:
        options: What to emulate.
        announce: Told the port first, then what a person should read.
        stop: Set it from a signal handler or another thread to end.
        commands: A file with one fault a line as it is typed, e.g. standard input; ``end`` before
            a fault ends it. See ``parse_fault``.
        gravity: Holding torque [N m] as a function of the six joint angles [rad].

    Raises:
        ConfigError: The options name something that does not exist.
    """
    with Emulator(options, gravity=gravity) as emulator:
        announce(emulator.port)
        timetable = _Timetable(emulator)
        for fault in options.faults:
            timetable.add(fault)
        try:
            while not stop.is_set():
                if commands is None:
                    stop.wait(timetable.wait())
                elif select.select([commands], [], [], timetable.wait())[0]:
                    line = commands.readline()
                    if line:
                        _obey(line.strip(), emulator, timetable, announce)
                    else:
                        commands = None
                timetable.run_due()
                emulator.advance()  # the first request after a pause must not wait for the physics
        except KeyboardInterrupt:
            return


def _obey(
    line: str, emulator: Emulator, timetable: _Timetable, announce: Callable[[str], None]
) -> None:
    if not line:
        return
    try:
        if line.startswith("end "):
            emulator.end(parse_fault(line.removeprefix("end ")))
        else:
            timetable.add(parse_fault(line))
    except ConfigError as error:
        announce(str(error))
