"""Run the emulator as a program that takes faults from the terminal."""

from __future__ import annotations

import os
import select
import threading
import time
from collections.abc import Callable
from typing import TextIO

from so101_motion.common.errors import ConfigError
from so101_motion.common.realtime import use_realtime_priority
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.faults import FaultEvent, parse_fault
from so101_motion.drivers.emulator.world import Gravity, no_gravity
from so101_motion.drivers.things import Things

_LOOK_EVERY = 0.05  # [s], how often it looks whether it should stop, and lets physics catch up


TYPED = """\
faults:
  dead:elbow_flex   its cable is pulled
  reboot:gripper    this servo starts anew
  hot:gripper=68    degrees Celsius
  brownout=5        volts of the supply
  unplug+3          the USB cable, for 3 s
  twin:2=3          this servo takes the id of servo 3
  loss=0.1          share of replies lost; likewise request_loss,
                    corrupt, duplicate, late
what a person does:
  only:gripper      plugs in this servo alone
  chain             plugs in all servos
  pose              holds the arm up
  sweep             moves each joint to its stops
  object=0.02       puts this much between the jaws [m]
  take:cube         takes a thing of --scene away
when:
  unplug@5+3        in 5 s, for 3 s
  end hot:gripper   ends one
Ctrl-C ends the emulator"""


class _Timetable:
    """Begins and ends faults at their times."""

    def __init__(self, emulator: Emulator) -> None:
        self._emulator = emulator
        self._entries: list[tuple[float, Callable[[FaultEvent], None], FaultEvent]] = []

    def add(self, fault: FaultEvent) -> None:
        world, name = self._emulator.world, fault.servo
        if fault.kind == "take" and name is not None:
            if world.things is None:
                raise ConfigError("fault", name, "cannot be taken: there is no scene")
            world.things.where(name)  # raises at once if there is no such thing
        elif name is not None:
            world.servo(name)  # likewise
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
        if not self._entries:
            return _LOOK_EVERY
        return min(max(self._entries[0][0] - time.monotonic(), 0.0), _LOOK_EVERY)


class _Typing:
    """Reads typed lines without buffering, so that the second of two lines is not held back."""

    def __init__(self, source: TextIO | None) -> None:
        self._source = source
        self._rest = b""

    def wait(self, seconds: float, stop: threading.Event) -> list[str]:
        if self._source is None or not _is_typed_to_us(self._source):
            stop.wait(seconds)
            return []
        if not select.select([self._source], [], [], seconds)[0]:
            return []
        data = os.read(self._source.fileno(), 4096)
        if not data:
            self._source = None
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [line.decode(errors="replace").strip() for line in lines]


def _is_typed_to_us(source: TextIO) -> bool:
    """Whether we may read it: not a terminal whose shell runs us in the background.

    Lines typed there are for the shell, and the system stops a background process that reads them.
    """
    try:
        return os.tcgetpgrp(source.fileno()) == os.getpgrp()
    except OSError:  # a pipe, a file, somebody else's terminal
        return True


def run_emulator(
    options: EmulatorOptions,
    *,
    announce: Callable[[str], None],
    stop: threading.Event,
    commands: TextIO | None = None,
    gravity: Gravity = no_gravity,
    things: Things | None = None,
) -> None:
    """Emulate an arm until ``stop`` is set, by a signal handler or another thread, or Ctrl-C.

    ``announce`` is called with the port first, then with each message for the user. ``commands`` is
    a file with one fault a line as it is typed, e.g. standard input; ``end`` before a fault ends it
    (see ``parse_fault``). ``gravity`` and ``things`` are as in ``World``; what happens to the
    things is announced, too.
    """
    with Emulator(options, gravity=gravity, things=things) as emulator:
        try:
            announce(emulator.port)
            if options.pacing.realtime:
                use_realtime_priority()  # like the port's thread, which must not wait for this one
            timetable, typing = _Timetable(emulator), _Typing(commands)
            for fault in options.faults:
                timetable.add(fault)
            while not stop.is_set():
                for line in typing.wait(timetable.wait(), stop):
                    _obey(line, emulator, timetable, announce)
                timetable.run_due()
                while things is not None and things.told:
                    announce(things.told.popleft())
                if emulator.now() - emulator.world.t > _LOOK_EVERY / 2.0:
                    emulator.advance()  # the request after a pause must not wait for the physics
        except KeyboardInterrupt:
            return


def _obey(
    line: str, emulator: Emulator, timetable: _Timetable, announce: Callable[[str], None]
) -> None:
    if not line:
        return
    if line in ("help", "?"):
        announce(TYPED)
        return
    try:
        if line.startswith("end "):
            emulator.end(parse_fault(line.removeprefix("end "), ends=True))
        else:
            timetable.add(parse_fault(line))
    except ConfigError as error:
        announce(f"{error}; help lists what can be typed")
