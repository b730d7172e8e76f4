"""Read servo positions and run jobs on the bus, without driving the servos.

A ``BusMonitor`` has the port while the bus is lent to a calibration or a motor setup, and when no
component asks for a servo. It sets nothing up, and servos may be missing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial

from so101_motion.common.clock import Clock
from so101_motion.common.errors import PortUnavailable
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.protocol import Answer
from so101_motion.drivers.bus.ticks import Ticks
from so101_motion.drivers.feetech.connection import Connection
from so101_motion.drivers.feetech.health import (
    VITALS_COUNT,
    VITALS_START,
    HealthReadings,
    JointHealth,
)
from so101_motion.drivers.feetech.presence import Presence
from so101_motion.drivers.port.serial_port import PortOpener

_PERIOD = 0.05  # [s] between two looks; fresh enough for a picture, near no load on the wire

_START = reg.TORQUE_ENABLE.address
_END = VITALS_START + VITALS_COUNT


class BusMonitor:
    """Reads the servos of a port without driving them. Other threads may read its attributes.

    ``ids`` has the servo of each joint that may be there. ``positions`` are those of servos that
    answered last [tick], by joint, replaced whole; ``driven`` the joints whose torque was on then,
    or when they answered last before.
    """

    def __init__(
        self, opener: PortOpener, clock: Clock, *, ids: Mapping[str, int], reply_timeout: float
    ) -> None:
        self.positions: Mapping[str, Ticks] = {}
        self.driven: frozenset[str] = frozenset()
        self._opener, self._clock, self._reply_timeout = opener, clock, reply_timeout
        self._joints = {servo_id: joint for joint, servo_id in ids.items()}
        self._due = clock.now()
        self._readings = HealthReadings(clock.now())
        self._presence = Presence(tuple(self._joints))
        self._baud = opener.baud
        self._connection = self._connect()

    @property
    def is_connected(self) -> bool:
        return self._connection.is_open

    @property
    def port_losses(self) -> int:
        return self._connection.losses

    @property
    def silent(self) -> frozenset[str]:
        """The joints whose servos have not answered for a while."""
        return frozenset(self._joints[i] for i in self._presence.silent)

    @property
    def health(self) -> tuple[JointHealth, ...]:
        """The health of each servo that has answered, base to jaw."""
        counters = self._connection.counters
        return self._readings.health(self._joints, counters, self._presence.silent)

    @contextmanager
    def bus(self) -> Iterator[Bus]:
        """The bus; a port that goes away in this block is opened again for the next one."""
        bus = self._connection.bus()
        try:
            yield bus
        except PortUnavailable as error:
            self._connection.lost(error)
            raise

    def at_baud(self, baud: int) -> None:
        """Let the port talk at another baud rate; the servos are not looked at meanwhile."""
        if baud != self._baud:
            self._connection.close()
            self._baud = baud
            self._connection = self._connect()

    def look(self) -> None:
        """Update ``positions`` if a reading is due and the port is open."""
        now = self._clock.now()
        if now < self._due or self._baud != self._opener.baud:
            return
        self._due = now + _PERIOD
        try:
            with self.bus() as bus:
                self.positions = self._positions(bus)
        except PortUnavailable:
            self.positions, self.driven = {}, frozenset()

    def let_go(self) -> None:
        """Switch off the torque of all servos that answer; all are tried before ``BusError``."""
        with self.bus() as bus:
            bus.write_each(reg.TORQUE_ENABLE, dict.fromkeys(bus.answering(self._joints), 0))

    def close(self) -> None:
        self._connection.close()

    def _connect(self) -> Connection:
        return Connection(
            partial(self._opener, self._baud),
            self._clock,
            names=self._joints,
            reply_timeout=self._reply_timeout,
        )

    def _positions(self, bus: Bus) -> dict[str, Ticks]:
        silent = [i for i, joint in self._joints.items() if joint not in self.positions]
        found = bus.sync_read(tuple(self._joints), _START, _END - _START, given_up=silent)
        at = VITALS_START - _START
        vitals = {i: Answer(each.data[at:], each.faults) for i, each in found.items()}
        now = self._clock.now()
        self._readings.take(now, vitals)
        self._presence.judge(found, now)
        blocks = {self._joints[i]: answer.data for i, answer in found.items()}
        driven = {j for j, data in blocks.items() if reg.TORQUE_ENABLE.cut(data, _START)}
        missed = self.driven - blocks.keys() - self.silent
        self.driven = missed | driven
        where = reg.PRESENT_POSITION
        return {joint: Ticks(where.cut(data, _START)) for joint, data in blocks.items()}
