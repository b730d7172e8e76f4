"""The Program tab: record waypoints, order them, plan, run and save them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import viser

from so101_motion.common.geometry import Array
from so101_motion.common.units import to_deg, to_rad
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.program.loops import MOST_TIMES, Loop
from so101_motion.tasks.program.program import LONGEST_PAUSE, MOST, SLOWEST
from so101_motion.tasks.program.rehearsal import PASSING

from ..page import markup
from ..page.bar import board, uuid_of
from ..page.page_context import ArmContext
from ..page.part import Part
from ..page.shared_fields import SharedField, grey, put
from ..view_model import ViewModel
from . import program_texts as words
from .program_model import REST, STEP, ProgramModel
from .program_screen import ProgramScreen
from .program_view import Ghost, ProgramView
from .rehearsal_time import RehearsalTime

_NONE = "none"
_PART_WAY = "part way"
_JAW = {"keep": None, "close": 0.0, "open": 1.0, _PART_WAY: 0.5}
"""What the gripper does at a waypoint, as an aperture."""
_RATES = {"0.5×": 0.5, "1×": 1.0, "2×": 2.0}
_LINES = 3  # of the figures


class ProgramPart(Part):
    """The widgets of the Program tab."""

    def __init__(self, context: ArmContext, page: ViewModel) -> None:
        rig = context.rig
        self.model = ProgramModel(
            arm=rig.arm,
            gripper=rig.gripper,
            clock=rig.clock,
            submit=context.beside,
            q_arm=lambda: page.q_arm,
            q_target=lambda: page.target.q,
            set_target=page.set_target_joints,
        )
        self._context = context.reporting(self.model.report)
        self._drawn: RehearsalTime | None = None  # what is on the line of time
        self._offered: tuple[object, ...] = ()  # for what the loop's fields were filled in
        self._view = ProgramView(
            context.server.scene,
            RobotModel.load(),
            lambda dot, k: self._context.on_pick(dot, partial(self.model.choose, k)),
        )
        with context.tabs.add_tab("Program"):  # nothing comes and goes, so nothing changes places
            self._add_recording(context.gui)
            self._add_run(context.gui)
            self._add_waypoint(context.gui)
            self._add_loops(context.gui)
            self._add_rounds(context.gui)
            self._add_files(context.gui)

    # Widgets

    def _add_recording(self, gui: viser.GuiApi) -> None:
        model = self.model
        self._sentence = gui.add_html("")
        record = gui.add_button_group(
            "Record", ("arm", "target"), hint="Where the arm is, or where the ghost is"
        )
        self._on_choice(record, {"arm": model.record_arm, "target": model.record_target})
        self._waypoints = gui.add_html("")
        self._picked = gui.add_text("Picked", "", visible=False)
        self._context.on_entry(self._picked, self._pick)
        self._dragged = gui.add_text("Dragged", "", visible=False)
        self._context.on_entry(self._dragged, self._reorder)
        self._order = gui.add_button_group(
            "Waypoint",
            ("up", "down", "copy", "re-record", "delete"),
            hint="re-record: it moves to where the arm is now",
        )
        self._on_choice(
            self._order,
            {
                "up": partial(model.move, -1),
                "down": partial(model.move, 1),
                "copy": model.duplicate,
                "re-record": model.take_place,
                "delete": model.remove,
            },
        )

    def _add_waypoint(self, gui: viser.GuiApi) -> None:
        model = self.model
        name = gui.add_text("Name", "")
        self._name = self._field(name, model.rename, str)
        speed = gui.add_slider(
            "Speed (%)",
            round(100.0 * SLOWEST),
            100,
            1,
            100,
            hint="On the way to it, as a share of the speed on the Move tab",
        )
        self._speed = self._field(speed, lambda percent: model.set_speed(percent / 100.0), round)
        passes = gui.add_checkbox(
            "Pass through",
            False,
            hint=f"Go on without stopping, no joint further than {to_deg(PASSING):g}° from it",
        )
        self._pass = self._field(passes, model.set_passes, bool)
        pause = gui.add_number("Pause (s)", 0.0, min=0.0, max=LONGEST_PAUSE, step=0.1)
        self._pause = self._field(pause, model.set_pause, lambda s: round(s, 1))
        jaw = gui.add_dropdown("Gripper", tuple(_JAW))
        self._jaw = self._field(jaw, lambda name: model.set_aperture(_JAW[name]), str)
        opening = gui.add_slider("Gripper (%)", 0, 100, 1, 0)
        self._opening = self._field(
            opening, lambda percent: model.set_aperture(percent / 100.0), round
        )
        self._of_waypoint = (
            self._name, self._speed, self._pass, self._pause, self._jaw, self._opening
        )  # fmt: skip

    def _add_loops(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("Loops", expand_by_default=False):
            self._loop = (
                gui.add_number("From step", 1, min=1, max=MOST, step=1),
                gui.add_number("To step", 1, min=1, max=MOST, step=1),
                gui.add_number("Times", 2, min=2, max=MOST_TIMES, step=1),
            )
            self._loops = gui.add_button_group(
                "Loop",
                ("repeat", "end"),
                hint="Repeat these steps so many times; end the loop around the chosen step",
            )
        self._on_choice(self._loops, {"repeat": self._repeat, "end": self.model.end_loop})

    def _repeat(self) -> None:
        first, last, times = (int(field.value) for field in self._loop)
        self.model.set_loop(first - 1, last - 1, times)

    def _add_rounds(self, gui: viser.GuiApi) -> None:
        model = self.model
        self._rounds_box = gui.add_number("Rounds", 1, min=1, max=MOST_TIMES, step=1)
        self._rounds = self._field(self._rounds_box, lambda n: model.set_rounds(int(n)), int)
        self._endless = self._field(
            gui.add_checkbox("Until stopped", False),
            lambda on: model.set_rounds(None if on else int(self._rounds_box.value)),
            bool,
        )

    def _add_run(self, gui: viser.GuiApi) -> None:
        model = self.model
        self._history = gui.add_button_group("Edits", ("undo", "redo"))
        self._on_choice(self._history, {"undo": model.undo, "redo": model.redo})
        self._plan = gui.add_button("Plan program", icon=viser.Icon.ROUTE)
        self._context.on_press(self._plan, model.plan)
        self._plan_part = gui.add_button_group(
            "Plan only", (REST, STEP), hint="From the chosen waypoint on, or only the way to it"
        )
        self._context.on_choice(self._plan_part, model.plan)
        self._run = gui.add_button("Run program", icon=viser.Icon.PLAYER_PLAY, color="green")
        self._context.on_press(self._run, model.run)
        self._progress = gui.add_progress_bar(0.0, color="green")
        self._line = gui.add_html(markup.timeline(None, None))
        self._now = gui.add_html("", visible=False)
        self._sought = gui.add_number("Sought", -1.0, step=0.01, visible=False)
        self._context.on_entry(self._sought, self._seek)
        self._slider = gui.add_slider("Rehearsal (s)", 0.0, 1.0, 0.01, 0.0, disabled=True)
        self._t = self._field(self._slider, model.preview, lambda t: round(t, 2))
        self._play = gui.add_button_group(
            "Play",
            tuple(_RATES),
            hint="Only the ghost moves; pauses last 2 s, loops are shown twice; again: pause",
        )
        self._context.on_choice(self._play, lambda name: model.play(_RATES[name]))
        self._facts = gui.add_html(markup.facts(words.NO_FACTS, lines=_LINES))

    def _add_files(self, gui: viser.GuiApi) -> None:
        model = self.model
        with gui.add_folder("Save and load", expand_by_default=False):
            self._called = self._field(gui.add_text("Program name", ""), model.call, str)
            write = gui.add_button_group("Program", ("save", "new"))
            self._saved = gui.add_dropdown("Saved", (_NONE,))
            self._use = gui.add_button_group("Saved one", ("load", "delete"))
        self._on_choice(write, {"save": model.save, "new": model.clear})
        self._on_choice(
            self._use,
            {
                "load": lambda: model.load(self._saved.value),
                "delete": lambda: model.delete(self._saved.value),
            },
        )

    def _field(self, widget: Any, command: Callable[[Any], None], shown: Any) -> SharedField:
        return SharedField(widget, command, self._context, shown=shown)

    def _on_choice(self, group: Any, commands: dict[str, Callable[[], None]]) -> None:
        self._context.on_choice(group, lambda name: commands[name]())

    def _pick(self, number: str) -> None:
        """Choose a waypoint; picked once more, the target goes there again."""
        if number.isdigit():
            self.model.choose(int(number) - 1)
        put(self._picked, "")

    def _seek(self, t: float) -> None:
        """Show the ghost at a place of the line of time, also at one where it was before."""
        self.model.preview(t)
        put(self._sought, -1.0)

    def _reorder(self, told: str) -> None:
        """Move a waypoint: the browser tells a count, from where, and to where."""
        places = [int(word) for word in told.split()[1:] if word.isdigit()]
        if len(places) == 2:
            self.model.reorder(*places)

    # The page

    def refresh(self) -> bool:
        """Take in the state of the arm, the plan being made and the running program."""
        return self.model.refresh()

    def show(self) -> None:
        """Update tab and scene; viser sends only what differs."""
        screen = self.model.screen()
        program, run = screen.program, screen.run
        timeline, ghost, active = screen.timeline, None, None
        if run is not None:
            active = run.where.index + screen.first
        elif timeline is not None:
            step, q, q_jaw = timeline.at(screen.t)
            if _apart(q, self._context.rig.arm.state.q):
                ghost = Ghost(q, q_jaw)
            active = step + screen.first if 0.0 < screen.t < timeline.duration else None
        self._view.show(program, None if timeline is None else timeline.rehearsal, ghost)
        self._sentence.content = markup.sentence(screen.sentence)
        near = {} if timeline is None else screen.clearances
        rows = [
            (
                waypoint.name,
                words.line(program, k, near.get(k - screen.first)),
                len(program.loops_around(k)),
            )
            for k, waypoint in enumerate(program.waypoints)
        ]
        self._waypoints.content = markup.steps(
            rows,
            chosen=screen.chosen,
            active=active,
            press=uuid_of(self._picked),
            move=uuid_of(self._dragged),
        )
        self._show_waypoint(screen)
        self._rounds.offer(program.rounds)
        self._endless.show(program.rounds is None)
        self._plan.disabled = not screen.can_plan
        self._run.disabled = not screen.can_run
        grey(self._plan_part, not screen.can_plan or screen.chosen is None)
        grey(self._history, not (screen.can_undo or screen.can_redo))
        self._show_rehearsal(screen)
        put(self._progress, 0.0 if run is None else round(100.0 * run.share, 1))
        self._called.show(screen.name)
        if self._saved.options != (screen.saved or (_NONE,)):
            self._saved.options = screen.saved or (_NONE,)
        grey(self._use, not screen.saved)

    def _show_rehearsal(self, screen: ProgramScreen) -> None:
        timeline = screen.timeline
        self._slider.disabled = timeline is None
        grey(self._play, timeline is None)
        facts = words.NO_FACTS if timeline is None else words.facts(timeline.rehearsal)
        self._facts.content = markup.facts(facts, lines=_LINES)
        if timeline is not self._drawn:
            self._drawn = timeline
            line = None if timeline is None else words.timeline(timeline)
            self._line.content = markup.timeline(line, uuid_of(self._sought))
        self._now.content = board("program", t=None if timeline is None else round(screen.t, 2))
        if timeline is not None:
            self._slider.max = max(math.ceil(100.0 * timeline.duration) / 100.0, 0.01)
        self._t.show(screen.t if timeline is not None else 0.0)

    def _show_waypoint(self, screen: ProgramScreen) -> None:
        waypoints = screen.program.waypoints
        index = screen.chosen if screen.can_edit else None
        grey(self._order, index is None)
        grey(self._loops, index is None)
        if index is None:
            for field in self._of_waypoint:
                field.offer(None)
            return
        if (index, waypoints) != self._offered:
            self._offered = (index, waypoints)
            around = screen.program.loops_around(index) or (None,)
            loop = around[-1] or Loop(first=index, last=index, times=2)
            numbers = (loop.first + 1, loop.last + 1, loop.times)
            for box, number in zip(self._loop, numbers, strict=True):
                put(box, number)
        chosen = waypoints[index]
        stops, aperture = not chosen.passes, chosen.aperture
        self._name.offer(chosen.name)
        self._speed.offer(100.0 * chosen.speed)
        self._pass.offer(chosen.passes)
        self._pause.offer(chosen.pause if stops else None)
        jaw = next((name for name, value in _JAW.items() if value == aperture), _PART_WAY)
        self._jaw.offer(jaw)
        self._opening.offer(100.0 * aperture if aperture is not None else None)


def _apart(q: Array, other: Array) -> bool:
    """Whether two arms at these joint angles would not flicker in each other."""
    return not np.allclose(q, other, atol=to_rad(0.5))
