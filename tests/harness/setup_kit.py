"""Six new servos for the tests of the setup page, on a port of the tests' own process."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from so101_motion.calib.motors.setup_view import SETUP_ORDER
from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.emulator import Emulator, EmulatorOptions
from so101_motion.drivers.emulator.pty_port import Pacing
from so101_motion.drivers.emulator.world import World

PATIENCE = 0.03
"""Above what a busy machine takes to run the emulator's thread [s]."""


class FreshKit:
    """Motors that all have the id 1; none is plugged in. What a person does, a test does.

    Attributes:
        port: A link to the port.
    """

    def __init__(self, folder: Path) -> None:
        self.port = str(folder / "arm")
        new = dict.fromkeys(range(1, 7), 1)
        options = EmulatorOptions(
            link=folder / "arm",
            calibrated=False,
            ids=new,
            loose=True,
            pacing=Pacing(realtime=True),
        )
        self._emulator = Emulator(options)
        for place, joint in enumerate(SETUP_ORDER, start=1):  # no two look alike, as in a box
            shaft = self.world.servo(joint).drive.shaft
            shaft.put(round(shaft.lower + place / 7 * (shaft.upper - shaft.lower)))

    @property
    def world(self) -> World:
        """The servos."""
        return self._emulator.world

    @property
    def ids(self) -> dict[str, int]:
        """What each motor holds as its id."""
        return {joint: self.world.servo(joint).memory.raw(reg.ID) for joint in SETUP_ORDER}

    def set_id(self, joint: str, servo_id: int) -> None:
        """Let a motor have had its setup."""
        self.world.servo(joint).memory.keep(reg.ID, servo_id)

    def connect_only(self, *joints: str) -> None:
        """Have these motors on the cable, started up, and no others."""
        for joint in SETUP_ORDER:
            (self.world.connect if joint in joints else self.world.disconnect)(joint)
        for _ in range(100):
            self._emulator.advance()
            if all(self.world.servo(joint).drive.powered for joint in joints):
                return
            threading.Event().wait(0.05)
        raise AssertionError(f"{joints} did not start up")

    def close(self) -> None:
        """Unplug everything."""
        self._emulator.close()


@contextmanager
def fresh_kit(folder: Path) -> Iterator[FreshKit]:
    """A kit for the length of a block."""
    kit = FreshKit(folder)
    try:
        yield kit
    finally:
        kit.close()
