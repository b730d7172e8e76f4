"""The Program tab: record steps, order them, plan, run and save them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import viser

from so101_motion.common.modes import Mode
from so101_motion.common.units import to_deg
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.tasks.program import ARM, Arms, Solo
from so101_motion.tasks.program.files import ZerosOfArms
from so101_motion.tasks.program.loops import MOST_TIMES, Loop
from so101_motion.tasks.program.program import LONGEST_PAUSE, MOST, SLOWEST, Waypoint
from so101_motion.tasks.program.rehearsal import PASSING

from ..page import markup, units
from ..page.bar import board, uuid_of
from ..page.page_context import PROGRAM, PageContext, Part
from ..page.shared_fields import SharedField, TimeFields, UndoButtons, grey, percent_slider, put
from ..view_model import ViewModel
from . import program_texts as words
from .program_model import REST, STEP, ProgramModel
from .program_view import ProgramView
from .rehearsal_time import RehearsalTime

_PLAYS = "Only ghosts move. Pauses are cut to 2 s, and loops are shown twice. Press again to pause."
_NONE = "–"
_PART_WAY = "part way"
_JAW = {"keep": None, "close": 0.0, "open": 1.0, _PART_WAY: 0.5}
"""What the gripper does at a waypoint, as an aperture."""

_ALL = "all arms"
_USES = "re-record: it goes to where it is now; leave out: it stands still in this step"
_LINES = 3  # of the figures


class ProgramPart(Part):
    """The widgets of the Program tab; ``nodes`` stand where the arms' bases do in the scene."""

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
        self._at = lru_cache(MOST)(lambda each, frame: words.place(robot.frame(each.q, frame).p))
        self._views = {
            name: ProgramView(
                context.server.scene,
                robot,
                lambda dot, k: self._context.on_press(dot, partial(self.model.choose, k)),
                arm=name,
                root=f"{node}/program",
            )
            for name, node in nodes.items()
        }
        self._fields: dict[str, WaypointFields] = {}
        self._chosen: list[viser.GuiButtonGroupHandle] = []  # for the chosen step
        self._adding: list[viser.GuiButtonGroupHandle] = []  # what adds one
        with context.tabs.add_tab(PROGRAM):
            self._build(context.gui)

    def _build(self, gui: viser.GuiApi) -> None:
        model, button = self.model, self._context.button
        self._sentence = gui.add_html("")
        self._record = button("Record waypoint", model.record_arms, icon=viser.Icon.CIRCLE_PLUS)
        steps = gui.add_folder(None)
        with steps:
            self._add_steps(gui)
        self._undo = UndoButtons(self._context, model.history, model.saved_files)
        more = gui.add_folder(None)
        with more:
            self._add_more(gui)
        self._forms = steps, more  # of use once there is a step
        self._files = FileFields(self._context, model)

    def _add_steps(self, gui: viser.GuiApi) -> None:
        model, button = self.model, self._context.button
        self._rows = RowList(self._context, model.choose, model.reorder)
        # Above what is used less, for a phone shows little.
        self._plan = button("Plan program", model.plan, icon=viser.Icon.ROUTE)
        self._run = button("Run program", model.start, icon=viser.Icon.PLAYER_PLAY, color="green")
        self._progress = gui.add_progress_bar(0.0, color="green")
        if self._is_one:
            more = {"target": model.record_targets, "wait": model.wait, "pick": model.pick}
            adds = self._context.buttons(
                "Add",
                more,
                "A waypoint where the ghost is; a wait of 1 s, which Pause (s) changes; or one"
                " where the arm is, at which it picks an item",
            )
        else:
            self._add_record(
                "Record arm", model.record_arms, "these arms go to where they stand now"
            )
            self._add_record(
                "Record target", model.record_targets, "these arms go to their targets"
            )
            hint = "A step in which all its arms wait"
            adds = self._context.buttons("Add", {"wait": model.wait}, hint)
        self._adding.append(adds)
        self._add_order()

    def _add_more(self, gui: viser.GuiApi) -> None:
        model = self.model
        hint = "Share of the planned speed. While the program runs: from the next stop on"
        self._speed = percent_slider(
            self._context, "Run speed (%)", model.set_run_speed, hint, SLOWEST
        )
        self._plan_part = self._context.buttons(
            "Plan only",
            {part: partial(model.plan, part) for part in (REST, STEP)},
            "From the chosen row on, or only the motion to it",
        )
        self._rehearsal = RehearsalFields(self._context, model)
        self._facts = gui.add_html(markup.facts(words.facts(None), lines=_LINES))
        self._add_arms(gui)
        self._loops = LoopFields(self._context, model)
        self._rounds = RoundsFields(self._context, model.set_rounds)

    def _add_record(
        self, label: str, record: Callable[[Sequence[str] | None], None], what: str
    ) -> None:
        hint = f"A step in which {what}, at the same time"
        of_each = {name: partial(record, (name,)) for name in self._pages}
        does = {**of_each, _ALL: partial(record, None)}
        self._adding.append(self._context.buttons(label, does, hint))

    def _add_order(self) -> None:
        model = self.model
        does: dict[str, Callable[[], None]] = {
            "up": partial(model.move, -1),
            "down": partial(model.move, 1),
            "copy": model.duplicate,
        }
        if self._is_one:
            does["re-record"] = partial(model.take_place, ARM)
        does["delete"] = model.remove
        hint = "re-record: it moves to where the arm is now" if self._is_one else None
        self._chosen.append(self._context.buttons("Step", does, hint))

    def _add_arms(self, gui: viser.GuiApi) -> None:
        if self._is_one:
            self._fields = {ARM: WaypointFields(self._context, partial(self.model.set, ARM))}
            return
        tabs = gui.add_tab_group()
        model = self.model
        for name in self._pages:
            with tabs.add_tab(name):
                does = {
                    "re-record": partial(model.take_place, name),
                    "to target": partial(model.take_target, name),
                    "leave out": partial(model.leave_out, name),
                }
                self._chosen.append(self._context.buttons("In this step", does, _USES))
                self._fields[name] = WaypointFields(self._context, partial(model.set, name))

    def refresh(self) -> bool:
        model = self.model
        is_news, targets = model.refresh(), tuple(each.target for each in self._pages.values())
        run, modes = model.run, {each.arm.state.mode for each in self._members.values()}
        if run is not None and modes <= {Mode.MOVING, Mode.HOLDING}:
            self._context.bar.state = words.progress(run)
        runs = run is not None
        return is_news | self._context.front.note(
            model.timeline, model.playback.t, targets, runs=runs
        )

    def show(self) -> None:
        model, program = self.model, self.model.program
        timeline, run, around = model.timeline, model.run, program.loops_around
        self._show_scene()
        self._speed.show(model.run_speed)
        near = {} if timeline is None else timeline.nearest
        self._sentence.content = self._context.sentence(model.sentence)
        index = None if run is not None else model.chosen
        rows = [
            (words.title(program, k), self._told(k, near.get(k)), len(around(k)))
            for k in range(len(program))
        ]
        self._rows.show(rows, chosen=index, active=model.active)
        is_alone = index is not None and len(program.steps[index]) == 1
        for name, fields in self._fields.items():
            items = tuple(each.name for each in self._members[name].arm.scene.items)
            fields.show(model.waypoint(name), items, is_alone=is_alone)
        loops = () if index is None else around(index)
        self._loops.show(index, (program.steps, program.loops), loops)
        for group in self._chosen:
            grey(group, index is None)
        for group in self._adding:
            grey(group, run is not None)
        self._undo.show(can=run is None, needed=bool(program.steps))
        for form in self._forms:
            form.visible = bool(program.steps)
        self._record.disabled = self._context.bar.lost is not None or not model.can_record
        self._plan.disabled = not model.can_plan
        self._run.disabled = not model.can_run
        # One button shines, as on the Move tab.
        self._record.color = "gray" if program.steps else None
        grey(self._plan_part, not model.can_plan or model.chosen is None)
        put(self._progress, 0.0 if run is None else round(100.0 * run.share, 1))
        self._facts.content = markup.facts(words.facts(timeline), lines=_LINES)
        self._rehearsal.show(timeline, model.playback.t)
        self._rounds.show(program.rounds)
        self._files.show(model.name)

    def _told(self, k: int, near: float | None) -> str:
        """What is special about a step, after where the tool is then if there is one arm."""
        program, target = self.model.program, next(iter(self._pages.values())).target
        said, waypoint = words.line(program, k, near), program.steps[k].get(ARM)
        at = "" if waypoint is None else self._at(waypoint, target.frame)
        return ", ".join(filter(None, (at, said)))

    def _show_scene(self) -> None:
        """Draw the program, and where the arms would stand; not while it is run."""
        model, timeline, front = self.model, self.model.timeline, self._context.front
        is_seen = front.is_program and front.rehearses and model.run is None
        stands = timeline.at(model.playback.t)[1] if timeline is not None and is_seen else {}
        rehearsal = None if timeline is None else timeline.rehearsal
        for name, view in self._views.items():
            if not front.is_program:
                view.hide()
                continue
            state = self._members[name].arm.state
            view.show(model.program, rehearsal, stands.get(name), state)


