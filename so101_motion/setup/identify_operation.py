"""Identifying an arm's servos as an operation: plan, move once a person agrees, keep the figures.

Planning moves nothing, and Stop ends the motions like any other. The figures are kept beside the
calibration and used at once.
"""

from __future__ import annotations

from typing import Any

from so101_motion.common.errors import CalibrationError, NotPossibleNow
from so101_motion.common.modes import Mode
from so101_motion.common.operation import LocalOperation, Offer, Row, View
from so101_motion.common.units import to_deg
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.setup.identify import Identification, IdentificationOutline
from so101_motion.setup.identify_report import IdentifyReport

_OFF = "Measures how each servo differs from its type. The arm moves, for about three minutes."
_PLANNED = "Planned; nothing moves yet. Read what will move, then press a button below it."
_CLEAR = "Move only when nothing is in its way and nobody is near it."
_KEPT = "Saved beside the calibration and used from now on."


class IdentifyOperation(LocalOperation):
    """Identifies the servos of an arm on a port of this computer."""

    refuses = False

    def __init__(self, rig: HardwareRig) -> None:
        super().__init__()
        self._rig = rig
        self._identification: Identification | None = None
        self._outline: IdentificationOutline | None = None
        self._report: IdentifyReport | None = None
        self._doing = ""
        self.commands = {"plan": self._plan, "move": self._move}

    def close(self) -> None:
        """End what is under way; its command then raises ``Interrupted``."""
        if self._identification is not None:
            self._identification.cancel()

    @property
    def view(self) -> View:
        """The present state; never waits."""
        outline, report, doing = self._outline, self._report, self._doing
        mode = self._rig.arm.state.mode
        busy = doing or (None if mode is Mode.HOLDING else f"the arm is {mode.value}")
        moves: tuple[Offer, ...] = ()
        text, note = _KEPT if report is not None else _OFF, ""
        if report is not None:
            note = " ".join(report.remarks())
        if doing:
            text = f"{doing} … Stop ends it."
        elif outline is not None:
            left_out = (f"{joint} is left out: {why}." for joint, why in outline.obstacles)
            text, note = f"{_PLANNED} {outline.sentence}", " ".join((*left_out, _CLEAR))
            moves = tuple(
                Offer(command="move", title=title, arguments={"carrying": carrying}, why_not=busy)
                for title, carrying in (
                    ("The gripper is empty", False),
                    ("It carries something", True),
                )
            )
        return View(
            state="planned" if moves else "idle",
            text=text,
            columns=() if report is None else ("torque", "friction", "dead time", "play"),
            rows=() if report is None else tuple(_rows(report)),
            note=note,
            doing=doing,
            offers=(Offer(command="plan", title="Plan the motions", why_not=busy), *moves),
        )

    def _plan(self) -> None:
        if self._rig.settings.file is None:
            raise CalibrationError(
                None,
                "this arm has no calibration file, and the figures belong beside one",
                "calibrate it",
            )
        self._identification = Identification(self._rig)
        self._outline = self._identification.outline()

    def _move(self, carrying: bool = False) -> dict[str, Any]:
        """Move as outlined, and keep the figures; ``carrying`` weighs what the hand carries."""
        identification, outline = self._identification, self._outline
        if identification is None or outline is None:
            raise NotPossibleNow("move", "plan the motions first")
        self._outline = self._report = None
        self._doing = "Raising the arm"
        try:
            identification.move_and_record(outline, self._tell)
            self._doing = "Computing"
            self._report = identification.report(hand_is_empty=not carrying, keeps=True)
            self._rig.reload()
        finally:
            self._doing = ""
        return self._report.to_json()

    def _tell(self, joint: str, share: float) -> None:
        self._doing = f"Moving {joint}, {share:.0%} done"


def _rows(report: IdentifyReport) -> list[Row]:
    return [
        Row(
            label=joint,
            cells=(
                *(f"{share:.0%}" for share in (each.torque, each.friction, each.dead_time)),
                "–" if each.play is None else f"{to_deg(each.play):.2f}°",
            ),
        )
        for joint, each in report.found.servos.items()
    ]
