"""Reject servo positions that a joint cannot have reached since it was last seen.

A checksum of eight bits lets one wrong answer in 256 pass, and a servo may be wrong. Each reading
is therefore checked against the last sure position of its joint. With ``v`` the velocity there and
``dt`` the time since, a joint can be

* between that position and the one it would reach at ``v``, for it may have been stopped between,
* plus or minus ``PUSH * dt^2 / 2`` for a push meanwhile, ``SCATTER`` and ``PLAY``,
* but not where it could only get faster than ``FASTEST``.

A reading that does not fit is rejected, and asked for again. One that fits is *sure* if it agrees
with the past, which means within ``CLOSE`` of the first range, or if it is the last of ``ENOUGH``
readings in a row that agree with each other. Such a row counts even if each reading alone does not
fit, but never if it is out of reach at ``FASTEST``. If the joint really is elsewhere, for example
because an encoder slipped, its position is accepted a quarter of a second later.

Code that makes a goal out of a position uses a sure one.

All positions are in ticks on the circle of 4096, so the seam needs no special case.
"""

from __future__ import annotations

import math

from so101_motion.common.units import to_rad
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.drivers.bus.ticks import TICKS_PER_RAD

FASTEST = to_rad(900.0) * TICKS_PER_RAD
"""Largest speed of a joint [tick/s]. The fastest motor does 312 deg/s without load (7.4 V type,
datasheet), an arm dragged by hand was measured at 223 deg/s, and a falling joint of the emulated
arm, which has less friction than a real one, reaches 674 deg/s. Chosen: a third more."""

PUSH = to_rad(15000.0) * TICKS_PER_RAD
"""Largest acceleration of a joint [tick/s^2]: the stall torque of 2.94 N m on the rotor alone,
0.0218 kg m^2 at the output (fit to recordings of an STS3215), gives 7,700 deg/s^2; twice that for a
hand. A harder hit costs one more question."""

SCATTER = 6.0
"""Largest difference between two readings of a joint at rest [tick]: each was seen to scatter by 3
ticks."""

PLAY = 15.0
"""Play that a joint may cross at once [tick]: 14.8 were measured on an SO-101 (robonine), 0.5 deg
is specified. A moving joint whose load changes sides crosses it in 10 ms."""

CLOSE = SCATTER + 0.5 * PUSH * 0.01**2
"""Two readings agree if they are no farther apart than this [tick]: the largest change in one
period of 10 ms, 1.3 deg. Chosen."""

ENOUGH = 4
"""Readings in a row that must agree to be sure without the past. Wrong ones may agree by chance:
with half of all answers corrupted, joints were thrown by pairs of them, by three agreeing ones
three times in two million answers, by four not once in 1.4 million."""

_HANDS = 0.5 * FASTEST  # largest speed between readings that agree with each other
_RECENT = 0.1  # longest time for which the last sure velocity is used [s]
_SPACING = 0.004  # velocities come from readings at least so far apart [s]; chosen
_HALF = TICKS_PER_TURN // 2


class KnownPosition:
    """Position and velocity of one joint, in plain numbers: six are judged in every cycle.

    ``is_sure`` is whether a second reading confirms the newest that was believed, at ``t`` [s].
    """

    __slots__ = ("_count", "_last", "_last_t", "_last_v", "_sure", "_sure_t", "_v", "is_sure", "t")

    def __init__(self, ticks: int, t: float, *, is_sure: bool) -> None:
        self.is_sure, self.t = is_sure, t
        self._sure, self._v = ticks, 0.0
        self._sure_t = t if is_sure else -math.inf
        self._last, self._last_t, self._last_v, self._count = ticks, t, 0.0, 0

    def judge(self, ticks: int, asked: float, answered: float) -> bool:
        """Whether the joint can be at ``ticks``; if so, that becomes its known position.

        It was asked at ``asked`` and the answer there at ``answered`` [s]; the servo looked
        sometime in between.
        """
        if not 0 <= ticks < TICKS_PER_TURN:
            return False
        moved = (ticks - self._sure + _HALF) % TICKS_PER_TURN - _HALF
        dt = answered - self._sure_t
        on = self._v * dt if dt <= _RECENT else 0.0
        above, below = (moved - on, -moved) if on > 0.0 else (moved, on - moved)
        beyond = above if above > below else below
        is_possible = abs(moved) <= SCATTER + FASTEST * dt
        if is_possible and beyond <= CLOSE:
            self._trust(ticks, asked, moved)
            return True
        self._count_in(ticks, asked)
        if not is_possible:
            return False
        if self._count >= ENOUGH:
            self._sure, self._sure_t, self._v = ticks, asked, self._last_v
            self.t, self.is_sure = asked, True
            return True
        if beyond <= SCATTER + PLAY + 0.5 * PUSH * dt * dt:
            self.t, self.is_sure = asked, False
            return True
        return False

    def _trust(self, ticks: int, asked: float, moved: int) -> None:
        """Make a reading that agrees with the past the sure position."""
        since = asked - self._sure_t
        if since >= _SPACING:
            self._v = moved / since
            self._sure, self._sure_t = ticks, asked
        self.t, self.is_sure, self._count = asked, True, 0

    def _count_in(self, ticks: int, asked: float) -> None:
        """Count readings in a row that agree with each other but not with the past."""
        moved = (ticks - self._last + _HALF) % TICKS_PER_TURN - _HALF
        dt = asked - self._last_t
        on = self._last_v * dt
        if self._count == 1 and abs(moved) <= CLOSE + _HANDS * dt and dt <= _RECENT:
            self._count = 2
        elif self._count > 1 and min(on, 0.0) - CLOSE <= moved <= max(on, 0.0) + CLOSE:
            self._count += 1
        else:
            self._count = 1
        if self._count == 1 or dt >= _SPACING:
            self._last_v = moved / dt if self._count > 1 else 0.0
            self._last, self._last_t = ticks, asked
