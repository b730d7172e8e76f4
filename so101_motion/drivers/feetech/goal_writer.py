"""Send goals to the servos; no other file does while the arm is in use.

Three kinds: the goals of a motion or of a resting arm, in one packet; those of an arm that a hand
leads, each with the share of drive that its servo may use; and the first goal of a servo, written
and read back before torque comes on. ``GoalCompensation.held`` remembers what was sent, and
``on_command`` is called with it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from so101_motion.common.clock import Clock
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.registers import Register
from so101_motion.drivers.bus.ticks import Ticks
from so101_motion.drivers.command_record import CommandListener, SentCommand
from so101_motion.drivers.feetech.goal_compensation import GoalCompensation
from so101_motion.drivers.feetech.servo_setup import engage


class GoalWriter:
    """Sends the goals of ``compensation``. Used by the I/O thread only.

    Args:
        compensation: Computes the goals.
        clock: The clock of the rig.
        index: The joint of each servo.
        ram: What RAM registers must hold, by servo.

    Attributes:
        on_command: Called with every command as it is sent; None for nobody.
        t: When goals were sent last [s].
    """

    def __init__(
        self,
        compensation: GoalCompensation,
        clock: Clock,
        index: Mapping[int, int],
        ram: Mapping[int, Mapping[Register, int]],
    ) -> None:
        self.on_command: CommandListener | None = None
        self.t = clock.now()
        self._compensation, self._clock = compensation, clock
        self._index, self._ram = index, ram

    def send(self, bus: Bus, silent: Collection[int], left: Collection[int]) -> None:
        """Send the goals, except to ``silent`` servos and to joints ``left`` alone.

        Raises:
            PortUnavailable: The port is gone.
        """
        self.t = now = self._clock.now()
        encode, index = reg.GOAL_POSITION.encode, self._index
        goals = self._compensation.goals(now, silent)
        if left:
            goals = {i: goal for i, goal in goals.items() if index[i] not in left}
        if goals:
            bus.sync_write(
                reg.GOAL_POSITION.address, {i: encode(goal) for i, goal in goals.items()}
            )
            self._sent(goals)

    def lead(
        self,
        bus: Bus,
        q_goal: Sequence[float],
        shares: Sequence[float],
        silent: Collection[int],
        left: Collection[int],
    ) -> None:
        """Send the arm joints to ``q_goal`` [rad] with these shares of their drive, and the jaw.

        Raises:
            PortUnavailable: The port is gone.
        """
        now, data, sent = self._clock.now(), {}, {}
        for servo_id, goal in self._compensation.yielded(q_goal, now, silent).items():
            i, ram = self._index[servo_id], self._ram[servo_id]
            if i in left:
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
            bus.sync_write(reg.GOAL_POSITION.address, data)
            self._sent(sent, is_guided=True)

    def engage(self, bus: Bus, servo_id: int, goal: Ticks) -> None:
        """Switch a servo on at ``goal`` [tick].

        Raises:
            BusError: The servo did not obey.
        """
        engage(bus, servo_id, goal)
        self._sent({servo_id: goal}, is_seed=True)

    def _sent(
        self, goals: Mapping[int, Ticks], *, is_guided: bool = False, is_seed: bool = False
    ) -> None:
        for servo_id, goal in goals.items():
            self._compensation.held[self._index[servo_id]] = goal
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
