"""Groups of widgets of the Program tab."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial

from so101_motion.common.units import to_deg
from so101_motion.tasks.program.loops import MOST_TIMES, Loop
from so101_motion.tasks.program.program import LONGEST_PAUSE, MOST, SLOWEST, Waypoint
from so101_motion.tasks.program.rehearsal import PASSING

from ..page import markup
from ..page.bar import board, uuid_of
from ..page.page_context import PageContext
from ..page.shared_fields import SharedField, UndoButtons, grey, put
from . import program_texts as words
from .program_model import ArmInStep, ProgramModel
from .rehearsal_time import RehearsalTime

_PLAYS = "Only ghosts move. Pauses are cut to 2 s, and loops are shown twice. Press again to pause."
_NONE = "none"
_PART_WAY = "part way"
_JAW = {"keep": None, "close": 0.0, "open": 1.0, _PART_WAY: 0.5}
"""What the gripper does at a waypoint, as an aperture."""


class RowList:
    """The steps of a program in rows; a row is chosen by a press and moved by dragging it.

    Args:
        choose: Called with the index of the row that is pressed, also when it is the chosen one.
        reorder: Called with the indices of the row that was dragged, and of its new place.
    """

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
        """Show the steps; see ``markup.steps``."""
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
    """The fields of what an arm does in the selected step."""

    def __init__(self, context: PageContext, editor: ArmInStep) -> None:
        gui = context.gui
        name = gui.add_text("Name", "")
        self._name = SharedField(name, editor.rename, context, shown=str)
        speed = gui.add_slider(
            "Speed (%)",
            round(100.0 * SLOWEST),
            100,
            1,
            100,
            hint="On the way to it, as a share of the speed on the Move tab",
        )
        self._speed = SharedField(
            speed, lambda percent: editor.set_speed(percent / 100.0), context, shown=round
        )
        passes = gui.add_checkbox(
            "Pass through",
            False,
            hint=f"Go on without stopping, no joint further than {to_deg(PASSING):g}° from it",
        )
        self._pass = SharedField(passes, editor.set_passes, context, shown=bool)
        pause = gui.add_number("Pause (s)", 0.0, min=0.0, max=LONGEST_PAUSE, step=0.1)
        self._pause = SharedField(
            pause, editor.set_pause, context, shown=lambda seconds: round(seconds, 1)
        )
        jaw = gui.add_dropdown("Gripper", tuple(_JAW))
        self._jaw = SharedField(
            jaw, lambda name: editor.set_aperture(_JAW[name]), context, shown=str
        )
        opening = gui.add_slider("Gripper (%)", 0, 100, 1, 0)
        self._opening = SharedField(
            opening, lambda percent: editor.set_aperture(percent / 100.0), context, shown=round
        )

    def show(self, waypoint: Waypoint | None, *, is_alone: bool) -> None:
        """Show a waypoint; without one the fields are grey.

        Args:
            waypoint: What the arm does.
            is_alone: Whether it moves alone, so that it may pass.
        """
        if waypoint is None:
            fields = (self._name, self._speed, self._pass, self._pause, self._jaw, self._opening)
            for field in fields:
                field.offer(None)
            return
        aperture = waypoint.aperture
        self._name.offer(waypoint.name)
        self._speed.offer(100.0 * waypoint.speed)
        self._pass.offer(waypoint.passes if is_alone else None)
        self._pause.offer(None if waypoint.passes else waypoint.pause)
        self._jaw.offer(next((name for name, each in _JAW.items() if each == aperture), _PART_WAY))
        self._opening.offer(100.0 * aperture if aperture is not None else None)


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
        """Fill in the inner loop around a step, or one of that step alone.

        Args:
            index: The selected step; None, and all is grey, without one.
            steps: The steps of the program; when they change, the fields are filled in again.
            around: The loops that the step is in, the outer one first.
        """
        grey(self._acts, index is None)
        if index is None or (index, steps) == self._offered:
            return
        self._offered = (index, steps)
        loop = around[-1] if around else Loop(first=index, last=index, times=2)
        numbers = (loop.first + 1, loop.last + 1, loop.times)
        for box, number in zip(self._loop, numbers, strict=True):
            put(box, number)


class RehearsalFields:
    """The timeline of a planned program: where its ghosts stand, and buttons that play it.

    Args:
        model: Places and plays the ghosts.
    """

    def __init__(self, context: PageContext, model: ProgramModel) -> None:
        gui = context.gui
        self._line = gui.add_html(markup.timeline(None, None))
        self._now = gui.add_html("", visible=False)
        self._slider = gui.add_slider("Rehearsal (s)", 0.0, 1.0, 0.01, 0.0, disabled=True)
        self._t = SharedField(self._slider, model.preview, context, shown=lambda t: round(t, 2))
        rates = {f"{rate:g}×": partial(model.play, rate) for rate in (0.5, 1.0, 2.0)}
        self._play = context.buttons("Play", rates, _PLAYS)
        self._drawn: RehearsalTime | None = None

    def show(self, timeline: RehearsalTime | None, t: float) -> None:
        """Show a planned program, and the time ``t`` [s] on it; without one all is grey.

        Args:
            timeline: What was planned.
            t: Where the ghosts stand [s].
        """
        self._slider.disabled = timeline is None
        grey(self._play, timeline is None)
        if timeline is not self._drawn:
            self._drawn = timeline
            line = None if timeline is None else words.timeline(timeline)
            self._line.content = markup.timeline(line, uuid_of(self._slider))
        self._now.content = board("program", t=None if timeline is None else round(t, 2))
        if timeline is not None:
            self._slider.max = max(math.ceil(100.0 * timeline.duration) / 100.0, 0.01)
        self._t.show(t if timeline is not None else 0.0)


class RoundsFields:
    """How often a program is repeated."""

    def __init__(self, context: PageContext, command: Callable[[int | None], None]) -> None:
        number = context.gui.add_number("Rounds", 1, min=1, max=MOST_TIMES, step=1)
        self._rounds = SharedField(number, lambda n: command(int(n)), context, shown=int)
        self._endless = SharedField(
            context.gui.add_checkbox("Until stopped", False),
            lambda on: command(None if on else int(number.value)),
            context,
            shown=bool,
        )

    def show(self, rounds: int | None) -> None:
        """Show a number of rounds; None for endless."""
        self._rounds.offer(rounds)
        self._endless.show(rounds is None)


class FileFields:
    """A folder that saves and loads programs."""

    def __init__(self, context: PageContext, model: ProgramModel) -> None:
        gui = context.gui
        with gui.add_folder("Save and load", expand_by_default=False):
            name = gui.add_text("Program name", "")
            self._called = SharedField(name, model.call, context, shown=str)
            context.buttons("Program", {"save": model.save, "new": model.clear})
            self._saved = saved = gui.add_dropdown("Saved", (_NONE,))
            uses = {
                "load": lambda: model.load(saved.value),
                "delete": lambda: model.delete(saved.value),
            }
            self._use = context.buttons("Saved one", uses)
            self._undo = UndoButtons(context, "Files", model.saved_files)
        self._shelf = model.saved_files

    def show(self, name: str) -> None:
        """Show the name for saving, and what is saved."""
        self._called.show(name)
        saved = self._shelf.names
        if self._saved.options != (saved or (_NONE,)):
            self._saved.options = saved or (_NONE,)
        grey(self._use, not saved)
        self._undo.show()
