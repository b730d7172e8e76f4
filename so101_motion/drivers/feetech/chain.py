"""Find and set up the servos along the cable, and do so again after a loss.

``Chain`` has the connection, which may go away and come back (``connection.py``), and knows which
servos answer (``presence.py``) and what their RAM must hold. Servos that answer again after a loss
are set up anew (``servo_setup.py``), and the driver's ``on_set_up`` learns how each was found.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence

from so101_motion.common.clock import Clock
from so101_motion.common.errors import BusError, CorruptReply, NoReply, PortUnavailable, ServoFault
from so101_motion.drivers.bus.bus import Bus, Port
from so101_motion.drivers.bus.registers import Register
from so101_motion.drivers.bus.reply_counters import ReplyCounters
from so101_motion.drivers.bus.ticks import JointMap
from so101_motion.drivers.feetech.connection import Connection
from so101_motion.drivers.feetech.presence import Presence, missing_servos
from so101_motion.drivers.feetech.servo_setup import ServoCondition, prepare


class Chain:
    """The servos on one port. Only its attributes may be read from other threads.

    Args:
        open_port: Opens the serial port.
        clock: The clock of the rig.
        maps: The servo of each joint, by index.
        names: Names of the joints, by index.
        ram: What RAM registers must hold in every servo.
        on_set_up: Called with a joint and how its servo was found, after it was set up.
        reply_timeout: See ``Bus``.
        counters: See ``Bus``.

    Attributes:
        index: The joint of each servo.
        ram: What RAM registers must hold, by servo.
        presence: Which servos answer.
        connection: The port, present or not.
        is_set_up: Whether the port is open and the servos have been found.
    """

    def __init__(
        self,
        open_port: Callable[[], Port],
        clock: Clock,
        maps: Mapping[int, JointMap],
        *,
        names: Sequence[str],
        ram: Mapping[Register, int],
        on_set_up: Callable[[int, ServoCondition], None],
        reply_timeout: float,
        counters: ReplyCounters | None,
    ) -> None:
        self.index = {joint.servo_id: i for i, joint in maps.items()}
        self.ram = {servo_id: dict(ram) for servo_id in self.index}
        self.presence = Presence(tuple(self.index))
        labels = {servo_id: names[i] for servo_id, i in self.index.items()}
        self.connection = Connection(
            open_port, clock, names=labels, reply_timeout=reply_timeout, counters=counters
        )
        self.is_set_up = False
        self._maps, self._on_set_up = maps, on_set_up

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Note the loss of the port in this block; the error goes on."""
        try:
            yield
        except PortUnavailable as error:
            if self.connection.is_open:
                self.connection.lost(error)
            self.is_set_up = False
            raise

    def bus(self) -> Bus:
        """The bus, with the servos found and set up.

        Raises:
            PortUnavailable: There is no port at present; ``set_up`` tries to get it back.
        """
        if not self.is_set_up:
            reason = "not connected at present; check the USB cable and plug it in again"
            raise PortUnavailable("the arm's port", reason)
        return self.connection.bus()

    def set_up(self) -> bool:
        """Find the servos and set them up; those that are driven go on as they are.

        Returns:
            Whether all of them are driven.

        Raises:
            PortUnavailable: There is no port at present.
            NoReply: A servo that answered until now is silent, or all are.
            BusError: One cannot be set up.
        """
        bus, ids = self.connection.bus(), tuple(self.index)
        found = bus.answering(ids)
        missing = [i for i in ids if i not in found and i not in self.presence.silent]
        if missing or not found:
            raise missing_servos(bus, missing or ids, found)
        self.presence.restart(found)
        driven = [self._set_up_servo(bus, servo_id).torque for servo_id in found]
        self.is_set_up = True
        return all(driven)

    def set_up_again(self, servo_ids: Sequence[int]) -> tuple[list[int], list[ServoFault]]:
        """Set up servos that were silent and answer again.

        Returns:
            The servos that are limp, and the errors of servos that refused. One that does not
            answer after all counts as silent and is set up when it answers again.

        Raises:
            PortUnavailable: There is no port any more.
        """
        limp: list[int] = []
        refusals: list[ServoFault] = []
        for servo_id in servo_ids:
            try:
                if not self._set_up_servo(self.connection.bus(), servo_id).torque:
                    limp.append(servo_id)
            except (NoReply, CorruptReply):
                self.presence.dismiss(servo_id)
            except ServoFault as error:
                refusals.append(error)
        return limp, refusals

    def put(self, servo_id: int, register: Register, value: int) -> None:
        """Write a RAM register, and write it again after each restart of its servo.

        Raises:
            BusError: The servo did not take it.
        """
        self.ram[servo_id][register] = value
        if servo_id not in self.presence.silent:
            self.bus().write(servo_id, register, value)

    def put_all(self, register: Register, values: Mapping[int, int]) -> None:
        """Write a register of many servos; all that answer are tried before anything is raised.

        Raises:
            BusError: One did not take it.
        """
        failures: list[BusError] = []
        for servo_id in self.index.keys() - self.presence.silent:
            try:
                self.bus().write(servo_id, register, values[servo_id])
            except PortUnavailable:
                raise
            except BusError as error:
                failures.append(error)
        if failures:
            raise failures[0]

    def _set_up_servo(self, bus: Bus, servo_id: int) -> ServoCondition:
        i = self.index[servo_id]
        condition = prepare(bus, self._maps[i], self.ram[servo_id])
        self._on_set_up(i, condition)
        return condition
