"""What all pages of the setup share: the arm, what is known of it, and one worker thread.

A page never waits: calls to motors run on the worker (``SetupContext.do``), one at a time, and the
page's own thread collects the result.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from so101_motion.calib.motors.progress import SetupProgress
from so101_motion.calib.record.record import Calibration
from so101_motion.common.errors import So101Error
from so101_motion.setup.checkup import Check
from so101_motion.setup.findings import Findings
from so101_motion.setup.setup_steps import SetupState

from ..page.page_context import PageContext
from ..server.host import ServedPage
from .picture import Picture
from .setup_target import FixedArm, SetupTarget
from .torque import TorqueWatch

T = TypeVar("T")

log = logging.getLogger(__name__)


ServesPreview = Callable[..., ServedPage]
"""Serves a preview of an arm: ``so101_viewer.serve``."""


@dataclass(slots=True)
class SetupContext:
    """What all pages share. Its fields belong to the page's thread.

    Attributes:
        context: The page; presses go through it.
        fixed: The arm, if it is known already; None if a port is to be chosen.
        preview: Serves a preview of the arm; None where the page shows the arm already.
        make: Makes the target, on the worker thread; set by the page of the connection.
        target: The arm that is set up; None until the connection is made.
        seen: What was found on the port, and about the motors of the finished chain.
        before: The calibration before the one under way, as far as it is known.
        saved: Where this setup has saved a calibration; None before.
        tested: What the final test has found; None before.
        opened: What else was opened, to be closed with the setup.
        doing: What runs on the worker now, in words; empty when nothing does.
        trouble: Why the last run failed; None if it did not.
    """

    context: PageContext
    picture: Picture
    progress: SetupProgress
    fixed: FixedArm | None = None
    preview: ServesPreview | None = None
    make: Callable[[], SetupTarget] | None = None
    target: SetupTarget | None = None
    seen: Findings = field(default_factory=Findings)
    before: Calibration = field(default_factory=dict)
    saved: Path | None = None
    tested: Check | None = None
    opened: ExitStack = field(default_factory=ExitStack)
    doing: str = ""
    trouble: Exception | None = None
    torque: TorqueWatch = field(default_factory=TorqueWatch)
    _workers: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(1, thread_name_prefix="so101-setup")
    )
    _job: tuple[Future[Any], Callable[[Any], None]] | None = None
    _look: tuple[Future[object], Callable[[], None]] | None = None

    @property
    def known(self) -> SetupState:
        """The state that the steps judge."""
        if self.target is None:
            return SetupState(seen=self.seen, saved=self.saved, tested=self.tested)
        calibrator = self.target.calibrator
        return SetupState(
            seen=self.seen,
            setup=calibrator.motor_setup.view,
            view=calibrator.situation.view,
            saved=self.saved,
            tested=self.tested,
        )

    def do(
        self,
        doing: str,
        call: Callable[[], T],
        then: Callable[[T], None] = lambda _result: None,
    ) -> bool:
        """Run ``call`` on the worker thread, unless it is busy.

        Args:
            doing: What that is, for people, such as ``"looking for the motor"``.
            call: What to run.
            then: Takes the result, on the page's thread. After an error there is none; the error
                is in ``trouble``.

        Returns:
            Whether it runs.
        """
        if self._job is not None:
            return False
        self.doing, self.trouble = doing, None
        self._job = (self._workers.submit(call), then)
        return True

    def watch(self, look: Callable[[], object], then: Callable[[], None]) -> None:
        """Look at something on the worker thread, unless it is busy.

        Nobody waits for it, and errors are ignored: it is called again soon.

        Args:
            look: What looks.
            then: Called on the page's thread when it has looked, or failed.
        """
        if self._job is None and self._look is None:
            self._look = (self._workers.submit(look), then)

    @property
    def is_looking(self) -> bool:
        """Whether the worker is looking at the cable, see ``watch``."""
        return self._look is not None

    def collect(self) -> bool:
        """Take in results of the worker thread; return whether there were any."""
        if self._look is not None and self._look[0].done():
            (looked, then_look), self._look = self._look, None
            error = looked.exception()
            if error is not None and not isinstance(error, So101Error):
                log.error("the setup could not look", exc_info=error)
            then_look()
        return self._collect_job()

    def _collect_job(self) -> bool:
        if self._job is None or not self._job[0].done():
            return False
        (future, then), self._job, self.doing = self._job, None, ""
        error = future.exception()
        if error is None:
            then(future.result())
            return True
        if not isinstance(error, So101Error):
            log.error("a step of the setup failed", exc_info=error)
        assert isinstance(error, Exception)
        self.trouble = error
        return True

    def work_on(self, target: SetupTarget) -> None:
        """Set a new target; forgets the progress with another arm."""
        self.target = target
        self.progress.work_on(target.where)
        target.calibrator.motor_setup.recall(self.progress.done)

    def put_away(self) -> None:
        """Close the target, because no step needs it any more."""
        target, self.target = self.target, None
        self.seen, self.saved, self.tested = Findings(), None, None
        if target is not None:
            self._workers.submit(target.calibrator.close)

    def close(self) -> None:
        """Close the target, and wait for the worker."""
        self.opened.close()
        self.put_away()
        self._workers.shutdown(wait=True)
