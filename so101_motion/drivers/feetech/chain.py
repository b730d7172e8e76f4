"""The servos along the cable: find them, set them up, switch their torque, send their goals.

The connection may go away and come back (``connection.py``). Servos that answer again after a loss
are set up anew (``servo_setup.py``). No other file sends goals while the arm is in use: those of a
motion or of a resting arm, in one packet; those of an arm that a hand leads, each with the share of
drive that its servo may use; and the first goal of a servo, written and read back before torque
comes on.

A joint is switched on only at a position that two readings agree on. A joint outside its limits,
where no goal can keep it, is left as it is (``out_of_range.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

from so101_motion.common.clock import Clock
from so101_motion.common.errors import CorruptReply, NoReply, PortUnavailable, ServoFault
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus, Port
from so101_motion.drivers.bus.registers import Register
from so101_motion.drivers.bus.reply_counters import ReplyCounters
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.command_record import CommandListener, SentCommand
from so101_motion.drivers.feetech.connection import Connection
from so101_motion.drivers.feetech.goal_compensation import LIMP, GoalCompensation
from so101_motion.drivers.feetech.joint_estimate import JointEstimate
from so101_motion.drivers.feetech.out_of_range import OutOfRangeJoints
from so101_motion.drivers.feetech.presence import (
    Presence,
    missing_servos,
    unconfirmed_position,
)
from so101_motion.drivers.feetech.servo_setup import ServoCondition, engage, prepare

_FRESH = 0.1
"""Oldest position at which a joint is held [s]. Chosen: two reads of a resting arm."""


class Chain:
    """The servos on one port, for the I/O thread. Other threads may read its attributes.

    ``maps`` has the servo of each joint, by index, ``ram`` what RAM registers must hold in every
    servo; ``reply_timeout`` and ``counters`` as in ``Bus``. ``compensation`` computes the goals,
    and its ``held`` remembers those that were sent.

    Attributes:
        index: The joint of each servo.
        ram: What RAM registers must hold, by servo.
        is_set_up: Whether the port is open and the servos have been found.
        on_command: Called with every command as it is sent; None for nobody.
        t_sent: When goals were sent last [s].
    """

    def __init__(
        self,
        open_port: Callable[[], Port],
        clock: Clock,
        maps: Mapping[int, JointMap],
        compensation: GoalCompensation,
        *,
        names: Sequence[str],
        ram: Mapping[Register, int],
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
        self.at, self.out_of_range = JointEstimate(maps), OutOfRangeJoints(maps, self.ram)
        self.is_set_up = False
        self.on_command: CommandListener | None = None
        self.t_sent = clock.now()
        self._maps, self._compensation, self._clock = maps, compensation, clock

    def __enter__(self) -> None:
        """Begin a block in which a loss of the port is noted; the error goes on."""

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if isinstance(error, PortUnavailable):
            self.lost(error)

    def lost(self, error: PortUnavailable) -> None:
        """Note that the port was lost."""
        if self.connection.is_open:
            self.connection.lost(error)
        self.is_set_up = False

    def bus(self) -> Bus:
        """The bus, with the servos found; ``PortUnavailable`` if there is no port at present."""
        bus = self.connection.open_bus
        if bus is None or not self.is_set_up:
            reason = "not connected at present; check the USB cable and plug it in again"
            raise PortUnavailable("the arm's port", reason)
        return bus

    # Setting up

    def set_up(self) -> bool:
        """Find the servos and set them up; those that are driven go on as they are.

        Returns whether all of them are driven. Raises ``NoReply`` if a servo that answered until
        now is silent, or all are.
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

        Returns those that are limp, and the errors of those that refused. One that does not answer
        after all counts as silent and is set up when it answers again.
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
        """Write a RAM register, and write it again after each restart of its servo."""
        self.ram[servo_id][register] = value
        if servo_id not in self.presence.silent:
            self.bus().write(servo_id, register, value)

    def put_all(self, register: Register, values: Mapping[int, int]) -> None:
        """Write a register of many servos; all that answer are tried before anything is raised."""
        answering = self.index.keys() - self.presence.silent
        self.bus().write_each(register, {i: values[i] for i in answering})

    def _set_up_servo(self, bus: Bus, servo_id: int) -> ServoCondition:
        i = self.index[servo_id]
        servo = prepare(bus, self._maps[i], self.ram[servo_id])
        self.ram[servo_id][reg.TORQUE_LIMIT] = servo.torque_limit
        self.at.found(i, servo.present_ticks, self._clock.now())
        self._compensation.found(i, servo)
        self.out_of_range.found(i, crawls=servo.crawls)
        return servo

    # Torque

    def switch_on(self) -> None:
        """Drive all joints to the goals that have been set; a silent jaw is left out.

        Raises:
            BusError: A servo of the arm is silent, or one did not obey.
            RuntimeError: No goals have been set.
        """
        if not self._compensation.is_set:
            raise RuntimeError("write a goal before torque is switched on")
        self.require_arm()
        self.refuse_unsure(self._maps)
        bus = self.bus()
        for servo_id, goal in self._goals().items():
            i = self.index[servo_id]
            held = Ticks(self._compensation.held[i])
            here = self.at.ticks(i) if held == LIMP else held
            if self.out_of_range.may_be_driven(bus, i, here):
                self._engage(bus, servo_id, goal)

    def switch_off(self) -> None:
        """Let go of all joints; raises ``BusError`` once all servos have been tried."""
        self._compensation.is_set = False
        self._compensation.held[:] = [LIMP] * 6
        try:
            self.put_all(reg.TORQUE_ENABLE, dict.fromkeys(self.index, 0))
        finally:
            self.out_of_range.let_go(self.bus())

    def catch(self, i: int) -> None:
        bus = self.bus()
        if self.out_of_range.may_be_driven(bus, i, self.at.ticks(i)):
            joint = self._maps[i]
            self._engage(bus, joint.servo_id, joint.to_goal(self.at.q[i]))

    def limit_again(self) -> None:
        limits = {servo_id: own[reg.TORQUE_LIMIT] for servo_id, own in self.ram.items()}
        self.put_all(reg.TORQUE_LIMIT, limits)

    def require_arm(self) -> None:
        """Raise ``NoReply`` unless all servos of the arm answer."""
        silent = self.presence.silent
        if lost := sorted(i for i in silent if self.index[i] < 5):
            raise missing_servos(self.bus(), lost, set(self.index) - silent)

    def refuse_unsure(self, joints: Collection[int]) -> None:
        """Raise ``NoReply`` if two recent readings of a joint that answers do not agree."""
        for i in self.at.unconfirmed(self._clock.now() - _FRESH):
            servo_id = self._maps[i].servo_id
            if i in joints and servo_id not in self.presence.silent:
                raise unconfirmed_position(self.bus(), servo_id)

    # Goals

    def send(self, bus: Bus) -> None:
        """Send the goals, except to silent servos and to joints outside their limits."""
        self.t_sent = now = self._clock.now()
        but, silent = self.out_of_range.left, self.presence.silent
        if silent:
            but = but.union(self.index[i] for i in silent)
        packet = self._compensation.packet(reg.GOAL_POSITION, now, but)
        if packet:
            bus.port.write(packet)
            if self.on_command is not None:
                held = self._compensation.held
                self._sent({s: Ticks(held[i]) for s, i in self.index.items() if i not in but})

    def lead(
        self, q_goal: Sequence[float], shares: Sequence[float], but: Collection[int] = ()
    ) -> None:
        """Send the arm joints to ``q_goal`` [rad] with these shares of their drive, and the jaw.

        The joints in ``but`` get no goal, like those outside their limits.
        """
        now, data, sent = self._clock.now(), {}, {}
        silent, left = self.presence.silent, self.out_of_range.left
        for servo_id, goal in self._compensation.yielded(q_goal, now, silent).items():
            i, ram = self.index[servo_id], self.ram[servo_id]
            if i in left or i in but:
                continue
            limit = ram[reg.TORQUE_LIMIT]
            if i < len(q_goal):
                limit = min(round(1000.0 * shares[i]), limit)
            sent[servo_id] = goal
            speed = reg.GOAL_VELOCITY.encode(ram[reg.GOAL_VELOCITY])
            inert = reg.GOAL_TIME.encode(0)  # lies between the others
            data[servo_id] = (
                reg.GOAL_POSITION.encode(goal) + inert + speed + reg.TORQUE_LIMIT.encode(limit)
            )
        if data:
            self.bus().sync_write(reg.GOAL_POSITION.address, data)
            self._sent(sent, is_guided=True)

    def _goals(self) -> dict[int, Ticks]:
        return self._compensation.goals(self._clock.now(), self.presence.silent)

    def _engage(self, bus: Bus, servo_id: int, goal: Ticks) -> None:
        engage(bus, servo_id, goal)
        self._sent({servo_id: goal}, is_seed=True)

    def _sent(
        self, goals: Mapping[int, Ticks], *, is_guided: bool = False, is_seed: bool = False
    ) -> None:
        for servo_id, goal in goals.items():
            self._compensation.held[self.index[servo_id]] = goal
        if self.on_command is not None:
            self.on_command(
                SentCommand(
                    t=self._clock.now(),
                    q_cmd=tuple(self._compensation.q[:5]),
                    q_jaw_cmd=self._compensation.q[5],
                    goals=dict(goals),
                    is_guided=is_guided,
                    is_seed=is_seed,
                )
            )
