"""Switch the torque of joints on, so that they stay where they are, and off.

A joint is switched on only at a position that two readings agree on. A joint outside its limits,
where no goal can keep it, is left as it is.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from so101_motion.common.clock import Clock
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.ticks import JointMap
from so101_motion.drivers.feetech.chain import Chain
from so101_motion.drivers.feetech.goal_compensation import GoalCompensation
from so101_motion.drivers.feetech.goal_writer import GoalWriter
from so101_motion.drivers.feetech.joint_estimate import JointEstimate
from so101_motion.drivers.feetech.out_of_range import OutOfRangeJoints
from so101_motion.drivers.feetech.presence import missing_servos, unconfirmed_position

_FRESH = 0.1
"""Oldest position at which a joint is held [s]. Chosen: two reads of a resting arm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoParts:
    """The parts of a driver that torque switch and pull share.

    Attributes:
        chain: The servos.
        compensation: Computes their goals.
        at: Estimates the joints' positions.
        out_of_range: The joints outside their limits.
        goals: Sends the goals.
        clock: The clock of the rig.
    """

    chain: Chain
    compensation: GoalCompensation
    at: JointEstimate
    out_of_range: OutOfRangeJoints
    goals: GoalWriter
    clock: Clock


class TorqueSwitch:
    """Switches the torque of all servos. Used by the I/O thread only.

    Args:
        parts: The servos and their state.
        maps: The servo of each joint, by index.
    """

    def __init__(self, parts: ServoParts, maps: Mapping[int, JointMap]) -> None:
        self._chain, self._compensation, self._at = parts.chain, parts.compensation, parts.at
        self._out_of_range, self._goals = parts.out_of_range, parts.goals
        self._clock, self._maps = parts.clock, maps

    def on(self, bus: Bus) -> None:
        """Drive all joints to the goals that have been set; a silent jaw is left out.

        Raises:
            BusError: A servo of the arm is silent, or one did not obey.
            RuntimeError: No goals have been set.
        """
        if not self._compensation.is_set:
            raise RuntimeError("write a goal before torque is switched on")
        self.require_arm(bus)
        self.refuse_unsure(bus, self._maps)
        presence, index = self._chain.presence, self._chain.index
        goals = self._compensation.goals(self._clock.now(), presence.silent)
        for servo_id, goal in goals.items():
            i = index[servo_id]
            held = self._compensation.held[i]
            here = self._at.ticks(i) if held is None else held
            if self._out_of_range.may_be_driven(bus, i, here):
                self._goals.engage(bus, servo_id, goal)

    def off(self, bus: Bus) -> None:
        """Let go of all joints.

        Raises:
            BusError: A servo did not obey; the others have been tried.
        """
        self._compensation.is_set = False
        self._compensation.held = [None] * 6
        try:
            self._chain.put_all(reg.TORQUE_ENABLE, dict.fromkeys(self._chain.index, 0))
        finally:
            self._out_of_range.let_go(bus)

    def catch(self, bus: Bus, i: int) -> None:
        """Drive joint ``i``, which is limp, where it is.

        Raises:
            BusError: Its servo did not obey.
        """
        if self._out_of_range.may_be_driven(bus, i, self._at.ticks(i)):
            joint = self._maps[i]
            self._goals.engage(bus, joint.servo_id, joint.to_goal(self._at.q[i]))

    def limit_again(self) -> None:
        """Restore the torque limits of all servos.

        Raises:
            BusError: One did not take it; the others have been tried.
        """
        ram = self._chain.ram
        self._chain.put_all(reg.TORQUE_LIMIT, {i: own[reg.TORQUE_LIMIT] for i, own in ram.items()})

    def require_arm(self, bus: Bus) -> None:
        """Check that all servos of the arm answer.

        Raises:
            NoReply: One does not.
        """
        silent, index = self._chain.presence.silent, self._chain.index
        if lost := sorted(i for i in silent if index[i] < 5):
            raise missing_servos(bus, lost, set(index) - silent)

    def refuse_unsure(self, bus: Bus, joints: Collection[int]) -> None:
        """Refuse to hold ``joints`` whose position two recent readings do not confirm.

        Raises:
            NoReply: The readings of a joint that answers do not agree.
        """
        for i in self._at.unconfirmed(self._clock.now() - _FRESH):
            servo_id = self._maps[i].servo_id
            if i in joints and servo_id not in self._chain.presence.silent:
                raise unconfirmed_position(bus, servo_id)
