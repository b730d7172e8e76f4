"""Verify a calibration: lead the limp joints to their stops by hand, and compare the stops.

The offset that a servo holds is taken into account, so any servo can be compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from so101_motion.calib.access import BusAccess
from so101_motion.calib.procedure import eeprom
from so101_motion.calib.procedure.sampler import Sampler
from so101_motion.calib.procedure.session import find
from so101_motion.calib.procedure.travel import TravelArc, around
from so101_motion.calib.record.record import Calibration, JointCalibration
from so101_motion.calib.record.zero import SWEPT
from so101_motion.common.errors import CalibrationError, NotPossibleNow
from so101_motion.common.operation import LocalOperation, Offer, Row, Tone, View
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.drivers.bus.registers import TICKS_PER_TURN

DEG_PER_TICK = 360.0 / TICKS_PER_TURN

SHORT_DEG = 3.0
"""A joint has been at both stops if it moved at most so much less than in the calibration. Chosen,
like the other two: a stop yields a little to a hand."""

SAME_DEG = 2.0  # largest shift of both stops that means nothing

LONG_DEG = 5.0  # a joint that moves so much farther was not at its stops when it was calibrated


NOTHING_NEW = 3.0
"""It ends by itself when all joints were at both stops and none has gone farther for this long [s].
Chosen."""

AT_MOST = 120.0  # without a person it ends after this time [s]. Chosen

_MARKS: dict[bool | None, tuple[str, Tone]] = {
    None: ("○", "dim"),
    True: ("✓", "good"),
    False: ("!", "warm"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class JointComparison:
    """The stops of a joint, compared with its calibration."""

    joint: str  # its name
    moved_deg: float  # how far it was led from end to end
    expected_deg: float  # how far it goes in the calibration
    # how much its angle reads too much under the calibration; None until it has been at both stops
    reads_deg: float | None
    agrees: bool | None  # whether the calibration is right; None likewise
    sentence: str  # all of this for people


def compared(
    joint: str, entry: JointCalibration, arc: TravelArc | None, *, held_offset: int
) -> JointComparison:
    """Compare how a joint was led, in its servo's ticks, with its calibration."""
    span = entry.range_max - entry.range_min
    expected, moved = span * DEG_PER_TICK, arc.travel * DEG_PER_TICK if arc is not None else 0.0
    say = partial(JointComparison, joint=joint, moved_deg=moved, expected_deg=expected)
    if arc is None or moved < expected - SHORT_DEG or arc.hole * DEG_PER_TICK > SHORT_DEG:
        sentence = f"led through {moved:.0f} of {expected:.0f} deg; lead it to both stops"
        return say(reads_deg=None, agrees=None, sentence=sentence)
    lower = around(arc.lower + held_offset - entry.range_min - entry.homing_offset)
    direction = -1.0 if entry.drive_mode else 1.0
    reads = direction * (lower + (arc.travel - span) / 2.0) * DEG_PER_TICK
    again = f"calibrate it: so101 calibrate --joint {joint}"
    if moved - expected > LONG_DEG:
        sentence = f"goes {moved - expected:.1f} deg farther than it was calibrated; {again}"
        return say(reads_deg=reads, agrees=False, sentence=sentence)
    if abs(reads) > SAME_DEG:
        sentence = f"its stops are {reads:+.1f} deg from where the calibration has them; {again}"
        return say(reads_deg=reads, agrees=False, sentence=sentence)
    return say(reads_deg=reads, agrees=True, sentence=f"right within {abs(reads):.1f} deg")


class Verification(LocalOperation):
    """Compares a calibration, but for wrist_roll, with an arm whose joints a person leads."""

    def __init__(
        self, calibration: Calibration, access: BusAccess, *, is_attended: bool = True
    ) -> None:
        super().__init__()
        self._entries = {j: e for j, e in calibration.items() if j in (*SWEPT, GRIPPER_JOINT)}
        if not self._entries:
            raise CalibrationError(None, "it has no joint that has stops", "calibrate the arm")
        self._access, self._is_attended = access, is_attended
        self._sampler = Sampler(access.clock, tuple(self._entries))
        self._offsets: Mapping[str, int] = {}
        self._released_at = 0.0
        self._state = "ready"
        self.commands = {"release": self._release, "end": self._end}

    @property
    def joints(self) -> tuple[JointComparison, ...]:
        arcs = self._sampler.seen.arcs
        return tuple(
            compared(joint, entry, arcs.get(joint), held_offset=self._offsets.get(joint, 0))
            for joint, entry in self._entries.items()
        )

    @property
    def view(self) -> View:
        joints, state = self.joints, self._state
        rows = (
            Row(
                label=each.joint,
                bar=(0.0, min(each.moved_deg / each.expected_deg, 1.0)),
                text=each.sentence,
                mark=_MARKS[each.agrees][0],
                tone=_MARKS[each.agrees][1],
            )
            for each in joints
        )
        release = Offer(
            command="release", title="release", due_in=None if self._is_attended else 0.0
        )
        end = Offer(command="end", title="finish", due_in=self._due(joints))
        return View(
            state=state,
            title="Verification",
            text=_TEXTS[state],
            rows=() if state == "ready" else tuple(rows),
            offers={"ready": (release,), "leading": (end,)}.get(state, ()),
            is_over=state == "ended",
        )

    def _due(self, joints: tuple[JointComparison, ...]) -> float | None:
        seen = self._sampler.seen
        due = None if self._is_attended else AT_MOST - (seen.t - self._released_at)
        if all(each.agrees is not None for each in joints):
            due = NOTHING_NEW - (seen.t - seen.grown_at)
        return None if due is None else max(due, 0.0)

    def _release(self) -> None:
        self._require("ready")
        found = self._access.call(partial(find, joints=tuple(self._entries)))
        self._offsets = {joint: each.held.homing_offset for joint, each in found.items()}
        self._access.call(eeprom.let_go)
        self._sampler.record()
        self._released_at = self._access.clock.now()
        self._access.watch(self._sampler)
        self._state = "leading"

    def _end(self) -> None:
        self._require("leading")
        self._access.watch(None)
        self._state = "ended"

    def _require(self, state: str) -> None:
        if self._state != state:
            raise NotPossibleNow("the step", f"the verification is {self._state}")


_TEXTS = {
    "ready": "the joints are about to go limp: hold the arm with one hand",
    "leading": "the joints are limp; lead every joint slowly to both its stops, in any order",
    "ended": "the joints stay limp",
}
