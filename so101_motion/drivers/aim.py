"""From where the six joints are wanted to the goals of their servos.

A goal is not the place where a joint is wanted. It lies beyond, by what the joint's weight makes
its servo give way (``droop.py``) and by what the servo would lag behind at speed (``lead.py``), and
it is a whole number of ticks within the servo's limits.

What is sent is remembered, because it is what the servo pulls towards from then on: the joint
stands a little off it under its load, and has to keep that distance when it is told to stay.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from so101_motion.drivers.droop import Gravity, Trim
from so101_motion.drivers.lead import BRAKING, braking, stopping_distance
from so101_motion.drivers.registers import Fault
from so101_motion.drivers.servo_setup import ServoCondition
from so101_motion.drivers.ticks import JointMap, Ticks


class Aim:
    """Six numbers each, in plain lists: for so few they beat numpy in every cycle.

    Args:
        maps: The servo of each joint there is, by index.
        gravity: The torque that holds a pose.

    Attributes:
        trim: What is added for the weight.
        q: Where the joints are wanted [rad].
        held: The servos' goals; None for one that is limp, or whose goal is not known.
        is_set: Whether somebody has said where the joints are wanted since they were found.
    """

    def __init__(self, maps: Mapping[int, JointMap], gravity: Gravity) -> None:
        self.trim = Trim(gravity)
        self.q = [0.0] * 6
        self.held: list[Ticks | None] = [None] * 6
        self.is_set = False
        self._overloaded: set[int] = set()
        self._maps = maps
        self._qd: Sequence[float] | None = None
        self._braking = [BRAKING] * 6

    def found(self, i: int, servo: ServoCondition) -> None:
        """Joint ``i``'s servo has been set up and was found like this."""
        self.held[i] = servo.goal_ticks if servo.torque else None
        self._overloaded.discard(i)
        self.trim.set_gain(i, servo.p_gain)
        self._braking[i] = braking(servo.max_acceleration)

    def heard(self, i: int, faults: int) -> None:
        """What the status byte of joint ``i``'s servo was.

        One that has given up on its load does not take it up again before its goal is where it
        stands. So nothing is added to that goal, and what weighs on the joint has to wait a moment.
        """
        if faults & Fault.OVERLOAD:
            self._overloaded.add(i)
        elif self._overloaded:
            self._overloaded.discard(i)

    def point(self, q: list[float], now: float, qd: Sequence[float] | None = None) -> None:
        """The joints are wanted at ``q`` [rad].

        Args:
            q: Where.
            now: Since when [s].
            qd: How fast the arm joints are wanted there [rad/s]; None is at rest.
        """
        self.q, self._qd = q, qd
        if self.is_set:
            self.trim.command(q, now)
        else:
            self.is_set = True
            self.trim.start(q, now, [self._sag(i) for i in range(6)])

    def goals(self, absent: Collection[int] = ()) -> dict[int, Ticks]:
        """What to send to whom, by servo; ``absent`` ones are left out."""
        offset = self.trim.offset
        if self._qd is not None:
            for i, qd in enumerate(self._qd):
                offset[i] += stopping_distance(qd, self._braking[i])
        for i in self._overloaded:
            offset[i] = 0.0
        return {
            joint.servo_id: joint.to_goal(self.q[i] + offset[i])
            for i, joint in self._maps.items()
            if joint.servo_id not in absent
        }

    def _sag(self, i: int) -> float | None:
        """How far the goal of joint ``i``'s servo is from where it is wanted [rad]."""
        held = self.held[i]
        return None if held is None else self._maps[i].to_rad(held) - self.q[i]
