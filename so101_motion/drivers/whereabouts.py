"""Where the joints are and how fast, from what their servos answer or from what they should do.

An answer is lost now and then, and a busy computer may hold all of them back for a tenth of a
second, while the setpoints go on. To let the last position stand in would make a joint at 80 deg/s
seem to be 8 deg behind by then, and somebody would stop it for that. So what stands in is the last
position and as much as the joint has been sent on since, but nothing beyond where it is wanted: one
that is told to stay where it was pushed goes nowhere. One that nobody sends anywhere, because it is
limp or a hand leads it, is where it was seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from so101_motion.drivers import registers as reg
from so101_motion.drivers.protocol import Answer
from so101_motion.drivers.slope import Slope
from so101_motion.drivers.ticks import JointMap, Ticks


class Whereabouts:
    """Positions and velocities, in plain lists: for so few they beat numpy in every cycle.

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
        self._seen: list[tuple[float, float | None]] = [(0.0, None)] * n  # and where it was wanted
        self._slope = Slope(n)

    def ticks(self, i: int) -> Ticks:
        """The position of joint ``i``'s servo."""
        return self._maps[i].to_ticks(self.q[i])

    def found(self, i: int, ticks: Ticks) -> None:
        """Joint ``i``'s servo has been set up, and this is its position."""
        self.q[i] = self._maps[i].to_rad(ticks)
        self._seen[i] = (self.q[i], None)

    def forget(self) -> None:
        """There was a gap; velocities begin anew."""
        self._slope.clear()

    def look(
        self, answers: Mapping[int, Answer], wanted: Sequence[float | None], now: float
    ) -> None:
        """Take in what the servos answered.

        Args:
            answers: What they hold from the position on, by servo.
            wanted: Where the joints have been sent [rad]; None is nowhere.
            now: When they were asked [s].
        """
        position = reg.PRESENT_POSITION
        for i, joint in self._maps.items():
            answer = answers.get(joint.servo_id)
            if answer is None:
                self.q[i] = self._stand_in(i, wanted[i])
            else:
                ticks = position.decode(answer.data[: position.size])
                self.q[i] = joint.to_rad(Ticks(ticks))
                self._seen[i] = (self.q[i], wanted[i])
        self._slope.add(now, self.q)
        self.qd = self._slope.value()

    def _stand_in(self, i: int, wanted: float | None) -> float:
        q, then = self._seen[i]
        if wanted is None or then is None:
            return q
        lower, upper = sorted((q, wanted))
        return min(max(q + wanted - then, lower), upper)
