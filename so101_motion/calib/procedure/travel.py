"""Record the travel of a joint, judge it, and choose the homing offset and limits for it.

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
from enum import Enum

import numpy as np

from so101_motion.calib.record import zero
from so101_motion.calib.record.record import LARGEST_OFFSET, NARROWEST, WIDEST
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.drivers.bus.registers import TICKS_PER_TURN

MIDDLE = 2047  # what a servo reads in the homing pose [tick]; LeRobot's convention

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
    """Records the positions that one joint has passed. Used by one thread."""

    def __init__(self) -> None:
        self.arc: TravelArc | None = None  # None before the third reading; replaced whole
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


# The verdict. Each joint's travel is known from the arm's CAD model, so a joint that was not moved,
# did not reach its stops or moved too far is reported during the recording. A joint that did not
# quite reach its stops can be saved, but its zero is then the middle of what was recorded, because
# it is not known at which stop the rest is missing. wrist_roll has weak stops or none, so it need
# not be moved from stop to stop: then it counts as a full turn, 0 to 4095, as in LeRobot. Its zero
# is where it was held in the homing pose.

ENOUGH = 0.8
"""The share of its expected travel that a joint must have moved. Chosen: the shortest pan and jaw
among public calibrations have 0.88 and 0.85 of it, and are usable."""

SLACK, SLACK_JAW = 45, 228
"""How much less than expected a travel from stop to stop may be [tick]: 4 deg, as ``zero.by_stops``
has it, and 20 deg for the jaw, the most among public calibrations."""

EXTRA = 57
"""How much more than expected a travel from stop to stop may be [tick]: 5 deg, as in
``zero.by_stops``. Up to 6 and 11 deg have been seen of roll and jaw, whose zeros do not depend on
it."""

EXCESS = 1.12
"""A travel this many times the expected one is impossible; the widest public one has 1.11."""

MISTAKEN = 0.5
"""A part that was not seen is mistaken for the part where the joint cannot go if it is larger. From
this share of it on the joint has to be moved again. Chosen: that part may be smaller than expected,
too."""

_ASKEW = 341  # [tick] 30 deg, chosen: a roll homed so far off its middle was held the wrong way

ROLL = "wrist_roll"


class Verdict(Enum):
    """The verdict on a joint's travel."""

    UNTOUCHED = "untouched"
    NOT_SEEN = "not_seen"
    TOO_SHORT = "too_short"
    ALMOST = "almost"
    COMPLETE = "complete"
    FULL_TURN = "full_turn"
    TOO_WIDE = "too_wide"
    WRONG_DIRECTION = "wrong_direction"


@dataclass(frozen=True, slots=True, kw_only=True)
class Assessment:
    """The verdict on a joint's travel, with a sentence."""

    verdict: Verdict
    sentence: str
    is_usable: bool


def assess(
    joint: str, arc: TravelArc | None, *, expected: int, home: int, counts_down: bool = False
) -> Assessment:
    """Judge the travel of a joint, while it is recorded or at the end; all in ticks."""
    travel = 0 if arc is None else arc.travel
    moved = f"{_deg(travel)}° of its {_deg(expected)}° recorded"
    if counts_down:
        return _not_usable(
            Verdict.WRONG_DIRECTION,
            "its servo counts the wrong way round; bit 7 of its register 18 (phase) must be 0",
        )
    if arc is not None and arc.hole > MISTAKEN * (TICKS_PER_TURN - expected):
        return _not_usable(
            Verdict.NOT_SEEN,
            f"readings missed {_deg(arc.hole)}° of its way; move it slowly through all of it again",
        )
    if joint == ROLL and not is_swept(travel, expected):
        return _assess_unswept_roll(arc, home, moved)
    if travel < NARROWEST:
        return _not_usable(Verdict.UNTOUCHED, "not moved yet; move it from stop to stop")
    if travel < ENOUGH * expected:
        return _not_usable(Verdict.TOO_SHORT, f"only {moved}; move it on to both its stops")
    if travel > min(EXCESS * expected, WIDEST):
        return _not_usable(
            Verdict.TOO_WIDE,
            f"{moved}, which is impossible; check that its motor is no other joint's and that its"
            " horn does not slip, then start again",
        )
    assert arc is not None  # it has a travel
    return _grade(joint, arc, expected, home, moved)


def _grade(joint: str, arc: TravelArc, expected: int, home: int, moved: str) -> Assessment:
    verdict, remark = Verdict.COMPLETE, ": done"
    if joint == GRIPPER_JOINT and arc.upper - home < arc.travel // 10:
        verdict = Verdict.WRONG_DIRECTION  # unless it was open, so it may be saved
        remark = (
            ", all towards smaller readings; if it was closed when homing was set, its servo is"
            " mounted the wrong way round"
        )
    elif arc.travel < expected - (SLACK_JAW if joint == GRIPPER_JOINT else SLACK):
        verdict, remark = Verdict.ALMOST, "; press it gently against both its stops"
    elif arc.travel > expected + EXTRA and joint in zero.SWEPT:
        verdict = Verdict.TOO_WIDE
        remark = (
            ", more than there is between its stops; it can be saved, but its zero is then a guess."
            " Check that its horn does not slip"
        )
    elif joint == ROLL and abs(home - arc.lower - arc.travel // 2) > _ASKEW:
        remark = ": done; its zero is far from the middle: did the gripper open upwards?"
    return Assessment(verdict=verdict, sentence=f"{moved}{remark}", is_usable=True)


def can_be_accepted(verdict: Verdict | None, travel: int) -> bool:
    """Whether a travel [tick] that is not what is expected may be right on an unusual arm."""
    is_possible = NARROWEST <= travel <= WIDEST
    return is_possible and verdict in (Verdict.TOO_SHORT, Verdict.TOO_WIDE)


def is_swept(travel: int, expected: int) -> bool:
    """Whether a travel of wrist_roll [tick] shows its stops; else it counts as a full turn."""
    return ENOUGH * expected <= travel <= WIDEST


def _assess_unswept_roll(arc: TravelArc | None, home: int, moved: str) -> Assessment:
    turned_round = arc is not None and arc.travel > WIDEST
    reach = 0 if arc is None or turned_round else max(home - arc.lower, arc.upper - home)
    if reach >= TICKS_PER_TURN // 2:
        return _not_usable(
            Verdict.TOO_SHORT,
            f"{moved}, and more than half a turn to one side of its zero; move it on to both its"
            " stops, or start again with the gripper opening upwards",
        )
    return Assessment(
        verdict=Verdict.FULL_TURN,
        sentence="recorded as a full turn; to record its stops, move it to both",
        is_usable=True,
    )


def _not_usable(verdict: Verdict, sentence: str) -> Assessment:
    return Assessment(verdict=verdict, sentence=sentence, is_usable=False)


def _deg(ticks: int) -> str:
    return f"{ticks * 360.0 / TICKS_PER_TURN:.0f}"
