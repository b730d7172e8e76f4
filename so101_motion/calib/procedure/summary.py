"""Describe a calibration to the user: where the arm is, hints, travel bars, what will be saved."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from so101_motion.calib.procedure.steps import State
from so101_motion.calib.procedure.travel import MIDDLE, ROLL, Verdict, around, can_be_accepted
from so101_motion.calib.procedure.view import TICKS_PER_DEG, JointView
from so101_motion.calib.record import compare, record
from so101_motion.calib.record.record import JOINTS, Calibration
from so101_motion.calib.record.zero import ROLL_UPRIGHT, STOPS
from so101_motion.common.operation import Row, Tone
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_deg
from so101_motion.drivers.bus.registers import TICKS_PER_TURN
from so101_motion.drivers.bus.ticks import RAD_PER_TICK

HOMING_POSE: Mapping[str, float] = {
    **dict.fromkeys(ARM_JOINTS, 0.0),
    ROLL: ROLL_UPRIGHT,
    GRIPPER_JOINT: sum(STOPS[GRIPPER_JOINT]) / 2.0,
}
"""The model's angles in the homing pose [rad]: about the middle of each travel."""

_FACTORY = (0, 0, TICKS_PER_TURN - 1)  # offset and limits of a servo nobody has calibrated
_HOMED = (State.HOMED, State.RECORDING, State.COMPLETED)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseEstimate:
    """Estimated joint angles for display while the arm is uncalibrated; guesses are marked.

    Before homing, the former calibration is used, if there was one. After homing, the joints are
    taken to have been in the requested pose at that moment. A joint that has reached both stops is
    known exactly.
    """

    # every joint's angle [rad]; a joint that was never read has its homing angle
    angles: Mapping[str, float]
    guessed: frozenset[str]  # joints whose angle is a guess

    @property
    def q_jaw(self) -> float:
        """Jaw angle [rad]."""
        return self.angles[GRIPPER_JOINT]


def estimate_pose(
    state: State, joints: Mapping[str, JointView], former: Mapping[str, float]
) -> PoseEstimate:
    """Estimate the joint angles; ``former`` are those before homing [rad]."""
    angles, guessed = dict(HOMING_POSE), set(JOINTS)
    for joint, view in joints.items():
        if view.ticks is None:
            continue
        if state in _HOMED:
            angles[joint], is_guess = _since_homing(view, view.ticks)
        elif joint in former and (view.homing_offset, view.range_min, view.range_max) != _FACTORY:
            angles[joint], is_guess = former[joint], False
        else:
            angles[joint], is_guess = _from_pose(joint, view.ticks), True
        if not is_guess:
            guessed.discard(joint)
    return PoseEstimate(angles=angles, guessed=frozenset(guessed))


def _since_homing(view: JointView, ticks: int) -> tuple[float, bool]:
    """The angle of a homed joint, and whether it is a guess."""
    lower, upper = view.recorded_min, view.recorded_max
    if lower is not None and upper is not None and view.verdict is Verdict.COMPLETE:
        middle = sum(STOPS[view.joint]) / 2.0
        return middle + (ticks - (lower + upper) / 2.0) * RAD_PER_TICK, False
    return _from_pose(view.joint, ticks), view.joint != ROLL  # roll's zero is where it was homed


def _from_pose(joint: str, ticks: int) -> float:
    return HOMING_POSE[joint] + (ticks - MIDDLE) * RAD_PER_TICK


NEAR_DEG = 25.0
"""How far from the middle of its travel a joint may be homed [deg]. Chosen: the travel is found
anyway, but beyond this the user has probably misread the picture."""

UPRIGHT_DEG = 12.0  # the same for wrist_roll, whose zero is where it is held. Chosen

FEW = 2  # at most so many joints may be accepted with an unusual travel. Chosen


# The homing pose


def hints(joints: Mapping[str, JointView], now: PoseEstimate) -> tuple[Row, ...]:
    return tuple(_hint(view, now) for view in joints.values())


