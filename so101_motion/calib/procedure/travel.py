"""Record the travel of a joint, and choose the homing offset and limits for it.

How it works. A servo reports positions on a circle of 4096 ticks, and somewhere on that circle is
the seam where 4095 is followed by 0. Where it lies depends on how the servo was mounted and on its
homing offset, so it can be anywhere, even in the middle of the travel. Smallest and largest reading
then mean nothing. So a ``TravelRecorder`` does not keep extremes; it marks every position of the
circle that the joint has passed. The part it never passed is where the joint cannot go, and the
travel is the rest: a ``TravelArc``, seam or no seam. After a pause without readings it is not known
which way the joint went; that leaves a hole, which the next pass fills. A hole as large as the part
where the joint cannot go may be mistaken for it, so the travel says how large its hole is.

Three readings in a row are judged together and the middle one counts, so a single wrong reading
adds nothing to the travel. (It costs nothing either: a joint at its stop is there for more than one
of the hundred readings a second.)

``fit`` then chooses the homing offset that puts a travel within 0 to 4095. The offset set in the
homing pose is kept if the travel fits with it; else the middle of the travel becomes 2047. The
register holds -2047 to 2047, which is every position of the circle but one. Where that one is
needed, its neighbour is taken, and the joint reads 2048 instead.

No bus and no clock: ticks in, ticks out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from so101_motion.calib.record.record import LARGEST_OFFSET
from so101_motion.drivers.bus.registers import TICKS_PER_TURN

MIDDLE = 2047
"""What a servo reads in the homing pose [tick]; LeRobot's convention."""

SEAM_MARGIN = 64
"""A travel with an end nearer than this to the seam is moved to the middle [tick]; 5.6 deg, chosen:
a stop yields a little, and a servo pushed past the seam would read a turn less or more."""

LONGEST_GAP = 0.3
"""After so long without a reading the path in between is unknown [s]. A joint moved by hand reached
2533 tick/s (measured on a leader arm), so it turns less than a fifth of a turn in that time."""


@dataclass(frozen=True, slots=True)
class TravelArc:
    """A joint's travel: an arc on the circle of ticks."""

    lower: int  # its lower end, -2048 to 4095 [tick]; negative if it passes the seam
    travel: int  # how far it goes from there, upwards [tick]; 4095 is a full turn
    hole: int = 0  # the longest part of it that the joint was not seen to pass [tick]

    @property
    def upper(self) -> int:
        """Its upper end [tick]; beyond 4095 if it passes the seam."""
        return self.lower + self.travel

    def unrolled(self, ticks: int) -> int:
        """``ticks``, a turn on or back if that lies nearer to the middle of this travel."""
        start = self.lower + self.travel // 2 - TICKS_PER_TURN // 2
        return start + (ticks - start) % TICKS_PER_TURN

    def moved(self, by: int) -> TravelArc:
        lower = (self.lower + by) % TICKS_PER_TURN
        middle = lower + self.travel // 2
        lower -= TICKS_PER_TURN if middle >= TICKS_PER_TURN else 0
        return TravelArc(lower, self.travel, self.hole)


class TravelRecorder:
    """Records the positions that one joint has passed. Used by one thread.

    Attributes:
        arc: The travel so far; None before the third reading. Replaced whole.
    """

    def __init__(self) -> None:
        self.arc: TravelArc | None = None
        self._passed = np.zeros(TICKS_PER_TURN, dtype=np.bool_)
        self._at: int | None = None  # where the joint is known to have been, unrolled
        self._window: list[int] = []
        self._t = 0.0

    def feed(self, t: float, ticks: int) -> None:
        """Add a reading at ``t`` [s]; of any turn [tick]."""
        if t - self._t > LONGEST_GAP:
            self._window, self._at = [], None
        self._t = t
        near = ticks if not self._window else self._near(ticks)
        self._window = [*self._window[-2:], near]
        if len(self._window) == 3:
            self._pass(sorted(self._window)[1])

    def _near(self, ticks: int) -> int:
        here = self._window[-1] if self._at is None else self._at
        return here + around(ticks - here)

    def _pass(self, to: int) -> None:
        start = to if self._at is None else self._at
        self._at = to
        way = np.arange(min(start, to), max(start, to) + 1) % TICKS_PER_TURN
        if not self._passed[way].all():
            self._passed[way] = True
            self.arc = self._measure()

    def _measure(self) -> TravelArc:
        """All of the circle but the longest part that was never passed."""
        places = np.flatnonzero(self._passed)
        gaps = np.diff(places, append=places[0] + TICKS_PER_TURN)
        longest = int(np.argmax(gaps))
        lower = int(places[(longest + 1) % len(places)])
        travel = TICKS_PER_TURN - int(gaps[longest])
        gaps[longest] = 1
        return TravelArc(lower, travel, int(gaps.max()) - 1).moved(0)


def around(ticks: int) -> int:
    """The same difference of two positions the short way round, -2048 to 2047 [tick]."""
    half = TICKS_PER_TURN // 2
    return (ticks + half) % TICKS_PER_TURN - half


# Homing offsets


def homing_offset(encoder: int) -> int:
    """The offset with which a servo whose encoder counts ``encoder`` [tick] reads ``MIDDLE``."""
    return representable(encoder - MIDDLE)


def representable(offset: int) -> int:
    """The offset of -2047 to 2047 that is the same place of the circle, or its neighbour."""
    return min(-around(-offset), LARGEST_OFFSET)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A homing offset, and the limits of the travel with that offset."""

    homing_offset: int  # what the servo subtracts from its encoder's count [tick]
    lower: int  # lower end of the travel [tick], 0 to 4095
    upper: int  # upper end [tick]
    home: int  # what the servo reads in the homing pose [tick]


def fit(arc: TravelArc, *, offset: int, home: int) -> Fit:
    """The homing offset with which a travel, read with ``offset``, stays off the seam [tick]."""
    margin = min(SEAM_MARGIN, (TICKS_PER_TURN - 1 - arc.travel) // 2)
    chosen = offset
    if not margin <= arc.lower <= TICKS_PER_TURN - 1 - margin - arc.travel:
        chosen = representable(offset + arc.lower + arc.travel // 2 - MIDDLE)
    fitted = arc.moved(offset - chosen)
    return Fit(
        homing_offset=chosen,
        lower=fitted.lower,
        upper=fitted.upper,
        home=fitted.unrolled(home + offset - chosen),
    )


def full_turn(*, offset: int, home: int) -> Fit:
    """The whole circle, for a joint without stops; its zero reads in the middle."""
    return Fit(homing_offset=offset, lower=0, upper=TICKS_PER_TURN - 1, home=home)
