"""Keep track of the workflow under way and its current step, without viser.

Both are saved at each step, so that the setup can be resumed after a crash.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from so101_motion.calib.motors.progress import SetupProgress
from so101_motion.setup.setup_steps import MOTORS, TEST, WORKFLOWS, SetupState, SetupStep, Workflow

Place = Literal["done", "passed over", "now", "left"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StepRow:
    """A line in the list of steps."""

    title: str
    place: Place  # whether it is done, passed over, on the page, or still to come
    minutes: int


class StepWizard:
    """Goes from step to step.

    Attributes:
        workflow: What is under way; None while nothing is chosen.
    """

    def __init__(self, progress: SetupProgress) -> None:
        self._progress = progress
        self.workflow: Workflow | None = None
        self.place = 0

    @property
    def step(self) -> SetupStep | None:
        return None if self.workflow is None else self.workflow.steps[self.place]

    @property
    def is_last(self) -> bool:
        return self.workflow is not None and self.place == len(self.workflow.steps) - 1

    def rows(self, known: SetupState) -> tuple[StepRow, ...]:
        if self.workflow is None:
            return ()
        return tuple(
            StepRow(title=step.title, minutes=step.minutes, place=self._place(k, step, known))
            for k, step in enumerate(self.workflow.steps)
        )

    def _place(self, k: int, step: SetupStep, known: SetupState) -> Place:
        if k >= self.place:
            return "now" if k == self.place else "left"
        # All other steps must be done before Next is enabled.
        verdict = step.check(known).verdict if step in (MOTORS, TEST) else "ok"
        is_left_out = verdict == "warn" or (step is TEST and verdict == "fail")
        return "passed over" if is_left_out else "done"

    @property
    def where(self) -> str:
        if self.workflow is None:
            return ""
        left = sum(step.minutes for step in self.workflow.steps[self.place :])
        return f"Step {self.place + 1} of {len(self.workflow.steps)}, about {left} min left"

    @property
    def interrupted(self) -> SetupStep | None:
        found = self._interrupted()
        return None if found is None else found[0].steps[found[1]]

    def resume(self) -> None:
        found = self._interrupted()
        if found is not None:
            self.workflow, self.place = found

    def choose(self, workflow: Workflow) -> None:
        self.workflow, self.place = workflow, 0
        self._keep()

    def go_on(self) -> None:
        if self.is_last:
            self.end()
        elif self.workflow is not None:
            self.place += 1
            self._keep()

    def go_back(self) -> None:
        if self.place == 0:
            self.end()
        else:
            self.place -= 1
            self._keep()

    def end(self) -> None:
        """End the workflow; remembers which motors have their ids until all do."""
        self.workflow, self.place = None, 0
        self._progress.reach("", "")

    def _interrupted(self) -> tuple[Workflow, int] | None:
        for workflow in WORKFLOWS:
            place = workflow.place(self._progress.step)
            if workflow.name == self._progress.workflow and place is not None:
                return workflow, place
        return None

    def _keep(self) -> None:
        if self.workflow is not None and self.step is not None:
            self._progress.reach(self.workflow.name, self.step.name)
