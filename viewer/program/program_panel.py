"""The Program tab: record steps, order them, plan, run and save them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import viser

from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.program import ARM, Arms, Solo
from so101_motion.tasks.program.files import ZerosOfArms

from ..page import markup
from ..page.front_tab import PROGRAM
from ..page.page_context import PageContext
from ..page.part import Part
from ..page.shared_fields import UndoButtons, grey, put
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
from .program_view import ProgramView

_ALL = "all arms"
_USES = "re-record: it goes to where it is now; leave out: it stands still in this step"
_LINES = 3  # of the figures


class ProgramPart(Part):
    """The widgets of the Program tab.

    Args:
        arms: The arms that run programs.
        pages: Target and picture of each, by its name.
        nodes: The node in the scene that stands where the arm's base does, by the same names.
        zeros: Tells the zeros of the arms' calibrations.
    """

    def __init__(
        self,
        context: PageContext,
        arms: Arms,
        pages: Mapping[str, ViewModel],
        nodes: Mapping[str, str],
        zeros: Callable[[], ZerosOfArms],
    ) -> None:
        self.model = ProgramModel(arms, pages, context.in_background, zeros)
        self._context = context.reporting(self.model.report)
        self._members, self._pages, self._is_one = arms.members, pages, isinstance(arms, Solo)
        robot = RobotModel.load()
        self._views = {
            name: ProgramView(
                context.server.scene,
                robot,
                lambda dot, k: self._context.on_pick(dot, partial(self.model.choose, k)),
                arm=name,
                root=f"{node}/program",
            )
            for name, node in nodes.items()
        }
        self._fields: dict[str, WaypointFields] = {}
        self._chosen: list[viser.GuiButtonGroupHandle] = []  # for the chosen step
        with context.tabs.add_tab(PROGRAM):  # nothing comes and goes, so nothing changes places
            self._add_recording(context.gui)
            self._add_run(context.gui)  # above what is used less, for a phone shows little
            self._add_order(context.gui)
            self._add_rehearsal(context.gui)
            self._add_arms(context.gui)
            self._loops = LoopFields(self._context, self.model)
            self._rounds = RoundsFields(self._context, self.model.set_rounds)
            self._files = FileFields(self._context, self.model)

    # Widgets

    def _add_recording(self, gui: viser.GuiApi) -> None:
        model = self.model
        self._sentence = gui.add_html("")
        if self._is_one:
            self._context.buttons(
                "Record",
                {"arm": model.record_arms, "target": model.record_targets},
                "Where the arm is, or where the ghost is",
            )
        else:
            self._add_record("Record arm", model.record_arms, "they go to where they stand now")
            self._add_record("Record target", model.record_targets, "they go to their targets")
        self._rows = RowList(self._context, model.choose, model.reorder)

    def _add_record(
        self, label: str, record: Callable[[Sequence[str] | None], None], what: str
    ) -> None:
        hint = f"A step in which {what}, at the same time"
        of_each = {name: partial(record, (name,)) for name in self._pages}
        self._context.buttons(label, {**of_each, _ALL: partial(record, None)}, hint)

    def _add_run(self, gui: viser.GuiApi) -> None:
        button, model = self._context.button, self.model
        self._plan = button("Plan program", model.plan, icon=viser.Icon.ROUTE)
        self._run = button("Run program", model.start, icon=viser.Icon.PLAYER_PLAY, color="green")
        self._progress = gui.add_progress_bar(0.0, color="green")

    def _add_order(self, gui: viser.GuiApi) -> None:
        model = self.model
        does: dict[str, Callable[[], None]] = {
            "up": partial(model.move, -1),
            "down": partial(model.move, 1),
            "copy": model.duplicate,
        }
        if self._is_one:
            does["re-record"] = model.edit[ARM].take_place
        does["delete"] = model.remove
        hint = "re-record: it moves to where the arm is now" if self._is_one else None
        self._chosen.append(self._context.buttons(model.texts.step.capitalize(), does, hint))
        self._undo = UndoButtons(self._context, "Edits", model.history)

    def _add_rehearsal(self, gui: viser.GuiApi) -> None:
        self._plan_part = self._context.buttons(
            "Plan only",
            {part: partial(self.model.plan, part) for part in (REST, STEP)},
            "From the chosen row on, or only the way to it",
        )
        self._rehearsal = RehearsalFields(self._context, self.model)
        self._facts = gui.add_html(markup.facts(self.model.texts.facts(None), lines=_LINES))

    def _add_arms(self, gui: viser.GuiApi) -> None:
        if self._is_one:
            self._fields = {
                name: WaypointFields(self._context, each) for name, each in self.model.edit.items()
            }
            return
        tabs = gui.add_tab_group()
        for name, edit in self.model.edit.items():
            with tabs.add_tab(name):
                does = {
                    "re-record": edit.take_place,
                    "to target": edit.take_target,
                    "leave out": edit.leave_out,
                }
                self._chosen.append(self._context.buttons("In this step", does, _USES))
                self._fields[name] = WaypointFields(self._context, edit)

    # The page

    def refresh(self) -> bool:
        """Take in the state of the arms, the plan being made and the running program."""
        model = self.model
        is_news, targets = model.refresh(), tuple(each.target for each in self._pages.values())
        runs = model.run is not None
        return is_news | self._context.front.note(model.timeline, model.t, targets, runs=runs)

    def show(self) -> None:
        """Update tab and scene; viser sends only what differs."""
        model, program = self.model, self.model.program
        timeline, run, around = model.timeline, model.run, program.loops_around
        self._show_scene()
        near = {} if timeline is None else timeline.nearest
        self._sentence.content = markup.sentence(model.sentence)
        index = None if run is not None else model.chosen
        rows = [
            (words.title(program, k), words.line(program, k, near.get(k)), len(around(k)))
            for k in range(len(program))
        ]
        self._rows.show(rows, chosen=model.chosen, active=model.active)
        is_alone = index is not None and len(program.steps[index]) == 1
        for name, fields in self._fields.items():
            fields.show(model.waypoint(name), is_alone=is_alone)
        loops = () if index is None else around(index)
        self._loops.show(index, (program.steps, program.loops), loops)
        for group in self._chosen:
            grey(group, index is None)
        self._undo.show(can=run is None)
        self._plan.disabled = not model.can_plan
        self._run.disabled = not model.can_run
        grey(self._plan_part, not model.can_plan or model.chosen is None)
        put(self._progress, 0.0 if run is None else round(100.0 * run.share, 1))
        self._facts.content = markup.facts(self.model.texts.facts(timeline), lines=_LINES)
        self._rehearsal.show(timeline, model.t)
        self._rounds.show(program.rounds)
        self._files.show(model.name)

    def _show_scene(self) -> None:
        """Draw the program, and where the arms would stand; not while it is run."""
        model, timeline, front = self.model, self.model.timeline, self._context.front
        is_seen = front.is_program and front.rehearses and model.run is None
        stands = timeline.at(model.t)[1] if timeline is not None and is_seen else {}
        rehearsal = None if timeline is None else timeline.rehearsal
        for name, view in self._views.items():
            if not front.is_program:
                view.hide()
                continue
            state = self._members[name].arm.state
            view.show(model.program, rehearsal, stands.get(name), state)
