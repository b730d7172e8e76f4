"""What a step's page is.

A page shows one step of ``so101_motion.workflow`` and lets people do it. It never waits: what talks
to motors runs beside it, and ``refresh`` sees what has come of it. All pages work for every browser
at once and keep nothing in the browser, so a reload loses nothing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import viser

from so101_motion.checkup import Check
from so101_motion.workflow import Step

from . import calibrating
from .bench import Bench
from .watch import Watch
from .workshop import Workshop

T = TypeVar("T")


class StepPage(ABC):
    """The page of one step. All of it but ``abort`` is called from the page's thread.

    Args:
        shop: What all pages share.
        step: Which step it is.
    """

    def __init__(self, shop: Workshop, step: Step) -> None:
        self._shop, self._step = shop, step

    @abstractmethod
    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets, once, where the caller has put the cursor."""

    @abstractmethod
    def enter(self) -> None:
        """The step begins, or is come back to: set the picture up, begin to look."""

    def leave(self) -> None:  # noqa: B027  # most have nothing to end
        """Another step begins; nothing of this one may go on."""

    @abstractmethod
    def refresh(self) -> bool:
        """Take note of what happened since the last call; whether there is news to show."""

    @abstractmethod
    def show(self) -> None:
        """Bring the widgets and the picture up to date."""

    def check(self) -> Check:
        """How far the step is; the workflow's own check of what is known."""
        return self._step.check(self._shop.known)

    def can_go_on(self) -> str | None:
        """Why one cannot go on yet, as a sentence; None if one can."""
        check = self.check()
        return check.sentence if check.verdict == "fail" else None

    def abort(self) -> str:
        """End what was begun, in a worker's thread; what that has come to, in words.

        Whoever goes back from a calibration and aborts there has it put back as well.

        Raises:
            So101Error: It cannot be ended now; the message says what to do.
        """
        bench = self._shop.bench
        if bench is None or not calibrating.is_under_way(bench.calibrator):
            return self._as_it_was()
        return calibrating.put_back(bench.calibrator)

    @abstractmethod
    def _as_it_was(self) -> str:
        """How the arm is left, in words, when no calibration is under way."""

    def _do(
        self,
        doing: str,
        call: Callable[[Bench], T],
        then: Callable[[T], None] = lambda _result: None,
    ) -> bool:
        """Do something with the bench, see ``Workshop.do``; whether it is done, not without one."""
        bench = self._shop.bench
        return bench is not None and self._shop.do(doing, partial(call, bench), then)


class CalibrationPage(StepPage):
    """The page of a step that looks at the arm all the time while it is calibrated."""

    def __init__(self, shop: Workshop, step: Step) -> None:
        super().__init__(shop, step)
        self._watch = Watch(shop)

    def refresh(self) -> bool:
        """Look at the arm."""
        return self._watch.refresh()

    def _as_it_was(self) -> str:
        bench = self._shop.bench
        return "nothing was changed" if bench is None else calibrating.untouched(bench.calibrator)
