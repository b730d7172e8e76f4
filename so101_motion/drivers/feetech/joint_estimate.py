"""Estimate joint positions and velocities from the servos' replies; bridge lost replies.

A position that is physically impossible is rejected and asked for again (``position_check.py``).

An answer is lost now and then, and a busy computer may hold all of them back for a tenth of a
second, while the setpoints go on. With the last position, a joint at 80 deg/s would seem to be 8
deg behind by then, and its motion would be stopped for that. So a missing position is estimated as
the last one plus the change of the command since, but never beyond the command: a joint that is
commanded to stay where it was pushed goes nowhere. A joint without a command, because it is limp or
a hand leads it, is assumed to be where it was last.

The servo's own velocity comes in steps of 4.4 deg/s, because it counts ticks over 20 ms. A straight
line through the positions of the last tenth of a second (``VelocityEstimate``) is finer and needs
no bytes: with 100 measurements a second a scatter of one tick becomes 0.4 deg/s. It is half that
window late, which does not matter for deciding whether a joint is at rest.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from operator import mul

from so101_motion.common.clock import Clock
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.protocol import Answer
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.position_check import KnownPosition

WINDOW = 0.1
"""How far back the line reaches [s]; chosen, see above."""

_SPACING = WINDOW / 16
"""Measurements closer together than this [s] are left out: at 100 a second none, at 200 every other
one. They would cost time and add little."""

_FEWEST = 3  # with two points the scatter would be the slope; slow polling keeps this many


class VelocityEstimate:
    """Fits the slopes of ``n`` signals; plain Python is faster than numpy for six."""

    def __init__(self, n: int) -> None:
        self._t: deque[float] = deque()
        self._signals: tuple[deque[float], ...] = tuple(deque() for _ in range(n))

    def add(self, t: float, values: Sequence[float]) -> None:
        """Add ``n`` values measured at ``t`` [s]."""
        if self._t and t - self._t[-1] < _SPACING:
            return
        self._t.append(t)
        for signal, value in zip(self._signals, values, strict=True):
            signal.append(value)
        while len(self._t) > _FEWEST and self._t[0] < t - WINDOW - 1e-9:
            self._t.popleft()
            for signal in self._signals:
                signal.popleft()

    def clear(self) -> None:
        self._t.clear()
        for signal in self._signals:
            signal.clear()

    def value(self) -> list[float]:
        """Change per second of each signal; zero until two moments are known."""
        middle = sum(self._t) / max(len(self._t), 1)
        t = [moment - middle for moment in self._t]
        spread = sum(map(mul, t, t))
        if spread <= 0.0:
            return [0.0] * len(self._signals)
        return [sum(map(mul, t, signal)) / spread for signal in self._signals]


_START = reg.PRESENT_POSITION.address


class JointEstimate:
    """Angles ``q`` [rad] and velocities ``qd`` [rad/s] of the joints, 0 without a servo.

    In plain lists, which are faster than numpy for six. ``maps`` has the servo of each joint.
    """

    def __init__(self, maps: Mapping[int, JointMap], n: int = 6) -> None:
        self.q, self.qd = [0.0] * n, [0.0] * n
        self._maps = maps
        self._servos = {joint.servo_id: i for i, joint in maps.items()}
        self._seen: list[tuple[float, float | None]] = [(0.0, None)] * n  # and where it was wanted
        self._slope = VelocityEstimate(n)
        self._known: dict[int, KnownPosition] = {}

    def ticks(self, i: int) -> Ticks:
        return self._maps[i].to_ticks(self.q[i])

    @property
    def sure(self) -> list[float]:
        """The angles of the joints on which two answers agree [rad]; else NaN."""
        known = self._known
        return [q if i in known and known[i].is_sure else math.nan for i, q in enumerate(self.q)]

    def found(self, i: int, ticks: Ticks, now: float) -> None:
        """Start from the confirmed position of joint ``i``'s servo ``now`` [s]."""
        self._known[i] = KnownPosition(ticks % TICKS_PER_TURN, now, is_sure=True)
        self.q[i] = self._maps[i].to_rad(ticks)
        self._seen[i] = (self.q[i], None)

    def forget(self) -> None:
        """Start the velocities anew, after a gap."""
        self._slope.clear()

    def unconfirmed(self, since: float = -math.inf) -> list[int]:
        """The joints whose position no two answers have confirmed since then [s]."""
        known = self._known
        return [i for i in self._maps if not ((k := known.get(i)) and k.is_sure and k.t >= since)]

    def ask(
        self, bus: Bus, count: int, given_up: Collection[int], clock: Clock
    ) -> tuple[dict[int, Answer], Collection[int]]:
        """Ask for ``count`` bytes from the position on; again where it is not credible.

        Returns the answers with credible positions, by servo, and the servos without one. Those
        ``given_up`` are not worth waiting for.
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
            i, ticks = self._servos[servo_id], _position(answer)
            known = self._known.get(i)
            if known is None and 0 <= ticks < TICKS_PER_TURN:
                self._known[i] = KnownPosition(ticks, asked, is_sure=False)
            elif known is None or not known.judge(ticks, asked, answered):
                doubted.append(servo_id)
        return tuple(doubted)

    def look(
        self, answers: Mapping[int, Answer], wanted: Sequence[float | None], now: float
    ) -> None:
        """Update the estimate from credible answers to a question ``now`` [s].

        ``wanted`` are commanded angles [rad]; None for a joint without a command.
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
