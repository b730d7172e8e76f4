"""The step after the motors have their ids: all six on one cable, verified.

A verification that finds something wrong is a result like any other: the grid shows which motor it
is, why, and what to do, and the button verifies again.
"""

from __future__ import annotations

from dataclasses import replace

import viser

from so101_motion.calib.setup_view import Verification
from so101_motion.workflow import CHAIN

from . import calibrating, cards
from .page import StepPage
from .picture import GREEN, ORANGE
from .workshop import Workshop


class ChainPage(StepPage):
    """The page of the third step.

    Args:
        shop: What all pages share.
    """

    def __init__(self, shop: Workshop) -> None:
        super().__init__(shop, CHAIN)
        self._shown: Verification | None = None

    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets."""
        gui.add_html(cards.instruction(CHAIN.title, CHAIN.instruction))
        self._verify = gui.add_button("Verify all six", icon=viser.Icon.LIST_CHECK, color="green")
        self._grid = gui.add_html("")
        self._said = gui.add_html("")
        self._shop.desk.on_press(self._verify, self._look)

    def enter(self) -> None:
        """Look at once, for nothing is written; not when the chain is still to be made."""
        self._shown = None
        bench = self._shop.bench
        one_by_one = bench is not None and bench.calibrator.motor_setup.view.next_joint is None
        if not self._is_calibrating and (self._shop.seen.servos is not None or not one_by_one):
            self._look()

    def refresh(self) -> bool:
        """Whether something else was found."""
        found, before = self._shop.seen.servos, self._shown
        self._shown = found
        return found is not before

    def show(self) -> None:
        """Tell what was found, and light the motors that are not as they must be."""
        found = self._shop.seen.servos
        self._verify.label = "Verify all six" if found is None else "Verify again"
        self._verify.disabled = bool(self._shop.doing) or self._is_calibrating
        self._grid.content = "" if found is None else cards.grid(found)
        is_told = found is not None and any(check.error for check in found.motors.values())
        is_open = found is None or is_told or bool(self._shop.doing)
        self._said.content = "" if is_open else cards.said(self.check())
        if self._is_calibrating:
            self._said.content = cards.note("The calibration is under way: press Next.")
        if found is not None:
            wrong = tuple(joint for joint, check in found.motors.items() if check.status != "ok")
            lit, colour = (wrong, ORANGE) if wrong else (tuple(found.motors), GREEN)
            self._shop.picture.light(lit, colour)

    def can_go_on(self) -> str | None:
        """That something is wrong with the chain; what it is stands above."""
        if self.check().verdict != "fail" or self._is_calibrating:
            return None
        is_first = self._shop.seen.servos is None
        return "verify them first" if is_first else "verify them once all is mended"

    def _as_it_was(self) -> str:
        return "nothing was changed, and nothing was moved"

    @property
    def _is_calibrating(self) -> bool:
        """Whether somebody has come back from a calibration, which has the motors to itself."""
        bench = self._shop.bench
        return bench is not None and calibrating.is_under_way(bench.calibrator)

    def _look(self) -> None:
        self._do(
            "looking at all six motors",
            lambda bench: bench.calibrator.motor_setup.verify(),
            self._take,
        )

    def _take(self, found: Verification) -> None:
        self._shop.seen = replace(self._shop.seen, servos=found)
