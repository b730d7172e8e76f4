"""State and commands of the Program tab of several arms, without viser.

A step says where each arm goes; they go at the same time. All of a program is planned before
anything moves; the plan is dropped when the steps, an arm's place, its speed limits or its
surroundings change. Nothing here waits: slow calls are futures that ``refresh`` collects. One
thread owns a ``CellProgramModel``.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from so101_motion.arm.cell import Cell
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.tasks.program import (
    CellProgram,
    CellProgramRun,
    Loop,
    Waypoint,
    files,
    read_cell_program,
    rehearse_cell,
    start_cell_program,
)
from so101_motion.tasks.program.cell_program import ZerosOfArms, cell_folder, write_cell_program
from so101_motion.tasks.program.loops import (
    loops_around,
    with_loop,
    with_step_moved,
    without_step,
)
from so101_motion.tasks.program.rehearsal import stands_at

from ..page import texts
from ..page.history import History
from ..page.playback import Playback
from ..page.saved_files import SavedFiles
from ..page.screen_state import Sentence
from ..view_model import ViewModel
from . import program_texts as words
from .cell_rehearsal_time import CellRehearsalTime
from .program_model import ALL, SAME_JAW, STEP, next_letter, same_things, things_around

Step = Mapping[str, Waypoint]
Steps = tuple[Step, ...]


@dataclass(frozen=True, slots=True)
class _Edited:
    """A program that may still be empty."""

    steps: Steps = ()
    rounds: int | None = 1
    loops: tuple[Loop, ...] = ()


class CellProgramModel:
    """State and commands of the Program tab of several arms.

    Args:
        cell: Keeps the arms apart.
        arms: Target and picture of each arm, by its name in the cell.
        submit: Runs a slow call on another thread.
        zeros: Tells the zeros of the arms' calibrations.

    Attributes:
        chosen: Index of the step that is edited; None without one.
        name: What the program is called, when it is saved or was loaded.
        saved_files: The user's programs.
        timeline: The plan of the whole program over time, as long as it is valid; else None.
    """

    def __init__(
        self,
        cell: Cell,
        arms: Mapping[str, ViewModel],
        submit: Callable[[Callable[[], Any]], Future[Any]],
        zeros: Callable[[], ZerosOfArms] = dict,
    ) -> None:
        self._zeros = zeros
        self._cell, self._arms, self._submit = cell, dict(arms), submit
        self._now = next(iter(cell.members.values())).clock.now
        self._edited = _Edited()
        self._history = History(self._edited, self._now)
        self.chosen: int | None = None
        self.name, self.saved_files = "", SavedFiles(_file_of, _listed, self._tell)
        self.timeline: CellRehearsalTime | None = None
        self._playback = Playback()
        self._sentence = words.CELL_WELCOME
        self._planning: Future[CellRehearsalTime] | None = None
        self._made_for: tuple[object, ...] = ()
        self._run: CellProgramRun | None = None
        self._shown: tuple[object, ...] = ()

    # Steps

    @property
    def steps(self) -> Steps:
        """The steps: in each a waypoint for every arm that moves, by its name."""
        return self._edited.steps

    @property
    def rounds(self) -> int | None:
        """How often they are repeated; None for until stopped."""
        return self._edited.rounds

    @property
    def loops(self) -> tuple[Loop, ...]:
        """The steps that are repeated within each round."""
        return self._edited.loops

    def record_arms(self, names: Sequence[str]) -> None:
        """Add a step in which these arms go to where they stand now, at the same time."""
        self._record({name: self._arms[name].q_arm for name in names})

    def record_targets(self, names: Sequence[str]) -> None:
        """Add a step in which these arms go to their targets at the same time."""
        self._record({name: self._arms[name].target.q for name in names})

    def choose(self, index: int) -> None:
        """Select a step, and show the ghosts of its arms there."""
        if 0 <= index < len(self.steps):
            self.chosen = index
            for name, waypoint in self.steps[index].items():
                if name in self._arms:
                    self._arms[name].set_target_joints(waypoint.q)

    def waypoint(self, name: str) -> Waypoint | None:
        """What an arm does in the selected step; None for nothing."""
        can_edit = self.chosen is not None and self._run is None
        return self.steps[self._chosen_index()].get(name) if can_edit else None

    def take_place(self, name: str) -> None:
        """Let an arm go to where it stands now in the selected step, beside the others."""
        self._take(name, self._arms[name].q_arm)

    def take_target(self, name: str) -> None:
        """Let an arm go to its target in the selected step, beside the others."""
        self._take(name, self._arms[name].target.q)

    def change(self, name: str, **to: Any) -> None:
        """Change what an arm does in the selected step, in terms of ``Waypoint``."""
        index = self._chosen_index()
        waypoint = self.steps[index].get(name)
        if waypoint is not None:
            self._put(name, replace(waypoint, **to), (index, name, *to))

    def leave_out(self, name: str) -> None:
        """Let an arm stand still in the selected step."""
        index = self._chosen_index()
        rest = {key: each for key, each in self.steps[index].items() if key != name}
        if not rest:
            raise ConfigError("step", index + 1, "has no other arm; delete it instead")
        self._edit((*self.steps[:index], rest, *self.steps[index + 1 :]))

    def reorder(self, index: int, to: int) -> None:
        """Put a step at another place, and select it."""
        steps = list(self.steps)
        if min(index, to) >= 0 and max(index, to) < len(steps):
            steps.insert(to, steps.pop(index))
            self._edit(tuple(steps), loops=with_step_moved(self.loops, index, to))
            self.chosen = to

    def move(self, by: int) -> None:
        """Move the selected step earlier (-1) or later (1)."""
        index = self._chosen_index()
        self.reorder(index, index + by)

    def remove(self) -> None:
        """Remove the selected step."""
        index = self._chosen_index()
        steps = (*self.steps[:index], *self.steps[index + 1 :])
        self._edit(steps, loops=without_step(self.loops, index))

    def duplicate(self) -> None:
        """Add the selected step once more behind itself."""
        index, steps = self._chosen_index(), self.steps
        loops = with_step_moved(self.loops, len(steps), index + 1)
        self._edit((*steps[: index + 1], steps[index], *steps[index + 1 :]), loops=loops)
        self.chosen = index + 1

    def set_loop(self, first: int, last: int, times: int) -> None:
        """Repeat the steps from ``first`` to ``last`` (indices) so many times in a row."""
        loop = Loop(first=first, last=last, times=times)
        self._edit(self.steps, loops=with_loop(self.loops, loop))

    def end_loop(self) -> None:
        """Remove the inner one of the loops around the selected step."""
        around = loops_around(self.loops, self._chosen_index())
        if not around:
            raise ConfigError("loop", None, "the chosen step is in no loop")
        self._edit(self.steps, loops=tuple(each for each in self.loops if each is not around[-1]))

    def undo(self) -> None:
        """Undo the last edit."""
        self._set(self._history.undo())

    def redo(self) -> None:
        """Redo what was undone last."""
        self._set(self._history.redo())

    def set_rounds(self, rounds: int | None) -> None:
        """Set the number of rounds; None for endless."""
        self._edit(self.steps, "rounds", rounds=rounds)

    # Files

    def call(self, name: str) -> None:
        """Set the name for saving."""
        self.name = name

    def save(self) -> None:
        """Save the program under its name; replaces one of that name."""
        program = self._program()
        with self.saved_files.changing(self.name) as file:
            write_cell_program(program, file, self._zeros())
        self.name = file.stem
        self._sentence = words.saved(file)

    def load(self, name: str) -> None:
        """Load the program ``name``; nothing moves."""
        program = read_cell_program(_file_of(name), self._zeros())
        self._edit(program.steps, rounds=program.rounds, loops=program.loops)
        self.name, self.chosen = name, 0
        self._sentence = words.loaded_steps(name, len(program.steps))

    def delete(self, name: str) -> None:
        """Delete the file of the program ``name``; the edited program stays."""
        with self.saved_files.changing(name):
            files.delete(name, cell_folder())
        self._sentence = words.deleted(name)

    def clear(self) -> None:
        """Start a new program."""
        self._edit((), rounds=1, loops=())
        self.name = ""

    # Planning, running

    def plan(self, part: str = ALL) -> None:
        """Plan the program, or a part of it; nothing moves.

        Args:
            part: ``ALL``, ``REST`` from the selected step on, or ``STEP``: that one alone.
        """
        if self.can_plan:
            self._made_for, cell, program = self._things(), self._cell, self._program()
            if part != ALL:
                first = self._chosen_index()
                program = program.part(first, first + 1 if part == STEP else len(self.steps))

            def plan_all() -> CellRehearsalTime:
                return CellRehearsalTime(rehearse_cell(cell, program), cell.members)

            self._planning = self._submit(plan_all)
            self._sentence = words.CELL_PLANNING

    def run(self) -> None:
        """Run the program as it was planned."""
        if self.can_run and self.timeline is not None:
            self._run = start_cell_program(self._cell, self.timeline.rehearsal)

    def preview(self, t: float) -> None:
        """Show the ghosts ``t`` seconds into the rehearsal."""
        self._playback.seek(t)

    def play(self, rate: float) -> None:
        """Play the rehearsal with the ghosts at ``rate`` times real time, or pause."""
        if self.timeline is not None:
            self._playback.play(rate)

    def report(self, error: BaseException) -> None:
        """Show that a command failed."""
        self._sentence = words.cell_ended(error)

    # What is shown

    @property
    def sentence(self) -> Sentence:
        """What to know or to do now."""
        if self._run is not None:
            return words.running_step(self._run)
        members = self._cell.members.items()
        guided = [name for name, each in members if each.arm.state.mode is Mode.GUIDING]
        return words.cell_guided(guided) if guided else self._sentence

    @property
    def runs(self) -> bool:
        """Whether the program is being run."""
        return self._run is not None

    @property
    def active(self) -> int | None:
        """Index of the step that is being done, or rehearsed; None if none is."""
        if self._run is not None:
            return self._run.where.index + self._run.program.before
        timeline = self.timeline
        if timeline is None or not 0.0 < self.t < timeline.duration:
            return None
        return timeline.at(self.t)[0]

    @property
    def t(self) -> float:
        """How far into the rehearsal the ghosts stand [s]."""
        return self._playback.t

    @property
    def can_plan(self) -> bool:
        """Whether Plan may be pressed."""
        return bool(self.steps) and self._planning is None and self._are_ready

    @property
    def can_run(self) -> bool:
        """Whether Run may be pressed."""
        return self.timeline is not None and self._are_ready

    @property
    def can_undo(self) -> bool:
        """Whether there is an edit to undo."""
        return self._run is None and self._history.can_undo

    @property
    def can_redo(self) -> bool:
        """Whether one was undone."""
        return self._run is None and self._history.can_redo

    @property
    def _are_ready(self) -> bool:
        holding = (each.arm.state.mode is Mode.HOLDING for each in self._cell.members.values())
        return self._run is None and all(holding)

    def refresh(self) -> bool:
        """Take in changes since the last call; return whether there is anything new to show."""
        self._collect_plan()
        self._watch_plan()
        self._collect_run()
        self._playback.advance(self._now())
        self.saved_files.look_again(self._now())
        before = self._shown
        self._shown = (
            self._edited, self.chosen, self.saved_files.names, self.sentence, self.active,
            self.can_plan, self.can_run, self.t, self.timeline,
        )  # fmt: skip
        return self._shown != before

    # Helpers

    def _collect_plan(self) -> None:
        if self._planning is None or not self._planning.done():
            return
        planning, self._planning = self._planning, None
        error = planning.exception()
        if error is not None:
            self.report(error)
        else:
            self.timeline = planning.result()
            is_whole = len(self.timeline.rehearsal.program.loops) == len(self.loops)
            self._sentence = words.CELL_PLANNED if is_whole else words.PLANNED_PART
            self._playback.load(self.timeline.duration)

    def _watch_plan(self) -> None:
        if self.timeline is None or self._run is not None:
            return
        for name, stand in self.timeline.rehearsal.steps[0].stands.items():
            state = self._cell.members[name].arm.state
            if not stands_at(stand.q, state.q_ref):
                self._drop_plan(texts.named(name, words.ARM_MOVED))
            elif abs(stand.q_jaw - state.q_jaw_ref) > SAME_JAW:
                self._drop_plan(texts.named(name, words.JAW_MOVED))
        if self.timeline is not None and not same_things(self._things(), self._made_for):
            self._drop_plan(words.THINGS_CHANGED)

    def _collect_run(self) -> None:
        if self._run is not None and self._run.future.done():
            run, self._run = self._run, None
            error = run.future.exception()
            self._drop_plan(words.done(run) if error is None else words.cell_ended(error))

    def _drop_plan(self, sentence: Sentence) -> None:
        self._planning = self.timeline = None
        self._sentence = sentence

    def _things(self) -> tuple[object, ...]:
        return tuple(x for each in self._cell.members.values() for x in things_around(each.arm))

    def _tell(self, sentence: Sentence) -> None:
        self._sentence = sentence

    def _record(self, goals: Mapping[str, Array]) -> None:
        number = len(self.steps) + 1
        self._edit((*self.steps, {name: self._new(q) for name, q in goals.items()}))
        self.chosen, self._sentence = number - 1, words.recorded_step(number)

    def _take(self, name: str, q: Array) -> None:
        before = self.steps[self._chosen_index()].get(name)
        if before is None:
            self._put(name, self._new(q))
        else:
            self.change(name, q=q)

    def _new(self, q: Array) -> Waypoint:
        taken = (each.name for step in self.steps for each in step.values())
        return Waypoint(name=next_letter(taken), q=q)

    def _chosen_index(self) -> int:
        if self.chosen is None:
            raise ConfigError("step", None, "record a step first")
        return self.chosen

    def _program(self) -> CellProgram:
        return CellProgram(steps=self.steps, rounds=self.rounds, loops=self.loops)

    def _put(self, name: str, waypoint: Waypoint, kind: Hashable = None) -> None:
        index = self._chosen_index()
        step = {**self.steps[index], name: waypoint}
        self._edit((*self.steps[:index], step, *self.steps[index + 1 :]), kind)

    def _edit(self, steps: Steps, kind: Hashable = None, **to: Any) -> None:
        if self._run is not None:
            raise ConfigError("program", None, "stop the program before you change it")
        edited = replace(self._edited, steps=steps, **to)
        if steps:  # refuses what is too long, and puts the loops in order
            program = CellProgram(steps=steps, rounds=edited.rounds, loops=edited.loops)
            edited = replace(edited, loops=program.loops)
        self._history.add(edited, kind)
        self._set(edited)

    def _set(self, edited: _Edited) -> None:
        self._edited = edited
        left = len(edited.steps)
        if self.chosen is not None:
            self.chosen = min(self.chosen, left - 1) if left else None
        self._drop_plan(words.PRESS_PLAN if left else words.CELL_WELCOME)


def _file_of(name: str) -> Path:
    return files.file_of(name, cell_folder())


def _listed() -> tuple[str, ...]:
    return files.names(cell_folder())