def _hint(view: JointView, now: PoseEstimate) -> Row:
    joint = view.joint
    if view.ticks is None:
        return Row(label=joint, cells=("does not answer: check its cable",), tone="bad")
    if joint in now.guessed:
        return Row(label=joint, cells=("by eye: it was never calibrated",), tone="dim")
    off_deg = to_deg(now.angles[joint] - HOMING_POSE[joint])
    if abs(off_deg) <= (UPRIGHT_DEG if joint == ROLL else NEAR_DEG):
        return Row(label=joint, cells=("there",), tone="good")
    return Row(label=joint, cells=(f"{abs(off_deg):.0f}° off",), tone="warm")


def picture_note(now: PoseEstimate, joints: Iterable[str]) -> str:
    """A note on how exact the picture is; empty when it is exact."""
    there = tuple(joints)
    guessed = [joint for joint in there if joint in now.guessed]
    if not guessed:
        return ""
    if len(guessed) == len(there):
        return (
            "The picture moves as the arm does, but may be some degrees off: joints that were never"
            " calibrated do not know their position. Trust the arm, not the picture."
        )
    return "The picture is some degrees off until all are done."


# The travels


TONES: Mapping[Verdict | None, Tone] = {
    None: "dim",
    Verdict.UNTOUCHED: "dim",
    Verdict.NOT_SEEN: "warm",
    Verdict.TOO_SHORT: "busy",
    Verdict.ALMOST: "warm",
    Verdict.COMPLETE: "good",
    Verdict.FULL_TURN: "good",
    Verdict.TOO_WIDE: "bad",
    Verdict.WRONG_DIRECTION: "bad",
}

_PLAIN = (
    None, Verdict.UNTOUCHED, Verdict.TOO_SHORT, Verdict.COMPLETE, Verdict.FULL_TURN
)  # fmt: skip
"""Verdicts that need no text beside the bar."""


def travels(joints: Mapping[str, JointView], *, rests: bool = False) -> tuple[Row, ...]:
    """A bar for each joint; once the arm ``rests``, with what is wrong with a short travel."""
    return tuple(_travel(view, rests) for view in joints.values())


def _travel(view: JointView, rests: bool) -> Row:
    begin, end, at = _on_bar(view)
    is_short = rests and view.verdict is Verdict.TOO_SHORT
    is_plain = view.verdict in _PLAIN and (view.joint != ROLL or view.is_done) and not is_short
    is_unswept = view.verdict is Verdict.FULL_TURN and view.travel < TICKS_PER_TURN - 1
    tone = "bad" if view.ticks is None else "dim" if is_unswept else TONES[view.verdict]
    # no tick for a travel that can be saved but is short or was not recorded
    mark = "!" if tone == "warm" else "–" if is_unswept else "✓"
    return Row(
        label=view.joint,
        bar=(begin, end),
        at=at,
        cells=(_figures(view),),
        text="" if view.ticks is not None and is_plain else _advice(view),
        tone=tone,
        mark=mark if view.is_done else "",
    )


def _advice(view: JointView) -> str:
    advice = view.sentence.partition("; ")[2]
    if view.verdict is Verdict.TOO_SHORT:
        return f"too little is recorded: {advice}"
    return advice if view.verdict is Verdict.ALMOST and advice else view.sentence


def _figures(view: JointView) -> str:
    if view.verdict is Verdict.FULL_TURN:
        return "full turn"
    if view.verdict is Verdict.NOT_SEEN:
        return "not all seen"
    if view.verdict is Verdict.COMPLETE:  # its stops yield a little
        return f"{min(view.travel_deg, view.expected_deg):.0f} of {view.expected_deg:.0f}°"
    return f"{view.travel_deg:.0f} of {view.expected_deg:.0f}°"


