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

import ctypes

from so101_motion.common.units import to_rad
from so101_motion.drivers.bus.ticks import TICKS_PER_RAD
from so101_motion.native.library import quick

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

CLOSE = SCATTER + 0.5 * PUSH * 0.01**2
"""Two readings agree if they are no farther apart than this [tick]: the largest change in one
period of 10 ms, 1.3 deg. Chosen."""


ENOUGH = 4
"""Readings in a row that must agree to be sure without the past. Wrong ones may agree by chance:
with half of all answers corrupted, joints were thrown by pairs of them, by three agreeing ones
three times in two million answers, by four not once in 1.4 million."""


class KnownPosition(ctypes.Structure):
    """Position and velocity of one joint; six are judged in every cycle, in ``servo_readings.c``.

    ``is_sure`` is whether a second reading confirms the newest that was believed, at ``t`` [s].
    """

    _fields_ = [
        *((name, ctypes.c_double) for name in ("scatter", "fastest", "push", "close", "enough")),
        *((name, ctypes.c_double) for name in ("is_there", "is_sure", "t", "ticks", "v")),
        *((name, ctypes.c_double) for name in ("sure_t", "last", "last_t", "last_v", "count")),
    ]
    is_sure: float

    def found(self, ticks: int, t: float, *, is_sure: bool) -> None:
        """Start from ``ticks``, read at ``t`` [s]."""
        self.scatter, self.fastest, self.push = SCATTER, FASTEST, PUSH
        self.close, self.enough = CLOSE, ENOUGH
        quick().so101_position_begin(ctypes.byref(self), ticks, ctypes.c_double(t), is_sure)

    def judge(self, ticks: int, asked: float, answered: float) -> bool:
        """Whether the joint can be at ``ticks``; if so, that becomes its known position.

        It was asked at ``asked`` and the answer there at ``answered`` [s]; the servo looked
        sometime in between.
        """
        times = ctypes.c_double(asked), ctypes.c_double(answered)
        return bool(quick().so101_position_judge(ctypes.byref(self), ticks, *times))
