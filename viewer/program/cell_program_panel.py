"""The Program tab of several arms: record steps, order them, plan, run and save them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import viser

from so101_motion.arm.cell import Cell
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.program.cell_program import ZerosOfArms
from so101_motion.tasks.program.loops import loops_around

from ..page import markup
from ..page.front_tab import PROGRAM
from ..page.page_context import PageContext
from ..page.part import Part
from ..page.shared_fields import UndoButtons, grey
from ..view_model import ViewModel
from . import program_texts as words
from .arm_in_step import ArmInStep
from .cell_program_model import CellProgramModel
from .program_fields import (
    FileFields,
    LoopFields,
    RehearsalFields,
    RoundsFields,
    RowList,
    WaypointFields,
)
from .program_model import REST, STEP
from .program_view import Ghost, GhostView

_ALL = "all arms"
_USES = "re-record: it goes to where it is now; leave out: it stands still in this step"


class CellProgramPart(Part):
    """The widgets of the Program tab of several arms.

    Args:
        cell: Keeps the arms apart.
        arms: Target and picture of each arm, by its name in the cell.
        nodes: The node in the scene that stands where the arm's base does, by the same names.
        zeros: Tells the zeros of the arms' calibrations.
    """

    def __init__(
        self,
        context: PageContext,
        cell: Cell,
        arms: Mapping[str, ViewModel],
        nodes: Mapping[str, str],
        zeros: Callable[[], ZerosOfArms],
    ) -> None:
        self.model = CellProgramModel(cell, arms, context.in_background, zeros)
        self._context = context.reporting(self.model.report)
        self._names, self._members = tuple(arms), cell.members
        self._arms = tuple(arms.values())
        self._ghosts = {
            name: GhostView(context.server.scene, f"{node}/program") for name, node in nodes.items()
        }
        self._robot = RobotModel.load()
        with context.tabs.add_tab(PROGRAM):
            self._add_steps(context.gui)
            self._add_run(context.gui)
            self._add_arms(context.gui)
            self._loops = LoopFields(self._context, self.model)
            self._rounds = RoundsFields(self._context, self.model.set_rounds)
            self._files = FileFields(self._context, self.model)

    def _add_steps(self, gui: viser.GuiApi) -> None:
        model = self.model
        self._sentence = gui.add_html("")
        self._add_record("Record arm", model.record_arms, "they go to where they stand now")
        self._add_record("Record target", model.record_targets, "they go to their targets")
        self._rows = RowList(self._context, model.choose, model.reorder)

    def _add_record(self, label: str, record: Callable[[Sequence[str]], None], what: str) -> None:
        hint = f"A step in which {what}, at the same time"
        group = self._context.gui.add_button_group(label, (*self._names, _ALL), hint=hint)
        self._context.on_choice(
            group, lambda name: record(self._names if name == _ALL else (name,))
        )

    def _add_run(self, gui: viser.GuiApi) -> None:
        model = self.model
        self._plan = gui.add_button("Plan program", icon=viser.Icon.ROUTE)
        self._context.on_press(self._plan, model.plan)
        self._run = gui.add_button("Run program", icon=viser.Icon.PLAYER_PLAY, color="green")
        self._context.on_press(self._run, model.run)
        self._order = gui.add_button_group("Step", ("up", "down", "copy", "delete"))
        orders: dict[str, Callable[[], None]] = {
            "up": partial(model.move, -1),
            "down": partial(model.move, 1),
            "copy": model.duplicate,
            "delete": model.remove,
        }
        self._context.on_choice(self._order, partial(_do, orders))
        self._undo = UndoButtons(self._context, "Edits", model)
        self._add_parts(gui)
        self._rehearsal = RehearsalFields(
            self._context,
            model,
            hint="Only the ghosts move. Pauses are cut to 2 s, and loops are shown twice. Press"
            " again to pause.",
        )
        self._facts = gui.add_html("")

    def _add_parts(self, gui: viser.GuiApi) -> None:
        self._plan_part = gui.add_button_group(
            "Plan only", (REST, STEP), hint="From the chosen step on, or only that one"
        )
        self._context.on_choice(self._plan_part, self.model.plan)

    def _add_arms(self, gui: viser.GuiApi) -> None:
        model, tabs = self.model, gui.add_tab_group()
        self._fields: dict[str, WaypointFields] = {}
        self._uses: list[viser.GuiButtonGroupHandle] = []
        for name in self._names:
            with tabs.add_tab(name):
                use = gui.add_button_group(
                    "In this step", ("re-record", "to target", "leave out"), hint=_USES
                )
                does = {
                    "re-record": partial(model.take_place, name),
                    "to target": partial(model.take_target, name),
                    "leave out": partial(model.leave_out, name),
                }
                self._context.on_choice(use, partial(_do, does))
                fields = WaypointFields(self._context, ArmInStep(model, name))
                fields.add_speed()
                fields.add_stay()
            self._fields[name] = fields
            self._uses.append(use)

    def refresh(self) -> bool:
        """Take in the state of the arms, the plan being made and the running program."""
        model = self.model
        is_news, targets = model.refresh(), tuple(arm.target for arm in self._arms)
        return is_news | self._context.front.note(model.timeline, model.t, targets, runs=model.runs)

    def show(self) -> None:
        """Update the widgets; viser sends only what differs."""
        model, timeline = self.model, self.model.timeline
        self._show_ghosts()
        near = {} if timeline is None else timeline.nearest
        self._sentence.content = markup.sentence(model.sentence)
        self._rows.show(
            [
                (
                    ", ".join(step),
                    words.cell_line(step, near.get(k), words.ending_at(model.loops, k)),
                    len(loops_around(model.loops, k)),
                )
                for k, step in enumerate(model.steps)
            ],
            chosen=model.chosen,
            active=model.active,
        )
        for name, fields in self._fields.items():
            fields.show(model.waypoint(name))
        index = None if model.runs else model.chosen
        around = () if index is None else loops_around(model.loops, index)
        self._loops.show(index, (model.steps, model.loops), around)
        for group in (self._order, *self._uses):
            grey(group, model.chosen is None or model.runs)
        self._undo.show()
        self._plan.disabled = not model.can_plan
        self._run.disabled = not model.can_run
        grey(self._plan_part, not model.can_plan or model.chosen is None)
        self._facts.content = markup.facts(words.cell_facts(timeline))
        self._rehearsal.show(timeline, model.t, words.cell_timeline)
        self._rounds.show(model.rounds)
        self._files.show(model.name)

    def _show_ghosts(self) -> None:
        """Show where the arms would stand; none while the program is run, or without a plan."""
        model, timeline, front = self.model, self.model.timeline, self._context.front
        is_seen = front.is_program and front.rehearses and not model.runs
        stands = timeline.at(model.t)[1] if timeline is not None and is_seen else {}
        ghosts = {name: Ghost(*stand) for name, stand in stands.items()}
        for name, view in self._ghosts.items():
            view.show(self._robot, ghosts.get(name), self._members[name].arm.state)


def _do(commands: Mapping[str, Callable[[], None]], name: str) -> None:
    commands[name]()