class RowList:
    """The steps of a program in rows; a row is chosen by a press and moved by dragging it."""

    def __init__(
        self,
        context: PageContext,
        choose: Callable[[int], None],
        reorder: Callable[[int, int], None],
    ) -> None:
        self._choose, self._reorder = choose, reorder
        self._rows = context.gui.add_html("")
        self._picked = context.gui.add_text("Picked", "", visible=False)
        self._dragged = context.gui.add_text("Dragged", "", visible=False)
        context.on_entry(self._picked, self._pick)
        context.on_entry(self._dragged, self._drag)

    def show(
        self, rows: Iterable[tuple[str, str, int]], *, chosen: int | None, active: int | None
    ) -> None:
        press, move = uuid_of(self._picked), uuid_of(self._dragged)
        self._rows.content = markup.steps(
            rows, chosen=chosen, active=active, press=press, move=move
        )

    def _pick(self, number: str) -> None:
        if number.isdigit():
            self._choose(int(number) - 1)
        put(self._picked, "")  # so that the same row can be pressed again

    def _drag(self, entry: str) -> None:
        """Move a row: the browser sends a count, from where, and to where."""
        places = [int(word) for word in entry.split()[1:] if word.isdigit()]
        if len(places) == 2:
            self._reorder(*places)


class WaypointFields:
    """The fields of what an arm does in the selected step; ``change`` takes what is entered."""

    def __init__(self, context: PageContext, change: Callable[..., None]) -> None:
        def sets(field: str) -> Callable[[Any], None]:
            return lambda value: change(**{field: value})

        gui = context.gui
        self._name = SharedField(gui.add_text("Name", ""), sets("name"), context)
        hint = "On the way to it, as a share of the speed on the Move tab"
        self._speed = percent_slider(context, "Speed (%)", sets("speed"), hint, SLOWEST)
        passes = gui.add_checkbox(
            "Pass through",
            False,
            hint=f"Go on without stopping, no joint further than {to_deg(PASSING):g}° from it",
        )
        self._pass = SharedField(passes, sets("passes"), context)
        pause = gui.add_number("Pause (s)", 0.0, min=0.0, max=LONGEST_PAUSE, step=0.1)
        self._pause = SharedField(pause, sets("pause"), context, units.TENTHS)
        jaw = gui.add_dropdown("Gripper", tuple(_JAW))
        self._jaw = SharedField(jaw, lambda name: change(aperture=_JAW[name]), context)
        self._opening = percent_slider(context, "Gripper (%)", sets("aperture"))
        self._items = gui.add_dropdown("Pick item", (_NONE,))
        self._item = SharedField(
            self._items, lambda name: change(item="" if name == _NONE else name), context
        )
        place = gui.add_text("Put it at", "", hint="x,y,z in mm or a name; empty: hold it")
        self._place = SharedField(place, sets("place"), context)

    def show(self, waypoint: Waypoint | None, items: tuple[str, ...], *, is_alone: bool) -> None:
        """Show a waypoint, or all fields grey; only an arm that moves alone may pass."""
        if waypoint is None:
            fields = (self._name, self._speed, self._pass, self._pause, self._jaw, self._opening)
            for field in (*fields, self._item, self._place):
                field.offer(None)
            return
        aperture = waypoint.aperture
        self._name.offer(waypoint.name)
        self._speed.offer(waypoint.speed)
        self._pass.offer(waypoint.passes if is_alone else None)
        self._pause.offer(None if waypoint.passes else waypoint.pause)
        self._jaw.offer(next((name for name, each in _JAW.items() if each == aperture), _PART_WAY))
        self._opening.offer(aperture)
        others = () if waypoint.item in (None, *items) else (waypoint.item,)
        if self._items.options != (_NONE, *items, *others):
            self._items.options = (_NONE, *items, *others)
        self._item.offer(waypoint.item or _NONE)
        self._place.offer(None if waypoint.item is None else waypoint.place)


