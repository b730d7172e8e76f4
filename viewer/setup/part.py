"""The tab of the setup: choose a workflow, go through its steps, leave it safely.

The step is saved, so that a setup can be resumed after a crash. Abort is there at every step; it
ends what the step has begun and says how it has left the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from html import escape
from pathlib import Path
from typing import Literal

import viser

from so101_motion.calib.motors.setup_view import PROGRESS_FILE, SETUP_ORDER, SetupProgress
from so101_motion.files import user_storage
from so101_motion.setup.setup_steps import (
    ASSEMBLY,
    CONNECT,
    MOTORS,
    MOTORS_ONLY,
    POSE,
    RECORD,
    SAVE,
    TEST,
    WORKFLOWS,
    SetupState,
    SetupStep,
    Workflow,
)

from ..page import cards, markup
from ..page.page_context import PageContext, Part
from ..page.screen_state import Tone
from ..page.shared_fields import AskingButton
from ..page.texts import capital, ended
from .page import (
    CalibrationPage,
    ChainPage,
    ConfigurePage,
    ConnectionPage,
    FinalTestPage,
    StepPage,
)
from .picture import Picture
from .setup_context import ArmSource, ServesPreview, SetupContext, SetupTarget

Place = Literal["done", "passed over", "now", "left"]  # of a step in the list of all

_MARKS = {"done": "✓", "passed over": "!"}


def step_list(rows: Iterable[tuple[SetupStep, Place]]) -> str:
    steps = (
        f'<span title="{step.minutes} min" class="{place}">'
        f"{_MARKS.get(place, number)} {escape(step.title)}</span>"
        for number, (step, place) in enumerate(rows, start=1)
    )
    return f'<div class="so101-steplist">{"".join(steps)}</div>'


class StepWizard:
    """Goes from step to step. The step is kept on disk, so that a later start continues there."""

    def __init__(self, progress: SetupProgress) -> None:
        self._progress = progress

    @property
    def workflow(self) -> Workflow | None:
        kept = self._progress
        named = (workflow for workflow in WORKFLOWS if workflow.name == kept.workflow)
        return next((each for each in named if each.place(kept.step) is not None), None)

    @property
    def place(self) -> int:
        return (self.workflow and self.workflow.place(self._progress.step)) or 0

    @property
    def step(self) -> SetupStep | None:
        return None if self.workflow is None else self.workflow.steps[self.place]

    @property
    def is_last(self) -> bool:
        return self.workflow is not None and self.place == len(self.workflow.steps) - 1

    def rows(self, known: SetupState, *, waits: bool = False) -> list[tuple[SetupStep, Place]]:
        """The steps, and which are done, passed over, on the page, or still to come.

        While the setup ``waits`` for a connection, that step is on the page.
        """
        steps = () if self.workflow is None else self.workflow.steps
        now = 0 if waits else self.place
        return [
            (step, "now" if k == now else self._place(k, step, known))
            for k, step in enumerate(steps)
        ]

    def _place(self, k: int, step: SetupStep, known: SetupState) -> Place:
        if k >= self.place:
            return "left"
        # All other steps must be done before Next is enabled.
        verdict = step.check(known).verdict if step in (MOTORS, ASSEMBLY, TEST) else "ok"
        is_left_out = verdict == "warn" or (step is TEST and verdict == "fail")
        return "passed over" if is_left_out else "done"

    @property
    def where(self) -> str:
        if self.workflow is None:
            return ""
        left = sum(step.minutes for step in self.workflow.steps[self.place :])
        return f"Step {self.place + 1} of {len(self.workflow.steps)}, about {left} min left"

    def choose(self, workflow: Workflow) -> None:
        self._progress.reach(workflow.name, workflow.steps[0].name)

    def turn(self, by: int) -> None:
        """Go on by 1, or back by -1; before the first step and after the last the workflow ends."""
        workflow, place = self.workflow, self.place + by
        if workflow is None or not 0 <= place < len(workflow.steps):
            self.end()
        else:
            self._progress.reach(workflow.name, workflow.steps[place].name)

    def end(self) -> None:
        """End the workflow; remembers which motors have their ids until all do."""
        self._progress.reach("", "")


TITLE = "Setup"

_ABORT, _SURE = "Abort the setup", "Press again to abort"

_MOTORS_LEFT = "nothing moved; motors that got their ids keep them, the others are unchanged"
_MOTORS_DONE = "All done. Screw the arm together, then choose Calibration Only."


class SetupPart(Part):
    """The Setup tab.

    Args:
        progress_file: Keeps the progress, by default the terminal's file.
        on_stage: Shows or hides the preview's own arm; hidden while the Setup tab is in front and
            its step draws a picture.
        preview: Serves a preview of the finished arm; None where the page shows the arm already.
    """

    def __init__(
        self,
        context: PageContext,
        *,
        source: ArmSource,
        progress_file: Path | None = None,
        on_stage: Callable[[bool], None] = lambda _shown: None,
        preview: ServesPreview | None = None,
    ) -> None:
        self._is_alone = preview is not None  # else the page shows the arm
        picture = Picture(context.server.scene, on_stage)
        kept = progress_file or user_storage.folder() / PROGRESS_FILE
        progress = SetupProgress(kept, source.where)
        self.setup = SetupContext(
            context=context, picture=picture, progress=progress, preview=preview
        )
        self.wizard = StepWizard(progress)
        self._connection = ConnectionPage(self.setup, source)
        self._pages: dict[str, StepPage] = {  # by the step's name
            "connect": self._connection,
            "motors": StepPage(self.setup, MOTORS, lambda target: target.motors, _MOTORS_LEFT),
            "chain": ChainPage(self.setup),
            "assembly": StepPage(
                self.setup, ASSEMBLY, lambda target: target.assembly, skip="Skip the check"
            ),
            "pose": CalibrationPage(self.setup, POSE),
            "record": CalibrationPage(self.setup, RECORD),
            "save": CalibrationPage(self.setup, SAVE),
            "test": FinalTestPage(self.setup),
            "configure": ConfigurePage(self.setup),
        }
        self._current: StepPage | None = None
        self._outcome, self._wrong = "", ""
        with context.tabs.add_tab(TITLE, viser.Icon.TOOL):
            self._build(context.gui)
        self._turn_to_step()

    # The widgets

    def _build(self, gui: viser.GuiApi) -> None:
        button = self.setup.context.button
        self._head = gui.add_html("")
        self._alarm = gui.add_html("")
        self._steps = gui.add_html("")
        self._choice = gui.add_folder(None)
        with self._choice:
            for workflow in WORKFLOWS:
                purpose, extent = escape(workflow.purpose), escape(workflow.extent)
                gui.add_html(f'<div class="so101-choice">{purpose}<small>{extent}</small></div>')
                choose = partial(self._choose, workflow)
                color = None if workflow is WORKFLOWS[0] else "gray"
                button(workflow.title, choose, icon=viser.Icon.ARROW_RIGHT, color=color)
        self._folders: dict[str, viser.GuiFolderHandle] = {}
        for name, page in self._pages.items():
            self._folders[name] = gui.add_folder(None, visible=False)
            with self._folders[name]:
                page.build(gui)
        self._buttons = gui.add_folder(None)
        with self._buttons:
            self._why_not = gui.add_html("")
            self._next = button("Next", self._go_on, icon=viser.Icon.ARROW_RIGHT)
            self._back = button("Back", self._go_back, icon=viser.Icon.ARROW_LEFT, color="gray")
            self._abort = AskingButton(
                self.setup.context, _ABORT, _SURE, self._give_up, viser.Icon.X
            )

    # What the buttons do

    def _choose(self, workflow: Workflow) -> None:
        self._outcome = ""
        if len(self.setup.progress.done) == len(SETUP_ORDER):
            self.setup.progress.clear()  # that kit is done; this is another
        self.wizard.choose(workflow)
        self._turn_to_step()

    def _go_on(self) -> None:
        if self._reason() is not None:
            return
        if self.setup.target is None:
            self._connect()
        else:
            done, workflow = self.wizard.is_last, self.wizard.workflow
            self.wizard.turn(1)
            self._turn_to_step()
            if done:
                self._outcome = _MOTORS_DONE if workflow is MOTORS_ONLY else "All done."
                self.setup.progress.clear()

    def _go_back(self) -> None:
        if not self.setup.doing:
            self.wizard.turn(-1)
            if self.wizard.place == 0:
                self.setup.put_away()  # another port may be chosen
            self._turn_to_step()

    def _give_up(self) -> None:
        page = self._current
        if page is None or self.setup.doing:
            return

        def ended(sentence: str) -> None:
            self.wizard.end()
            self._turn_to_step()
            self._outcome = f"Aborted: {sentence}."

        self.setup.do("aborting", page.abort, ended)

    def _turn_to_step(self) -> None:
        if self._current is not None:
            self._current.leave()
        self._next.disabled = True  # until the step allows it
        step = self.wizard.step
        page = "" if step is None else CONNECT.name if self.setup.target is None else step.name
        for folder in self._folders.values():
            folder.visible = False
        self._choice.visible, self._buttons.visible = step is None, step is not None
        self._current = self._pages.get(page)
        self.setup.trouble = None
        self.setup.picture.rest()
        self._take_stage()
        if self._current is None:
            self.setup.put_away()
        else:
            self._current.enter()
            self._current.refresh()
            self._current.show()  # before it is seen: it may have been left in another state
            self._folders[page].visible = True

    def _take_stage(self) -> None:
        is_seen = self.setup.context.front.name == TITLE and self.setup.picture.is_drawn
        self.setup.picture.take_stage(is_seen or self._is_alone)

    def _connect(self) -> None:
        def made(target: SetupTarget) -> None:
            self.setup.work_on(target)
            if self.wizard.place == 0:
                self.wizard.turn(1)
            self._turn_to_step()

        self.setup.do("connecting", self._connection.open, made)

    def _reason(self) -> str | None:
        if self._current is None or self.setup.doing:
            return self.setup.doing or "nothing is chosen"
        return self._current.can_go_on()

    # A part of the page

    def refresh(self) -> bool:
        ended = self.setup.collect()
        target, is_blind = self.setup.target, self.setup.is_looking or self.setup.doing != ""
        torque = self.setup.torque.look(target, is_blind=is_blind)
        if target is not None and target.is_under_way:  # to calibrate is what the tab says
            self.setup.context.bar.state = torque
        news = self._current is not None and self._current.refresh()
        asked = self._abort.refresh()
        before, self._wrong = self._wrong, self._look_for_alarm()
        self._take_stage()
        return ended or news or asked or self._wrong != before

    def _look_for_alarm(self) -> str:
        """The worst alarm of the bar, unless the step says itself what is wrong."""
        worst = next(iter(self.setup.context.bar.alerts), None)
        operation = None if self._current is None else self._current.operation
        is_said = operation is not None and operation.view.trouble != ""
        return "" if worst is None or worst.tone is not Tone.BAD or is_said else worst.text

    def show(self) -> None:
        self._alarm.content = cards.failed(self._wrong) if self._wrong else ""
        wizard, step = self.wizard, self.wizard.step
        if wizard.workflow is None or step is None or self._current is None:
            about = self._outcome or "From a box of parts to a moving arm. What do you need?"
            self._head.content = markup.headline("Set up an arm", about, is_under_way=False)
            self._steps.content = ""
            return
        waits = self.setup.target is None and wizard.place > 0
        about = f"{wizard.where}, once the arm is connected again" if waits else wizard.where
        self._head.content = markup.headline(wizard.workflow.title, about, is_under_way=True)
        self._steps.content = step_list(wizard.rows(self.setup.known, waits=waits))
        reason = self._reason()
        ends = wizard.is_last and not waits
        self._next.label = "Finish" if ends else self._current.next_label()
        self._next.color = None if self._current.is_next_due() else "gray"
        self._next.disabled = reason is not None
        self._back.disabled = bool(self.setup.doing)
        self._abort.show(can=not self.setup.doing)
        self._why_not.content = self._words(reason)
        self._current.show()

    def _words(self, reason: str | None) -> str:
        if self.setup.doing:
            return cards.going_on(self.setup.doing)
        if self.setup.trouble is not None:
            return cards.failed(ended(self.setup.trouble).text)
        operation = None if self._current is None else self._current.operation
        is_told = operation is not None and not all(o.is_look for o in operation.view.offers)
        if reason is None or is_told or (operation is not None and operation.view.trouble):
            return ""  # a button above, or what is in red, tells what to do first
        return cards.note(f"{self._next.label}: {capital(reason)}")

    def close(self) -> None:
        """Leave the step and close the arm; the progress stays on disk."""
        if self._current is not None:
            self._current.leave()
        self.setup.close()
