"""The setup as a part of the page: choose a workflow, go through its steps, leave it safely.

It is docked beside the arm and never covers Stop. One step's page is seen at a time. Next is
pressed by people and allowed by the state of the arm alone. Abort is there at every step; it ends
what the step has begun and says how it has left the arm.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import viser

from so101_motion.adapters import own_folder
from so101_motion.calib.progress import NAME, Progress
from so101_motion.errors import So101Error
from so101_motion.workflow import CONNECT, MOTORS_ONLY, WORKFLOWS, Workflow

from ..desk import Counter, Desk
from . import cards
from .bench import Bench
from .benches import Given, Ports, given
from .course import Course
from .page import StepPage
from .pages import make_pages
from .picture import Picture
from .workshop import Workshop

TITLE = "Setup"

_MOTORS_DONE = "All done. Screw the arm together, then choose Calibration Only."


class SetupPart:
    """The tab with the setup.

    Args:
        desk: Where it works.
        progress: What is kept of it on disk.
        on_stage: Told whether the preview's own arm has the stage, while no setup is under way.
        ports: Where the arm may be.
        fixed: The arm, if that is not to be chosen.
        resumes: Whether an earlier setup goes on by itself, else it is offered.
    """

    def __init__(
        self,
        desk: Counter,
        *,
        progress: Progress,
        on_stage: Callable[[bool], None] = lambda _shown: None,
        ports: Ports,
        fixed: Given | None = None,
        resumes: bool = False,
    ) -> None:
        self._is_alone = not isinstance(desk, Desk)  # else the preview's own arm is to be seen
        picture = Picture(desk.server.scene, on_stage)
        self.shop = Workshop(desk=desk, picture=picture, progress=progress, fixed=fixed)
        self.course = Course(progress)
        self._pages = make_pages(self.shop, ports)
        self._current: StepPage | None = None
        self._left_behind = ""
        self._is_stale = True
        with desk.tabs.add_tab(TITLE, viser.Icon.TOOL):
            self._build(desk.gui)
        if resumes:
            self.course.resume()
        self._turn_to_step()

    # The widgets

    def _build(self, gui: viser.GuiApi) -> None:
        self._head = gui.add_html("")
        self._torque = gui.add_html("")
        self._steps = gui.add_html("")
        self._choice = gui.add_folder(None)
        with self._choice:
            self._resume = gui.add_button("", icon=viser.Icon.PLAYER_PLAY, color="green")
            self.shop.desk.on_press(self._resume, self._go_on_with_earlier)
            for workflow in WORKFLOWS:
                gui.add_html(cards.choice(workflow))
                button = gui.add_button(workflow.title, icon=viser.Icon.ARROW_RIGHT)
                self.shop.desk.on_press(button, partial(self._choose, workflow))
        self._folders: dict[str, viser.GuiFolderHandle] = {}
        for name, page in self._pages.items():
            self._folders[name] = gui.add_folder(None, visible=False)
            with self._folders[name]:
                page.build(gui)
        self._ways = gui.add_folder(None)
        with self._ways:
            self._why_not = gui.add_html("")
            self._next = gui.add_button("Next", icon=viser.Icon.ARROW_RIGHT)
            self._back = gui.add_button("Back", icon=viser.Icon.ARROW_LEFT, color="gray")
            self._abort = gui.add_button("Abort the setup", icon=viser.Icon.X, color="red")
        on_press = self.shop.desk.on_press
        on_press(self._next, self._go_on)
        on_press(self._back, self._go_back)
        on_press(self._abort, self._give_up)

    # What the buttons do

    def _choose(self, workflow: Workflow) -> None:
        self._left_behind = ""
        self.course.choose(workflow)
        self._turn_to_step()

    def _go_on_with_earlier(self) -> None:
        self.course.resume()
        self._turn_to_step()

    def _go_on(self) -> None:
        if self._reason() is not None:
            return
        if self.shop.bench is None:
            self._connect()
        else:
            done, workflow = self.course.is_last, self.course.workflow
            self.course.go_on()
            self._turn_to_step()
            if done:
                self._left_behind = _MOTORS_DONE if workflow is MOTORS_ONLY else "All done."
                self.shop.progress.clear()

    def _go_back(self) -> None:
        if not self.shop.doing:
            self.course.go_back()
            if self.course.place == 0:
                self.shop.put_away()  # another port may be chosen
            self._turn_to_step()

    def _give_up(self) -> None:
        page = self._current
        if page is None or self.shop.doing:
            return

        def ended(sentence: str) -> None:
            self.course.end()
            self._turn_to_step()
            self._left_behind = f"Aborted: {sentence}."

        self.shop.do("aborting", page.abort, ended)

    def _turn_to_step(self) -> None:
        if self._current is not None:
            self._current.leave()
        self._is_stale = True
        self._next.disabled = True  # until it is known that one can go on
        step = self.course.step
        page = "" if step is None else CONNECT.name if self.shop.bench is None else step.name
        for name, folder in self._folders.items():
            folder.visible = name == page
        self._choice.visible, self._ways.visible = step is None, step is not None
        self._current = self._pages.get(page)
        self.shop.trouble = None
        self.shop.picture.take_stage(step is not None or self._is_alone)
        self.shop.picture.rest()
        if self._current is None:
            self.shop.put_away()
        else:
            self._current.enter()

    def _connect(self) -> None:
        """The step is known, the arm is not yet: open it, then show the step."""
        make = self.shop.make
        assert make is not None  # the first step's page has said how

        def made(bench: Bench) -> None:
            self.shop.work_on(bench)
            if self.course.place == 0:
                self.course.go_on()
            self._turn_to_step()

        self.shop.do("connecting", make, made)

    def _reason(self) -> str | None:
        """Why Next cannot be pressed."""
        if self._current is None or self.shop.doing:
            return self.shop.doing or "nothing is chosen"
        return self._current.can_go_on()

    # A part of the page

    def refresh(self) -> bool:
        """Let the step look; whether there is news."""
        is_stale, self._is_stale = self._is_stale, False
        ended = self.shop.collect()
        torque = self.shop.torque.look(self.shop.bench, is_blind=self.shop.is_looking)
        news = self._current is not None and self._current.refresh()
        return is_stale or ended or torque or news

    def show(self) -> None:
        """Bring the tab and the picture up to date."""
        course, step = self.course, self.course.step
        if course.workflow is None or step is None or self._current is None:
            about = self._left_behind or "From a box of parts to a moving arm. What do you need?"
            self._head.content = cards.headline("Set up an arm", about)
            earlier = course.interrupted
            self._resume.visible = earlier is not None
            self._resume.label = "" if earlier is None else f"Go on with: {earlier.title}"
            self._steps.content = self._torque.content = ""
            return
        waits = self.shop.bench is None and course.place > 0
        about = f"{course.where}, once the arm is connected again" if waits else course.where
        self._head.content = cards.headline(course.workflow.title, about)
        self._steps.content = cards.step_list(course.rows(self.shop.known))
        self._torque.content = cards.torque(self.shop.torque.told)
        reason = self._reason()
        self._next.label = "Finish" if course.is_last else "Next"
        self._next.disabled = reason is not None
        self._back.disabled = self._abort.disabled = bool(self.shop.doing)
        self._why_not.content = self._words(reason)
        self._current.show()

    def _words(self, reason: str | None) -> str:
        trouble = self.shop.trouble
        if self.shop.doing:
            return cards.going_on(self.shop.doing)
        if trouble is not None:
            inside = f"something broke inside: {trouble!r}; see the log"
            return cards.failed(str(trouble) if isinstance(trouble, So101Error) else inside)
        return "" if reason is None else cards.note(f"Next: {cards.capital(reason)}")

    def close(self) -> None:
        """Leave the step and let go of the arm; how far the setup is stays on disk."""
        if self._current is not None:
            self._current.leave()
        self.shop.close()


def setup_parts(desk: Desk, *, on_stage: Callable[[bool], None]) -> tuple[SetupPart, ...]:
    """The setup of the arm that a preview shows; none for a simulated one.

    Args:
        desk: The preview's.
        on_stage: Told whether the preview's own arm has the stage.
    """
    fixed = given(desk.rig)
    if fixed is None:
        return ()
    kept = Progress(own_folder() / NAME, fixed.where)
    return (SetupPart(desk, progress=kept, on_stage=on_stage, ports=Ports(), fixed=fixed),)