def _on_bar(view: JointView) -> tuple[float, float, float | None]:
    """Begin and end of the travel, and the joint's place, as shares of the bar.

    The bar shows the expected travel with the homing pose in its middle, shifted or widened so that
    all of the recorded travel is on it.
    """
    whole = view.expected_deg * TICKS_PER_DEG
    lower, upper = view.recorded_min, view.recorded_max
    if lower is None or upper is None:
        at = None if view.ticks is None else _within(0.5 + (view.ticks - MIDDLE) / whole)
        return 0.5, 0.5, at
    whole = max(whole, float(upper - lower), 1.0)
    begin = min(max(0.5 + (lower - MIDDLE) / whole, 0.0), 1.0 - (upper - lower) / whole)
    at = None if view.ticks is None else _within(begin + (view.ticks - lower) / whole)
    return begin, begin + (upper - lower) / whole, at


def _within(share: float) -> float:
    return min(max(share, 0.0), 1.0)


def left(joints: Mapping[str, JointView]) -> tuple[str, ...]:
    return tuple(joint for joint, view in joints.items() if not view.is_done)


def short(joints: Mapping[str, JointView]) -> tuple[str, ...]:
    """The joints that can be saved although they were not quite at both stops; not wrist_roll."""
    return tuple(
        joint for joint, view in joints.items() if view.verdict is Verdict.ALMOST and joint != ROLL
    )


def acceptable(joints: Mapping[str, JointView]) -> tuple[str, ...]:
    """The unfinished joints whose travel may be right on an unusual arm.

    Empty unless this is so for all of them, and if they are many: then the recording has hardly
    begun.
    """
    missing = left(joints)
    may_be = all(can_be_accepted(joints[joint].verdict, joints[joint].travel) for joint in missing)
    return missing if may_be and len(missing) <= FEW else ()


# What is about to be saved


COLUMNS = ("quality", "recorded", "change")  # the cells of a line

_QUALITIES: Mapping[Verdict | None, tuple[str, Tone]] = {
    Verdict.COMPLETE: ("good", "good"),
    Verdict.FULL_TURN: ("full turn", "good"),
    Verdict.ALMOST: ("fair", "warm"),
    Verdict.TOO_SHORT: ("accepted", "warm"),
    Verdict.TOO_WIDE: ("too wide", "warm"),
    Verdict.WRONG_DIRECTION: ("doubtful", "warm"),
}


def calibration_of(joints: Mapping[str, JointView]) -> Calibration:
    return {
        joint: replace(
            record.default(joint),
            homing_offset=view.homing_offset,
            range_min=view.range_min,
            range_max=view.range_max,
        )
        for joint, view in joints.items()
    }


def in_force(joints: Mapping[str, JointView]) -> Calibration:
    return calibration_of({joint: view for joint, view in joints.items() if view.is_done})


def lines(joints: Mapping[str, JointView], before: Calibration) -> tuple[Row, ...]:
    rows = compare.diff(
        {joint: entry for joint, entry in before.items() if joint in joints},
        calibration_of(joints),
    )
    moved = {row.joint for row in rows if row.differs}
    return tuple(
        _line(view, before.get(view.joint), is_moved=view.joint in moved)
        for view in joints.values()
    )


def _line(view: JointView, was: record.JointCalibration | None, *, is_moved: bool) -> Row:
    quality, tone = _QUALITIES.get(view.verdict, ("", "dim"))
    change = "new" if was is None else "the same"
    if was is not None and is_moved:
        ends = (
            (view.range_min, was.range_min),
            (view.range_max, was.range_max),
        )
        offset = view.homing_offset - was.homing_offset
        change = " / ".join(
            f"{around(offset + now - then) / TICKS_PER_DEG:+.1f}°" for now, then in ends
        )
    whole = "360°" if view.verdict is Verdict.FULL_TURN else f"{view.travel_deg:.0f}°"
    return Row(
        label=view.joint,
        cells=(quality, whole, change),
        text=view.sentence if tone == "warm" else "",
        tone=tone,
        mark="✓" if tone == "good" else "!",
    )
