"""The base class of a step's page.

A page shows one step of ``so101_motion.setup.setup_steps`` and lets people do it. It never waits:
calls to motors run on a worker thread, and ``refresh`` takes in the result. All pages work for
every browser at once and keep nothing in the browser, so a reload loses nothing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import viser

from so101_motion.setup.checkup import Check
from so101_motion.setup.setup_steps import SetupStep

from .setup_context import SetupContext
from .setup_target import SetupTarget

T = TypeVar("T")


class StepPage(ABC):
    """The page of one step. All methods but ``abort`` run on the page's thread.

    Args:
        setup: What all pages share.
    """

    def __init__(self, setup: SetupContext, step: SetupStep) -> None:
        self._setup, self._step = setup, step

    @abstractmethod
    def build(self, gui: viser.GuiApi) -> None:
        """Make the widgets, once, where the caller has put the cursor."""

    @abstractmethod
    def enter(self) -> None:
        """Start the step, also when it is entered again: set up the picture, start looking."""

    def leave(self) -> None:  # noqa: B027  # most pages have nothing to end
        """Leave the step; nothing of it may continue."""

    @abstractmethod
    def refresh(self) -> bool:
        """Take in changes since the last call; return whether there is anything new to show."""

    @abstractmethod
    def show(self) -> None:
        """Update widgets and picture."""

    def check(self) -> Check:
        """The workflow's own check of this step."""
        return self._step.check(self._setup.known)

    def can_go_on(self) -> str | None:
        """Why Next is not allowed yet, as a sentence; None if it is."""
        check = self.check()
        return check.sentence if check.verdict == "fail" else None

    def next_label(self) -> str:
        """What Next says, unless the setup ends with it."""
        return "Next"

    def is_next_due(self) -> bool:
        """Whether Next is what to press now; else it is grey, though it may be pressed."""
        return True

    def abort(self) -> str:
        """Abort what was started, on a worker thread; return the result in words.

        Aborting on an earlier page restores the motors as well while a calibration is under way.

        Raises:
            So101Error: It cannot be ended now; the message says what to do.
        """
        target = self._setup.target
        if target is None or not target.is_under_way:
            return self._as_it_was()
        return str(target.calibration.ask("abort")["message"]).rstrip(".")

    @abstractmethod
    def _as_it_was(self) -> str:
        """How the arm is left when no calibration is under way, in words."""

    def _do(
        self,
        doing: str,
        call: Callable[[SetupTarget], T],
        then: Callable[[T], None] = lambda _result: None,
    ) -> bool:
        """Start ``SetupContext.do``; return whether it has started."""
        target = self._setup.target
        return target is not None and self._setup.do(doing, partial(call, target), then)