class LoopFields:
    """A folder that makes and ends loops."""

    def __init__(self, context: PageContext, model: ProgramModel) -> None:
        self._model = model
        self._offered: tuple[object, ...] = ()  # for what the fields were filled in
        gui = context.gui
        with gui.add_folder("Loops", expand_by_default=False):
            self._loop = (
                gui.add_number("From", 1, min=1, max=MOST, step=1),
                gui.add_number("To", 1, min=1, max=MOST, step=1),
                gui.add_number("Times", 2, min=2, max=MOST_TIMES, step=1),
            )
            self._acts = context.buttons(
                "Loop",
                {"repeat": self._repeat, "remove": model.end_loop},
                "Repeat these rows so many times; remove the loop around the chosen row",
            )

    def _repeat(self) -> None:
        first, last, times = (int(field.value) for field in self._loop)
        self._model.set_loop(first - 1, last - 1, times)

    def show(self, index: int | None, steps: object, around: tuple[Loop, ...]) -> None:
        """Fill in the inner loop around a step, or that step alone, when ``steps`` change."""
        grey(self._acts, index is None)
        if index is None or (index, steps) == self._offered:
            return
        self._offered = (index, steps)
        loop = around[-1] if around else Loop(first=index, last=index, times=2)
        numbers = (loop.first + 1, loop.last + 1, loop.times)
        for box, number in zip(self._loop, numbers, strict=True):
            put(box, number)


