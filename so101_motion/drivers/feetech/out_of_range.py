"""Leave joints that are outside their limits alone, and bring them in slowly when asked.

A servo clamps every goal into its limits. So with any goal a joint outside moves to its limit, as
fast as its caps let it. It therefore gets no goal at all before a command inside the limits, and
stays as it was found: limp, or held by a goal from before these limits were set.

The first goal inside brings it in: its caps are lowered to a crawl, then it is driven. Once inside
it gets its caps back. If a goal outside comes before that, it is stopped where it is: its torque is
switched off and on again, and a servo that is switched on holds its present position. So is a joint
that a hand has guided outside. (LeRobot relies on that on many arms. With a firmware that behaves
otherwise, the joint would move on to its limit: at a crawl, or at its caps if a hand had guided
it.)
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from so101_motion.common.units import to_rad
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.registers import Register
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.feetech.joint_estimate import JointEstimate
from so101_motion.drivers.feetech.servo_setup import CRAWL, engage, is_outside

_MARGIN = to_rad(0.3)  # how far inside its limit a joint is brought; more than the trim leaves

_Ram = Mapping[int, Mapping[Register, int]]


class OutOfRangeJoints:
    """The joints outside their limits, and which of those are on their way in.

    ``ram`` is what RAM registers must hold, by servo. Joints that are ``left`` get no goal; those
    that are ``sinking`` are held ones whose servos have switched themselves off.
    """

    def __init__(self, maps: Mapping[int, JointMap], ram: _Ram) -> None:
        self.left: set[int] = set()
        self.sinking: set[int] = set()
        self._maps, self._ram = maps, ram
        self._coming: set[int] = set()
        self._crawling: set[int] = set()  # whose caps are lowered

    def __bool__(self) -> bool:
        return bool(self.left or self._coming)

    @property
    def free(self) -> Collection[int]:
        """All joints outside: no goal keeps them in place, and their servos keep them slow."""
        return (*self.left, *self._coming)

    def found(self, i: int, *, crawls: bool) -> None:
        """Take over joint ``i`` after set-up; with lowered caps it is held outside its limits."""
        self._coming.discard(i)
        for group in (self.left, self._crawling):
            (group.add if crawls else group.discard)(i)

    def may_be_driven(self, bus: Bus, i: int, here: Ticks) -> bool:
        """Whether joint ``i`` is inside, so that a goal can keep it; if not, it is left alone.

        ``here`` is its servo's goal, or its position if the servo is limp.
        """
        if i in self._coming:
            return True
        if is_outside(self._maps[i], here):
            self.left.add(i)
            return False
        self.left.discard(i)
        self._put_back(bus, i)
        return True

    def lead(self, bus: Bus, goals: Sequence[float], ticks: Mapping[int, Ticks]) -> list[int]:
        """Start to bring in joints whose command is inside, and stop those whose is not any more.

        ``goals`` are the commands of all joints [rad], ``ticks`` the goals of the servos that
        answer, within their limits. Returns the joints that were stopped.
        """
        stopped = []
        for i in [*self.left, *self._coming]:
            servo_id = self._maps[i].servo_id
            if servo_id not in ticks or (i in self._coming) == self._holds(i, goals[i]):
                continue
            if i in self._coming:
                self._stop(bus, i)
                stopped.append(i)
                continue
            self._crawling.add(i)
            for register, value in CRAWL.items():
                bus.write(servo_id, register, value)
            engage(bus, servo_id, ticks[servo_id])
            self.left.discard(i)
            self._coming.add(i)
        return stopped

    def stop(self, bus: Bus, at: JointEstimate, silent: Collection[int]) -> dict[int, Ticks]:
        """Hold joints of the arm that a hand has guided outside, where no goal would keep them.

        Returns where joints were stopped, by index.
        """
        stopped = {}
        for i, joint in self._maps.items():
            is_guided = i < 5 and i not in self.left and joint.servo_id not in silent
            if is_guided and is_outside(joint, here := at.ticks(i)):
                self._stop(bus, i)
                stopped[i] = here
        return stopped

    def sank(self, bus: Bus, i: int, here: Ticks, *, has_let_go: bool) -> bool:
        """Note where a held joint is whose servo has switched itself off, or drives again.

        Outside its limits it gets no goal, and is held there when its servo drives again. Returns
        whether it was made to hold at ``here``.
        """
        if has_let_go:
            self.sinking.add(i)
            (self.left.add if is_outside(self._maps[i], here) else self.left.discard)(i)
            return False
        if i not in self.sinking:
            return False
        self.sinking.discard(i)
        if i in self.left:
            self._stop(bus, i)
        return i in self.left

    def arrive(self, bus: Bus, q: Sequence[float]) -> None:
        """Restore the caps of joints that are inside at ``q`` [rad]."""
        for i in [i for i in self._coming if self._holds(i, q[i])]:
            self._put_back(bus, i)
            self._coming.discard(i)

    def let_go(self, bus: Bus) -> None:
        """Forget all joints outside, because all are limp now; restore their caps."""
        self.left.clear()
        self._coming.clear()
        for i in list(self._crawling):
            self._put_back(bus, i)

    def nearest(self, q: Sequence[float]) -> dict[int, float]:
        """The angle to which each joint outside would be brought in [rad], by index."""
        found = {}
        for i in (*self.left, *self._coming):
            joint = self._maps[i]
            margin = min(_MARGIN, (joint.upper - joint.lower) / 2.0)
            found[i] = min(max(q[i], joint.lower + margin), joint.upper - margin)
        return found

    def _holds(self, i: int, q: float) -> bool:
        joint = self._maps[i]
        return joint.lower - 1e-6 <= q <= joint.upper + 1e-6

    def _stop(self, bus: Bus, i: int) -> None:
        servo_id = self._maps[i].servo_id
        bus.write(servo_id, reg.TORQUE_ENABLE, 0)
        bus.write(servo_id, reg.TORQUE_ENABLE, 1)
        self._coming.discard(i)
        self.left.add(i)

    def _put_back(self, bus: Bus, i: int) -> None:
        if i in self._crawling:
            servo_id = self._maps[i].servo_id
            for register in CRAWL:
                bus.write(servo_id, register, self._ram[servo_id][register])
            self._crawling.discard(i)
