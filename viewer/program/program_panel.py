"""The Program tab: record waypoints, order them, plan, run and save them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import viser

from so101_motion.common.units import to_deg
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.program.rehearsal import PASSING

from ..page import markup
from ..page.front_tab import PROGRAM
from ..page.page_context import ArmContext
from ..page.part import Part
from ..page.shared_fields import SharedField, UndoButtons, grey, put
from ..view_model import ViewModel
from . import program_texts as words
from .program_fields import (
    FileFields,
    LoopFields,
    RehearsalFields,
    RoundsFields,
    RowList,
    WaypointFields,
)
from .program_model import REST, STEP, ProgramModel
from .program_screen import ProgramScreen
from .program_view import Ghost, ProgramView

_LINES = 3  # of the figures


class ProgramPart(Part):
    """The widgets of the Program tab."""

    def __init__(self, context: ArmContext, page: ViewModel) -> None:
        rig = context.rig
        self.model = ProgramModel(
            arm=rig.arm,
            gripper=rig.gripper,
            clock=rig.clock,
            submit=context.in_background,
            q_arm=lambda: page.q_arm,
            q_target=lambda: page.target.q,
            set_target=page.set_target_joints,
            zeros=lambda: rig.connection.encoder_zeros,
        )
        self._context = context.reporting(self.model.report)
        self._page, self._target, self._front = page, page.target, context.front
        self._view = ProgramView(
            context.server.scene,
            RobotModel.load(),
            lambda dot, k: self._context.on_pick(dot, partial(self.model.choose, k)),
        )
        with context.tabs.add_tab(PROGRAM):  # nothing comes and goes, so nothing changes places
            self._add_recording(context.gui)
            self._add_run(context.gui)  # above what is used less, for a phone shows little
            self._add_order(context.gui)
            self._add_rehearsal(context.gui)
            self._add_waypoint(context.gui)
            self._loops = LoopFields(self._context, self.model)
            self._rounds = RoundsFields(self._context, self.model.set_rounds)
            self._files = FileFields(self._context, self.model)

    # Widgets

    def _add_recording(self, gui: viser.GuiApi) -> None:
        model = self.model
        self._sentence = gui.add_html("")
        record = gui.add_button_group(
            "Record", ("arm", "target"), hint="Where the arm is, or where the ghost is"
        )
        self._on_choice(record, {"arm": model.record_arm, "target": model.record_target})
        self._rows = RowList(self._context, model.choose, model.reorder)

    def _add_waypoint(self, gui: viser.GuiApi) -> None:
        model = self.model
        name = gui.add_text("Name", "")
        self._name = self._field(name, model.rename, str)
        self._fields = WaypointFields(self._context, model)
        self._fields.add_speed()
        passes = gui.add_checkbox(
            "Pass through",
            False,
            hint=f"Go on without stopping, no joint further than {to_deg(PASSING):g}° from it",
        )
        self._pass = self._field(passes, model.set_passes, bool)
        self._fields.add_stay()

    def _add_run(self, gui: viser.GuiApi) -> None:
        self._plan = gui.add_button("Plan program", icon=viser.Icon.ROUTE)
        self._context.on_press(self._plan, self.model.plan)
        self._run = gui.add_button("Run program", icon=viser.Icon.PLAYER_PLAY, color="green")
        self._context.on_press(self._run, self.model.run)
        self._progress = gui.add_progress_bar(0.0, color="green")

    def _add_order(self, gui: viser.GuiApi) -> None:
        model = self.model
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
        self._undo = UndoButtons(self._context, "Edits", model)

    def _add_rehearsal(self, gui: viser.GuiApi) -> None:
        self._plan_part = gui.add_button_group(
            "Plan only", (REST, STEP), hint="From the chosen waypoint on, or only the way to it"
        )
        self._context.on_choice(self._plan_part, self.model.plan)
        self._rehearsal = RehearsalFields(
            self._context,
            self.model,
            hint="Only the ghost moves. Pauses are cut to 2 s, and loops are shown twice. Press"
            " again to pause.",
        )
        self._facts = gui.add_html(markup.facts(words.NO_FACTS, lines=_LINES))

    def _field(self, widget: Any, command: Callable[[Any], None], shown: Any) -> SharedField:
        return SharedField(widget, command, self._context, shown=shown)

    def _on_choice(self, group: Any, commands: dict[str, Callable[[], None]]) -> None:
        self._context.on_choice(group, lambda name: commands[name]())

    # The page

    def refresh(self) -> bool:
        """Take in the state of the arm, the plan being made and the running program."""
        before, self._target = self._target, self._page.target
        is_news = self.model.refresh()
        if not is_news and self._target is before:
            return False
        screen = self.model.screen()
        runs = screen.run is not None
        return is_news | self._front.note(screen.timeline, screen.t, (self._target,), runs=runs)

    def show(self) -> None:
        """Update tab and scene; viser sends only what differs."""
        screen = self.model.screen()
        program, run = screen.program, screen.run
        timeline, ghost, active = screen.timeline, None, None
        if run is not None:
            active = run.where.index + screen.first
        elif timeline is not None:
            step, q, q_jaw = timeline.at(screen.t)
            if self._front.rehearses:
                ghost = Ghost(q, q_jaw)
            active = step + screen.first if 0.0 < screen.t < timeline.duration else None
        rehearsal = None if timeline is None else timeline.rehearsal
        if self._front.is_program:
            self._view.show(program, rehearsal, ghost, self._context.rig.arm.state)
        else:
            self._view.hide()
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
        self._rows.show(rows, chosen=screen.chosen, active=active)
        self._show_waypoint(screen)
        self._rounds.show(program.rounds)
        self._plan.disabled = not screen.can_plan
        self._run.disabled = not screen.can_run
        grey(self._plan_part, not screen.can_plan or screen.chosen is None)
        self._undo.show()
        self._show_rehearsal(screen)
        put(self._progress, 0.0 if run is None else round(100.0 * run.share, 1))
        self._files.show(screen.name)

    def _show_rehearsal(self, screen: ProgramScreen) -> None:
        timeline = screen.timeline
        facts = words.NO_FACTS if timeline is None else words.facts(timeline.rehearsal)
        self._facts.content = markup.facts(facts, lines=_LINES)
        self._rehearsal.show(timeline, screen.t, words.timeline)

    def _show_waypoint(self, screen: ProgramScreen) -> None:
        waypoints = screen.program.waypoints
        index = screen.chosen if screen.can_edit else None
        grey(self._order, index is None)
        around = () if index is None else screen.program.loops_around(index)
        self._loops.show(index, (waypoints, screen.program.loops), around)
        self._fields.show(None if index is None else waypoints[index])
        if index is None:
            self._name.offer(None)
            self._pass.offer(None)
            return
        self._name.offer(waypoints[index].name)
        self._pass.offer(waypoints[index].passes)
