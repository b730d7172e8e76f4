"""Emulated ports that answer at once, for benchmarks in pretended time.

The bytes are those of a pseudo-terminal, and so is what the servos do; but no other thread has to
get the processor before an answer comes. That takes a fifth of the processor time, and a machine
where others compute gives the same figures.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

from benchmarks import _common
from so101_motion.common import clock
from so101_motion.drivers.emulator.bus import Bus
from so101_motion.drivers.emulator.emulator import Emulator
from so101_motion.drivers.port import serial_port

_direct: Any = _common.from_tests("harness.direct_port")


class _StillClock:
    """Time stands still while a port is waited for."""

    def now(self) -> float:
        """Always 0 [s]."""
        return 0.0

    def jump(self, _dt: float) -> None:
        """Let no time pass."""


class _Served:
    """An emulator's port; fits ``ServedPort``."""

    def __init__(self, bus: Bus, now: Any, port: str) -> None:
        self.port, self._bus, self._now = port, bus, now

    def open(self) -> Any:
        """A new port without waiting."""
        return _direct.DirectPort(self._bus, _StillClock(), self._now)

    def plug(self) -> None:
        """It is always there."""

    def unplug(self) -> None:
        """It is always there."""

    def close(self) -> None:
        """Nothing is left of it."""


@contextmanager
def direct_ports() -> Iterator[None]:
    """Give the emulated arms that are opened in here such ports."""
    served: dict[str, _Served] = {}
    real = serial_port.SerialPort

    def serve(emulator: Any, bus: Bus) -> _Served:
        link = str(emulator._options.link)
        served[link] = _Served(bus, emulator.now, link)
        return served[link]

    def opened(name: str, baud: int = 1_000_000) -> Any:
        return served[name].open() if name in served else real(name, baud)

    with (
        mock.patch.object(Emulator, "_on_terminal", serve),
        mock.patch.object(serial_port, "SerialPort", opened),
        mock.patch.object(clock, "_PATIENCE", 3600.0),  # a machine may pause a benchmark
    ):
        yield
