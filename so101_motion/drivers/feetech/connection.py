"""Reopen the bus after its port went away.

``Connection`` opens the port when it is asked for the bus and has none, but not more often than a
back-off allows: 0.25 s after the first failure, twice as long after each further one, 5 s at most.
In between it raises the last failure at once. The servos' counters are kept throughout.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

from so101_motion.common.clock import Clock
from so101_motion.common.errors import PortUnavailable
from so101_motion.drivers.bus.bus import REPLY_TIMEOUT, Bus, Port
from so101_motion.drivers.bus.reply_counters import ReplyCounters

_log = logging.getLogger(__name__)

FIRST_WAIT = 0.25
"""How long after a failure the port is tried again [s]; as in the published module."""

LONGEST_WAIT = 5.0
"""The longest wait between two tries [s]."""


class Connection:
    """Opens, keeps and reopens a bus. Used by one thread at a time.

    The arguments are those of ``Bus``; ``open_port`` opens its port or raises ``PortUnavailable``.
    ``losses`` says how often the port went away; ``open_bus`` is None while there is no port.
    """

    def __init__(
        self,
        open_port: Callable[[], Port],
        clock: Clock,
        *,
        names: Mapping[int, str],
        reply_timeout: float = REPLY_TIMEOUT,
        counters: ReplyCounters | None = None,
    ) -> None:
        self.counters = ReplyCounters() if counters is None else counters
        self.losses = 0
        self._open_port, self._clock = open_port, clock
        self._names, self._reply_timeout = names, reply_timeout
        self.open_bus: Bus | None = None
        self._wait, self._next_try = FIRST_WAIT, clock.now()
        self._why: PortUnavailable | None = None

    @property
    def is_open(self) -> bool:
        return self.open_bus is not None

    def bus(self) -> Bus:
        """The bus; opened now if a retry is due. Raises ``PortUnavailable`` if there is none."""
        if self.open_bus is None:
            now = self._clock.now()
            if self._why is not None and now < self._next_try:
                raise PortUnavailable(self._why.port, self._why.reason)
            try:
                port = self._open_port()
            except PortUnavailable as error:
                self._postpone(error)
                raise
            if self._why is not None:
                _log.warning("%s is back", port.name)
            self.open_bus = Bus(
                port, names=self._names, counters=self.counters, reply_timeout=self._reply_timeout
            )
            self._why = None
        return self.open_bus

    def lost(self, error: PortUnavailable) -> None:
        _log.warning("%s", error)
        self.losses += 1
        self._wait = FIRST_WAIT
        self._postpone(error)
        self.close()

    def close(self) -> None:
        bus, self.open_bus = self.open_bus, None
        if bus is not None:
            bus.close()

    def _postpone(self, error: PortUnavailable) -> None:
        self._why = error
        self._next_try = self._clock.now() + self._wait
        self._wait = min(2.0 * self._wait, LONGEST_WAIT)
