"""The interface through which calibration and motor setup use a lent bus.

The thread that owns the port runs their jobs. The lender keeps everything else from moving
meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

from so101_motion.common.clock import Clock
from so101_motion.drivers.bus.bus import Bus

T = TypeVar("T")


class BusAccess(Protocol):
    """A lent bus; any thread may use it."""

    @property
    def port(self) -> str:
        """The serial port's name."""

    @property
    def clock(self) -> Clock:
        """The clock of the control loop."""

    def call(self, job: Callable[[Bus], T]) -> T:
        """Run ``job`` on the port's thread; returns what it returns, raises what it raises."""

    def watch(self, job: Callable[[Bus], None] | None) -> None:
        """Run ``job`` on the port's thread at every tick, 100 times a second; None ends it.

        A job that raises is not called again; the next ``call`` raises what it raised. While there
        is no port (``PortUnavailable``) it waits, and goes on when the port is back.
        """

    def at_baud(self, baud: int) -> None:
        """Let the port talk at another rate from now on."""
