"""The page that verifies all six motors on one cable.

The grid shows which motor is wrong, why, and what to do; the button verifies again.
"""

from __future__ import annotations

from dataclasses import replace

import viser

from so101_motion.calib.motors.setup_view import Verification
from so101_motion.setup.setup_steps import CHAIN

from . import cards
from .page import StepPage
from .picture import GREEN, ORANGE
from .setup_context import SetupContext


class ChainPage(StepPage):
    """The page of the chain step."""

    def __init__(self, setup: SetupContext) -> None:
        super().__init__(setup, CHAIN)
        self._shown: Verification | None = None

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        gui.add_html(cards.instruction(CHAIN.title, CHAIN.instruction))
        self._verify = gui.add_button("Verify all six", icon=viser.Icon.LIST_CHECK, color="green")
        self._grid = gui.add_html("")
        self._status = gui.add_html("")
        self._setup.context.on_press(self._verify, self._look)

    def enter(self) -> None:
        """Verify at once, which writes nothing; not while the chain is still to be made."""
        self._shown = None
        target = self._setup.target
        one_by_one = target is not None and target.calibrator.motor_setup.view.next_joint is None
        if not self._is_calibrating and (self._setup.seen.servos is not None or not one_by_one):
            self._look()

    def refresh(self) -> bool:
        """Return whether a verification has ended."""
        found, before = self._setup.seen.servos, self._shown
        self._shown = found
        return found is not before

    def show(self) -> None:
        """Show the result, and highlight motors with problems."""
        found = self._setup.seen.servos
        self._verify.label = "Verify all six" if found is None else "Verify again"
        self._verify.disabled = bool(self._setup.doing) or self._is_calibrating
        self._grid.content = "" if found is None else cards.grid(found)
        is_shown_above = found is not None and any(check.error for check in found.motors.values())
        is_open = found is None or is_shown_above or bool(self._setup.doing)
        self._status.content = "" if is_open else cards.check_text(self.check())
        if self._is_calibrating:
            self._status.content = cards.note("The calibration is under way: press Next.")
        if found is not None:
            wrong = tuple(joint for joint, check in found.motors.items() if check.status != "ok")
            lit, colour = (wrong, ORANGE) if wrong else (tuple(found.motors), GREEN)
            self._setup.picture.light(lit, colour)

    def can_go_on(self) -> str | None:
        """Why the chain is not ready; the details stand above."""
        if self.check().verdict != "fail" or self._is_calibrating:
            return None
        is_first = self._setup.seen.servos is None
        return "verify them first" if is_first else "verify again once fixed"

    def _as_it_was(self) -> str:
        return "nothing was changed, and nothing was moved"

    @property
    def _is_calibrating(self) -> bool:
        """Whether a calibration is under way, which uses the motors."""
        target = self._setup.target
        return target is not None and target.calibrator.is_under_way

    def _look(self) -> None:
        self._do(
            "looking at all six motors",
            lambda target: target.calibrator.motor_setup.verify(),
            self._take,
        )

    def _take(self, found: Verification) -> None:
        self._setup.seen = replace(self._setup.seen, servos=found)
