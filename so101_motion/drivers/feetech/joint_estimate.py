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
from collections.abc import Collection, Mapping

import numpy as np

from so101_motion.common.clock import Clock
from so101_motion.common.geometry import Array
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.protocol import Answer, Answers
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.drivers.bus.ticks import JointMap, Ticks
from so101_motion.drivers.goal_limiter import SIX, CArray, Six, as_bits
from so101_motion.drivers.position_check import KnownPosition
from so101_motion.native.library import quick

WINDOW = 0.1
"""How far back the line reaches [s]; chosen, see above."""

_ROWS = 32  # as in ``servos.h``
_START = reg.PRESENT_POSITION.address


class JointEstimate(ctypes.Structure):
    """Angles ``q`` [rad] and velocities ``qd`` [rad/s] of six joints, 0 without a servo.

    ``maps`` has the servo of each joint. Computed in ``servo_readings.c``.

    Attributes:
        sure: The angles of the joints on which two answers agree [rad]; else NaN.
        unsure: A bit for each joint that has a servo and is not sure.
        fresh: A bit for each joint that has answered, credibly.
    """

    _fields_ = [
        ("window", ctypes.c_double),
        *((name, SIX) for name in ("direction", "zero_ticks", "seam")),
        *((name, SIX) for name in ("q", "qd", "sure", "seen", "seen_wanted")),
        ("rows", ctypes.c_double),
        ("time", ctypes.c_double * _ROWS),
        ("row", SIX * _ROWS),
        ("known", KnownPosition * 6),
        ("servo", ctypes.c_int * 6),
        ("answered", ctypes.c_int * 6),
        ("fresh", ctypes.c_uint32),
        ("unsure", ctypes.c_uint32),
    ]
    q: Six
    qd: Six
    sure: Six
    fresh: int
    unsure: int

    def __init__(self, maps: Mapping[int, JointMap]) -> None:
        super().__init__(window=WINDOW, seen_wanted=SIX(*[math.nan] * 6), sure=SIX(*[math.nan] * 6))
        for i, joint in maps.items():
            self.direction[i], self.zero_ticks[i] = joint.direction, joint.zero_ticks
            self.seam[i], self.servo[i] = joint.seam, joint.servo_id
        self._maps, self.unsure = maps, as_bits(maps)
        self._servos = {joint.servo_id: i for i, joint in maps.items()}
        self._answers = Answers(self._servos, reg.PRESENT_POSITION.size)
        self._in_c, self._at = quick(), ctypes.c_void_p(ctypes.addressof(self))
        begin, end = (vars(JointEstimate)[name].offset for name in ("q", "sure"))
        self._measured = memoryview(self).cast("B")[begin:end]  # q and qd

    def arrays(self) -> tuple[Array, Array]:
        """``q`` and ``qd`` of the arm's joints as they are now, read-only, shapes (5,)."""
        both = bytes(self._measured)
        return np.frombuffer(both, count=5), np.frombuffer(both, count=5, offset=len(both) // 2)

    def ticks(self, i: int) -> Ticks:
        return self._maps[i].to_ticks(self.q[i])

    def found(self, i: int, ticks: Ticks, now: float) -> None:
        """Start from the confirmed position of joint ``i``'s servo ``now`` [s]."""
        self.known[i].found(ticks % TICKS_PER_TURN, now, is_sure=True)
        self.q[i] = self.seen[i] = self.sure[i] = self._maps[i].to_rad(ticks)
        self.unsure &= ~(1 << i)
        self.seen_wanted[i] = math.nan

    def forget(self) -> None:
        """Start the velocities anew, after a gap."""
        self.rows = 0.0

    def unconfirmed(self, since: float) -> list[int]:
        """The joints whose position no two answers have confirmed since then [s]."""
        found = self._in_c.so101_estimate_unconfirmed(self._at, ctypes.c_double(since))
        return [i for i in self._maps if found >> i & 1]

    def ask(
        self,
        bus: Bus,
        count: int,
        given_up: Collection[int],
        clock: Clock,
        *,
        plainly: tuple[CArray, ctypes.c_void_p | None] | None = None,
    ) -> tuple[Mapping[int, Answer], Collection[int] | None]:
        """Ask for ``count`` bytes from the position on; again where it is not credible.

        Returns the answers with credible positions, by servo, and the servos without one. Those
        ``given_up`` are not worth waiting for.

        In most cycles every servo stands where it can be and reports no fault. With ``plainly``,
        commanded angles as for ``look`` and the address of a ``Trim``, or None, that is to learn,
        that is all done then, None is returned instead of servos, and answers only if they hold
        more than positions.
        """
        answers, self.fresh, asked = self._answers, 0, clock.now()
        if given_up:  # the silent ones first, so that the last one is there to be waited for
            answers = Answers(sorted(self._servos, key=lambda i: i not in given_up), count)
        bus.ask(answers, _START, count)
        heard = self._at, answers.ref, answers.received, asked, clock.now()
        if plainly is None:
            found = self._in_c.so101_estimate_hear(*heard)
        elif not (found := self._in_c.so101_estimate_take(*heard, *plainly)):
            return answers.found if count > reg.PRESENT_POSITION.size else {}, None
        doubted = [servo_id for servo_id, i in self._servos.items() if found >> i & 1]
        if not doubted:
            return answers.found, ()
        again, asked = Answers(doubted, count), clock.now()
        bus.ask(again, _START, count)
        found = self._in_c.so101_estimate_hear(
            self._at, again.ref, again.received, asked, clock.now()
        )
        still = [i for i in doubted if found >> self._servos[i] & 1 or not again.is_from(i)]
        sound = answers.found | again.found
        return {i: answer for i, answer in sound.items() if i not in still}, still

    def look(self, wanted: CArray, now: float) -> None:
        """Update the estimate from the answers that were credible, to a question ``now`` [s].

        ``wanted``, an array of C, are commanded angles [rad]; NaN for a joint without a command.
        """
        self._in_c.so101_estimate_look(self._at, wanted, now)
