"""Judge a recorded travel, with a sentence for the user who moves the arm.

Each joint's travel is known from the arm's CAD model, so a joint that was not moved, did not reach
its stops or moved too far is reported during the recording. A joint that did not quite reach its
stops can be saved, but its zero is then the middle of what was recorded, because it is not known at
which stop the rest is missing.

wrist_roll has weak stops or none, so it need not be moved from stop to stop: then it counts as a
full turn, 0 to 4095, as in LeRobot. Its zero is where it was held in the homing pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from so101_motion.calib.procedure.travel import TravelArc
from so101_motion.calib.record import zero
from so101_motion.calib.record.record import NARROWEST, WIDEST
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.drivers.bus.registers import TICKS_PER_TURN

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
    moved = f"moved {_deg(travel)} of {_deg(expected)} deg"
    if counts_down:
        return _not_usable(
            Verdict.WRONG_DIRECTION,
            "its servo counts the wrong way round; bit 7 of its register 18 (phase) must be 0",
        )
    if arc is not None and arc.hole > MISTAKEN * (TICKS_PER_TURN - expected):
        return _not_usable(
            Verdict.NOT_SEEN,
            f"{_deg(arc.hole)} deg of its way were not seen; move it through all of its way again",
        )
    if joint == ROLL and not is_swept(travel, expected):
        return _assess_unswept_roll(arc, home, moved)
    if travel < NARROWEST:
        return _not_usable(Verdict.UNTOUCHED, "not moved yet; move it from stop to stop")
    if travel < ENOUGH * expected:
        return _not_usable(Verdict.TOO_SHORT, f"{moved}; move it on to both its stops")
    if travel > min(EXCESS * expected, WIDEST):
        return _not_usable(
            Verdict.TOO_WIDE,
            f"{moved}, which is impossible; check horn and gears for slip, then start again",
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
        sentence="counts as a full turn; move it to both its stops if you want those recorded",
        is_usable=True,
    )


def _not_usable(verdict: Verdict, sentence: str) -> Assessment:
    return Assessment(verdict=verdict, sentence=sentence, is_usable=False)


def _deg(ticks: int) -> str:
    return f"{ticks * 360.0 / TICKS_PER_TURN:.0f}"
