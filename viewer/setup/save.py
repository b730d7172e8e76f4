"""The page to review, save and undo a calibration."""

from __future__ import annotations

from dataclasses import dataclass

import viser

from so101_motion.calib.procedure import summary
from so101_motion.calib.procedure.steps import Command, State
from so101_motion.calib.record import zero_report
from so101_motion.calib.record.store import Stored
from so101_motion.setup.calibrator import StepResult
from so101_motion.setup.setup_steps import SAVE

from ..page.texts import capital
from . import calibration_cards, cards
from .final_test import OPEN_POSE
from .page import CalibrationPage
from .setup_context import SetupContext

_BESIDE = (
    " The present file is kept as a version. Change is how far the ends of each travel have moved."
)
_OPEN_POSE = (
    "Look at what was recorded. Then move the arm to a pose like the blue ghost's, clear of"
    " everything, and save: its joints are held there, and the final test starts there."
)
_NOT_SAVED = (
    "It is not saved yet; what was recorded is kept. Do what is said below, then try again. The"
    " joints will be held."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Outcome:
    """What the page says of the saved calibration."""

    stored: Stored
    trouble: str
    zero_reports: tuple[str, ...]


class SavePage(CalibrationPage):
    """The page of the result."""

    def __init__(self, setup: SetupContext) -> None:
        super().__init__(setup, SAVE)
        self._lines: tuple[summary.SummaryLine, ...] = ()
        self._outcome: _Outcome | None = None
        self._is_undone = False

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        self._todo = gui.add_html("")
        self._table = gui.add_html("")
        self._save = gui.add_button(
            "Save", icon=viser.Icon.DEVICE_FLOPPY, color="green", visible=False
        )
        self._text = gui.add_html("")
        self._undo = gui.add_button(
            "Undo: restore the previous calibration",
            icon=viser.Icon.ARROW_BACK_UP,
            color="gray",
            visible=False,
        )
        self._setup.context.on_press(self._save, self._store)
        self._setup.context.on_press(self._undo, self._restore)

    def enter(self) -> None:
        """Read what was recorded, or what an earlier setup saved."""
        setup = self._setup
        if setup.saved is None:
            self._outcome, self._is_undone = None, False
            if setup.target is not None:
                setup.saved = setup.target.calibrator.situation.saved

    def show(self) -> None:
        """Show what will be saved, or was."""
        now, busy = self._now, bool(self._setup.doing)
        if now is None:
            return
        self._draw(now)
        is_open = now.view.state is State.COMPLETED
        if is_open:
            self._lines = summary.lines(now.joints, self._setup.before)
        saved = self._setup.saved
        has_failed = is_open and self._setup.trouble is not None
        todo = _NOT_SAVED if has_failed else _instruction(is_open, saved is not None)
        self._todo.content = cards.instruction(SAVE.title, todo)
        self._setup.picture.ghost(OPEN_POSE if is_open else None)
        is_in_force = self._outcome is not None and not self._is_undone
        shows = (is_open and not has_failed) or is_in_force  # the reason takes the table's place
        self._table.content = calibration_cards.summary(self._lines) if shows else ""
        self._save.visible, self._save.disabled = is_open, busy
        self._save.label = "Try to save again" if has_failed else "Save"
        self._undo.visible = (
            self._outcome is not None and bool(self._setup.before) and not self._is_undone
        )
        self._undo.disabled = busy
        if is_open:
            kept = _BESIDE if self._setup.before else ""
            self._text.content = cards.note(
                f"It will be stored in the motors and in {now.calibration_file}.{kept}"
            )
        else:
            self._text.content = self._about_saved()

    def _about_saved(self) -> str:
        outcome = self._outcome
        if outcome is None:
            return ""
        title = "The previous calibration is restored:" if self._is_undone else "Saved:"
        html = calibration_cards.saved(title, str(outcome.stored.path), outcome.stored.notes)
        if outcome.trouble:
            html += cards.failed(outcome.trouble)
        return html + "".join(cards.note(capital(text)) for text in outcome.zero_reports)

    # What the buttons do

    def _store(self) -> None:
        is_first = not self._setup.before
        self._do(
            "storing it in the motors and in the file",
            lambda target: _outcome(target.calibrator.step(Command.SAVE), is_first=is_first),
            self._take,
        )

    def _restore(self) -> None:
        self._do(
            "going back", lambda target: _outcome(target.calibrator.restore()), self._take_back
        )

    def _take(self, outcome: _Outcome, *, is_undone: bool = False) -> None:
        self._outcome, self._is_undone = outcome, is_undone
        self._setup.saved = outcome.stored.path

    def _take_back(self, outcome: _Outcome) -> None:
        self._take(outcome, is_undone=True)


def _instruction(is_open: bool, is_saved: bool) -> str:
    if is_open:
        return _OPEN_POSE
    if is_saved:
        return "The motors and the file hold the calibration."
    return "There is nothing to save yet: go back to the homing pose."


def _outcome(ended: StepResult, *, is_first: bool = False) -> _Outcome:
    assert ended.stored is not None  # it was saved
    zero_reports = _meanings(ended.stored, is_first=is_first)
    return _Outcome(stored=ended.stored, trouble=ended.trouble or "", zero_reports=zero_reports)


def _meanings(stored: Stored, *, is_first: bool) -> tuple[str, ...]:
    """Explain the zeros, guesses first; the last sentence is about all joints together.

    That one compares with other software, so it is left out for a first calibration.
    """
    if not stored.zeros:
        return ()  # a machine does not report them
    explained = zero_report.explain_stored(stored)
    guessed = [meaning.sentence for meaning in explained[:-1] if meaning.by == "middle"]
    return (*guessed,) if is_first else (*guessed, explained[-1].sentence)
