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

import ctypes
import math
from collections.abc import Collection, Mapping, Sequence

from so101_motion.common.clock import Clock
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.protocol import Answer
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.goal_limiter import SIX, Six
from so101_motion.drivers.position_check import KnownPosition
from so101_motion.native.library import quick

WINDOW = 0.1
"""How far back the line reaches [s]; chosen, see above."""

_ROWS = 32  # as in ``servos.h``
_START = reg.PRESENT_POSITION.address


class JointEstimate(ctypes.Structure):
    """Angles ``q`` [rad] and velocities ``qd`` [rad/s] of six joints, 0 without a servo.

    ``maps`` has the servo of each joint. Computed in ``servo_readings.c``.
    """

    _fields_ = [
        ("window", ctypes.c_double),
        *((name, SIX) for name in ("direction", "zero_ticks", "seam")),
        *((name, SIX) for name in ("q", "qd", "seen", "seen_wanted")),
        ("rows", ctypes.c_double),
        ("time", ctypes.c_double * _ROWS),
        ("row", SIX * _ROWS),
        ("known", KnownPosition * 6),
    ]
    q: Six
    qd: Six

    def __init__(self, maps: Mapping[int, JointMap]) -> None:
        super().__init__(window=WINDOW, seen_wanted=SIX(*[math.nan] * 6))
        for i, joint in maps.items():
            self.direction[i], self.zero_ticks[i] = joint.direction, joint.zero_ticks
            self.seam[i] = joint.seam
        self._maps = maps
        self._servos = {joint.servo_id: i for i, joint in maps.items()}
        self._ticks = (ctypes.c_int * 6)()
        self._in_c, self._at = quick(), ctypes.c_void_p(ctypes.addressof(self))

    def ticks(self, i: int) -> Ticks:
        return self._maps[i].to_ticks(self.q[i])

    @property
    def sure(self) -> Six:
        """The angles of the joints on which two answers agree [rad]; else NaN."""
        self._in_c.so101_estimate_sure(self._at, sure := SIX())
        return sure[:]

    def found(self, i: int, ticks: Ticks, now: float) -> None:
        """Start from the confirmed position of joint ``i``'s servo ``now`` [s]."""
        self.known[i].found(ticks % TICKS_PER_TURN, now, is_sure=True)
        self.q[i] = self.seen[i] = self._maps[i].to_rad(ticks)
        self.seen_wanted[i] = math.nan

    def forget(self) -> None:
        """Start the velocities anew, after a gap."""
        self.rows = 0.0

    def unconfirmed(self, since: float = -math.inf) -> list[int]:
        """The joints whose position no two answers have confirmed since then [s]."""
        found = self._in_c.so101_estimate_unconfirmed(self._at, ctypes.c_double(since))
        return [i for i in self._maps if found >> i & 1] if found else []

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
        times = ctypes.c_double(asked), ctypes.c_double(answered)
        found = self._in_c.so101_estimate_judge(self._at, self._take(answers), self._ticks, *times)
        return tuple(s for s, i in self._servos.items() if found >> i & 1) if found else ()

    def look(self, answers: Mapping[int, Answer], wanted: Sequence[float], now: float) -> int:
        """Update the estimate from credible answers to a question ``now`` [s].

        ``wanted`` are commanded angles [rad]; NaN for a joint without a command. Returns a bit for
        each joint that has answered.
        """
        fresh = self._take(answers)
        given = (fresh, self._ticks, SIX(*wanted), ctypes.c_double(now))
        self._in_c.so101_estimate_look(self._at, *given)
        return fresh

    def _take(self, answers: Mapping[int, Answer]) -> int:
        """Note the positions in ``answers``; a bit for each joint that has answered."""
        joints = 0
        for servo_id, (data, _) in answers.items():
            i = self._servos[servo_id]
            self._ticks[i] = data[0] | data[1] << 8  # one with its sign set is none an encoder has
            joints |= 1 << i
        return joints