class RehearsalFields:
    """The timeline of a planned program: where its ghosts stand, and buttons that play it."""

    def __init__(self, context: PageContext, model: ProgramModel) -> None:
        gui = context.gui
        self._line = gui.add_html(markup.timeline(None, None))
        self._now = gui.add_html("", visible=False)
        self._time = TimeFields(context, "Rehearsal (s)", model.playback, (0.5, 1.0, 2.0), _PLAYS)
        self._drawn: RehearsalTime | None = None

    def show(self, timeline: RehearsalTime | None, t: float) -> None:
        """Show a planned program, and the time ``t`` [s] on it; without one all is grey."""
        if timeline is not self._drawn:
            self._drawn = timeline
            line = None if timeline is None else words.timeline(timeline)
            self._line.content = markup.timeline(line, uuid_of(self._time.slider))
        self._now.content = board("program", t=None if timeline is None else round(t, 2))
        self._time.show(None if timeline is None else timeline.duration, t)


class RoundsFields:
    """How often a program is repeated."""

    def __init__(self, context: PageContext, command: Callable[[int | None], None]) -> None:
        number = context.gui.add_number("Rounds", 1, min=1, max=MOST_TIMES, step=1)
        self._rounds = SharedField(number, command, context, units.Unit(int, int))
        self._endless = SharedField(
            context.gui.add_checkbox("Until stopped", False),
            lambda on: command(None if on else int(number.value)),
            context,
        )

    def show(self, rounds: int | None) -> None:
        self._rounds.offer(rounds)
        self._endless.show(rounds is None)


class FileFields:
    """A folder that saves and loads programs."""

    def __init__(self, context: PageContext, model: ProgramModel) -> None:
        gui = context.gui
        with gui.add_folder("Save and load", expand_by_default=False):
            name = gui.add_text("Program name", "")
            self._called = SharedField(name, partial(setattr, model, "name"), context)
            context.buttons("Program", {"save": model.save, "new": model.clear})
            self._saved = saved = gui.add_dropdown("Saved", (_NONE,))
            uses = {
                "load": lambda: model.load(saved.value),
                "insert": lambda: model.insert(saved.value),
                "delete": lambda: model.delete(saved.value),
            }
            self._use = context.buttons(
                "Saved one", uses, "insert: all its steps and loops, after the chosen row"
            )
        self._shelf = model.saved_files

    def show(self, name: str) -> None:
        self._called.show(name)
        saved = self._shelf.names
        if self._saved.options != (saved or (_NONE,)):
            self._saved.options = saved or (_NONE,)
        grey(self._use, not saved)
