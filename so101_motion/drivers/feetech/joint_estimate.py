"""Estimate joint positions and velocities from the servos' replies; bridge lost replies.

An answer that physics forbids is not believed but asked for again (``position_check.py``).

An answer is lost now and then, and a busy computer may hold all of them back for a tenth of a
second, while the setpoints go on. To let the last position stand in would make a joint at 80 deg/s
seem to be 8 deg behind by then, and somebody would stop it for that. So what stands in is the last
position and as much as the joint has been sent on since, but nothing beyond where it is wanted: one
that is told to stay where it was pushed goes nowhere. One that nobody sends anywhere, because it is
limp or a hand leads it, is where it was seen.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

from so101_motion.common.clock import Clock
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.protocol import Answer
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.feetech.velocity_estimate import VelocityEstimate
from so101_motion.drivers.position_check import PositionCheck

_START = reg.PRESENT_POSITION.address


class JointEstimate:
    """Position and velocity of each joint; in plain lists, which are faster than numpy for six.

    Args:
        maps: The servo of each joint there is, by index.
        n: How many joints; one without a servo stays at 0.

    Attributes:
        q: Where the joints are [rad].
        qd: How fast they are [rad/s].
    """

    def __init__(self, maps: Mapping[int, JointMap], n: int = 6) -> None:
        self.q, self.qd = [0.0] * n, [0.0] * n
        self._maps = maps
        self._servos = {joint.servo_id: i for i, joint in maps.items()}
        self._seen: list[tuple[float, float | None]] = [(0.0, None)] * n  # and where it was wanted
        self._slope, self._belief = VelocityEstimate(n), PositionCheck(n)

    def ticks(self, i: int) -> Ticks:
        """The position of joint ``i``'s servo."""
        return self._maps[i].to_ticks(self.q[i])

    def surely(self, i: int) -> float:
        """Where joint ``i`` is [rad], if two answers agree on it; else NaN."""
        return self.q[i] if self._belief.is_sure(i) else math.nan

    def found(self, i: int, ticks: Ticks, now: float) -> None:
        """Joint ``i``'s servo has been set up, and this is surely its position ``now`` [s]."""
        self._belief.begin(i, ticks, now)
        self.q[i] = self._maps[i].to_rad(ticks)
        self._seen[i] = (self.q[i], None)

    def forget(self) -> None:
        """There was a gap; velocities begin anew."""
        self._slope.clear()

    def unconfirmed(self, since: float = -math.inf) -> list[int]:
        """The joints that no two answers have placed, or none since then [s]."""
        return self._belief.unconfirmed(self._maps, since)

    def ask(
        self, bus: Bus, count: int, given_up: Collection[int], clock: Clock
    ) -> tuple[dict[int, Answer], Collection[int]]:
        """Ask all servos for ``count`` bytes from the position on.

        Whose position is not believed is asked once more at once.

        Args:
            bus: Where they are.
            count: How many bytes.
            given_up: Who is not worth waiting for.
            clock: What time it is.

        Returns:
            The answers whose positions are believed, by servo, and whose never were.
        """
        asked = clock.now()
        found = bus.sync_read(tuple(self._servos), _START, count, given_up=given_up)
        doubted = self._doubted(found, asked, clock.now())
        if not doubted:
            return found, ()
        asked = clock.now()
        again = bus.sync_read(doubted, _START, count)
        still = {*doubted} - again.keys() | {*self._doubted(again, asked, clock.now())}
        sound = {i: answer for i, answer in (found | again).items() if i not in still}
        return sound, still

    def _doubted(
        self, answers: Mapping[int, Answer], asked: float, answered: float
    ) -> tuple[int, ...]:
        doubted = []
        for servo_id, answer in answers.items():
            ticks = _position(answer)
            if not self._belief.judge(self._servos[servo_id], ticks, asked, answered):
                doubted.append(servo_id)
        return tuple(doubted)

    def look(
        self, answers: Mapping[int, Answer], wanted: Sequence[float | None], now: float
    ) -> None:
        """Take in what the servos answered.

        Args:
            answers: Those that are believed, by servo.
            wanted: Where the joints have been sent [rad]; None is nowhere.
            now: When they were asked [s].
        """
        for i, joint in self._maps.items():
            answer = answers.get(joint.servo_id)
            if answer is None:
                self.q[i] = self._stand_in(i, wanted[i])
            else:
                self.q[i] = joint.to_rad(Ticks(_position(answer)))
                self._seen[i] = (self.q[i], wanted[i])
        self._slope.add(now, self.q)
        self.qd = self._slope.value()

    def _stand_in(self, i: int, wanted: float | None) -> float:
        q, then = self._seen[i]
        if wanted is None or then is None:
            return q
        lower, upper = sorted((q, wanted))
        return min(max(q + wanted - then, lower), upper)


def _position(answer: Answer) -> int:
    low, high = answer.data[0], answer.data[1]
    if high < TICKS_PER_TURN >> 8:  # nearly always, and four times as fast
        return high << 8 | low
    return reg.PRESENT_POSITION.decode(answer.data[: reg.PRESENT_POSITION.size])
