"""State and commands of the Program tab, without viser.

The plan is dropped when the steps, an arm's position, a gripper, the speed limits or the
surroundings change. Nothing here waits: slow calls are futures that ``refresh`` collects. One
thread owns a ``ProgramModel``.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace
from itertools import count
from pathlib import Path
from string import ascii_uppercase
from typing import Any

import numpy as np

from so101_motion.common.errors import ConfigError, MotionError
from so101_motion.common.geometry import Array
from so101_motion.common.modes import HELD, Mode
from so101_motion.common.units import to_rad
from so101_motion.tasks.picking import NO_ITEM
from so101_motion.tasks.program import (
    ARM,
    Arms,
    Loop,
    Program,
    ProgramRun,
    Solo,
    Waypoint,
    files,
    rehearse,
    start_program,
)
from so101_motion.tasks.program.files import ZerosOfArms
from so101_motion.tasks.program.program import Step
from so101_motion.tasks.program.rehearsal import stands_at

from ..page import texts
from ..page.causes import Causes, same_things, things_around
from ..page.guiding import Guiding
from ..page.history import History, SavedFiles
from ..page.plan_view import Playback
from ..page.screen_state import Sentence, Tone
from ..page.target_ik import TargetSolver
from ..view_model import ViewModel
from . import program_texts as words
from .rehearsal_time import RehearsalTime

ALL, REST, STEP = "all", "from here", "this one"  # how much of a program is planned and run

STILL = to_rad(0.1)  # an arm that is to be slower than this stands still [rad/s]; chosen

SAME_JAW = 0.05
"""A jaw that moved by less than this since the program was planned makes no difference [rad]."""


class ProgramModel:
    """State and commands of the Program tab.

    Args:
        pages: Place and target of each arm, by its name.
        zeros: Tells the zeros of the arms' calibrations.

    Attributes:
        called: What a step is called, of one arm or of several.
        chosen: Index of the step that is edited; None without one.
        name: What the program is called, when it is saved or was loaded.
        playback: How far into the rehearsal the ghosts stand.
        timeline: The plan over time, as long as it is valid; else None.
        run: What is being run; else None.
    """

    def __init__(
        self,
        arms: Arms,
        pages: Mapping[str, ViewModel],
        submit: Callable[[Callable[[], Any]], Future[Any]],
        zeros: Callable[[], ZerosOfArms] | None = None,
    ) -> None:
        self._zeros = zeros or (lambda: dict.fromkeys(pages))
        self._arms, self.pages, self._submit = arms, pages, submit
        self._is_one = isinstance(arms, Solo)
        self._welcome = words.welcome(is_one=self._is_one)
        self._now = arms.clock.now
        self.program = Program()
        self.history = History(self.program, self._restore, self._now)
        self.chosen: int | None = None
        folder = files.folder if isinstance(arms, Solo) else files.cell_folder
        self._file_of: Callable[[str], Path] = lambda name: files.file_of(name, folder())
        self.name = ""
        self.saved_files = SavedFiles(self._file_of, lambda: files.names(folder()), self.tell)
        self.timeline: RehearsalTime | None = None
        self.playback = Playback()
        self._sentence = self._welcome
        self._planning: Future[RehearsalTime] | None = None
        self._made_for: tuple[object, ...] = ()
        self.run: ProgramRun | None = None
        self.run_speed = 1.0
        self._guiding = {
            name: Guiding(each.arm, each.clock, submit) for name, each in arms.members.items()
        }
        self._causes = Causes(each.arm for each in arms.members.values())
        self._shown: tuple[object, ...] = ()

    # Steps

    def record_arms(self, names: Sequence[str] | None = None) -> None:
        """Add a step in which these arms, or all, go to where they stand now; their jaws stay."""
        self._record({name: self._standing(name) for name in names or self.pages})

    def _standing(self, name: str) -> Array:
        """Where an arm stands, shape (5,), [rad]; ``MotionError`` while it moves."""
        if name in self._moving:
            raise MotionError(f"{name or 'the arm'} moves; record it when it stands still")
        return self.pages[name].q_arm

    def record_targets(self, names: Sequence[str] | None = None) -> None:
        self._record({name: self.pages[name].target.q for name in names or self.pages})

    def wait(self) -> None:
        """Add a step after the selected one in which its arms stay there for a second."""
        index = self._chosen_index()
        stays = {
            name: replace(each, name="wait", pause=1.0, aperture=None, passes=False)
            for name, each in self._step.items()
        }
        self._edit(self.program.with_step(stays).moved(len(self.program), index + 1))
        self.chosen = index + 1

    def pick(self) -> None:
        """Add a waypoint where the arm stands, at which it picks an item of its scene."""
        items = self._arms.members[ARM].arm.scene.items
        if not items:
            raise ConfigError("item", None, NO_ITEM)
        self.record_arms()
        self._change(ARM, item=items[0].name)

    def choose(self, index: int) -> None:
        if 0 <= index < len(self.program):
            self.chosen = index
            for name, each in self.program.steps[index].items():
                if name in self.pages:
                    self.pages[name].set_target_joints(each.q)

    def waypoint(self, name: str) -> Waypoint | None:
        """What an arm does in the selected step; None for nothing, or while it cannot be edited."""
        can_edit = self.chosen is not None and self.run is None
        return self._step.get(name) if can_edit else None

    def set(self, name: str, /, **to: Any) -> None:
        """Change what an arm does in the selected step; what needs a stop there ends passing.

        What is given is named as in ``Waypoint``.
        """
        before, index = self.waypoint(name), self.chosen
        passed = before is not None and before.passes
        if to.get("passes"):
            to |= {"pause": 0.0, "aperture": None, "item": None, "place": ""}
        elif to.get("item") == "":
            to |= {"item": None, "place": ""}
        stops = to.get("pause") or to.get("item") or to.get("aperture") is not None
        self._change(name, **to, **({"passes": False} if passed and stops else {}))
        if to.get("passes") and before is not None and index is not None:
            self.tell(words.passing(before, stops=self.program.stops_at(index)))
        elif passed and stops and "item" not in to:
            self.tell(words.PAUSE_STOPS if "pause" in to else words.JAW_STOPS)

    def take_place(self, name: str) -> None:
        """Let an arm go to where it stands now in the selected step, beside the others."""
        self._take(name, self._standing(name))

    def take_target(self, name: str) -> None:
        self._take(name, self.pages[name].target.q)

    def leave_out(self, name: str) -> None:
        index = self._chosen_index()
        rest = {key: each for key, each in self._step.items() if key != name}
        if not rest:
            raise ConfigError("step", index + 1, "has no other arm; delete it instead")
        self._edit(self.program.with_changed(index, rest))

    def move(self, by: int) -> None:
        """Move the selected step earlier (-1) or later (1)."""
        index = self._chosen_index()
        self.reorder(index, index + by)

    def reorder(self, index: int, to: int) -> None:
        if min(index, to) >= 0 and max(index, to) < len(self.program):
            self._edit(self.program.moved(index, to))
            self.chosen = to

    def remove(self) -> None:
        self._edit(self.program.without(self._chosen_index()))

    def duplicate(self) -> None:
        index, letter = self._chosen_index(), self._next_letter()
        again = {name: replace(each, name=letter) for name, each in self._step.items()}
        self._edit(self.program.with_step(again).moved(len(self.program), index + 1))
        self.chosen = index + 1

    def set_rounds(self, rounds: int | None) -> None:
        """Set the number of rounds; None for endless."""
        self._edit(self.program.with_rounds(rounds), "rounds")

    def set_loop(self, first: int, last: int, times: int) -> None:
        """Repeat the steps from ``first`` to ``last`` (indices) so many times in a row."""
        self._edit(self.program.with_loop(Loop(first=first, last=last, times=times)))

    def end_loop(self) -> None:
        around = self.program.loops_around(self._chosen_index())
        if not around:
            raise ConfigError("loop", None, "the chosen step is in no loop")
        self._edit(self.program.without_loop(around[-1]))

    # Files

    def save(self) -> None:
        """Save the program under its name; replaces one of that name."""
        if not self.program.steps:
            raise ConfigError("program", None, "record a waypoint first")
        with self.saved_files.changing(self.name) as file:
            files.write(self.program, file, self._zeros())
        self.name = file.stem
        self._sentence = words.saved(file)

    def load(self, name: str) -> None:
        program = files.read(self._file_of(name), self._zeros())
        self._edit(program)
        self.name, self.chosen = name, 0 if program.steps else None
        self._sentence = words.loaded(name, len(program))

    def insert(self, name: str) -> None:
        """Insert the saved program ``name`` after the selected step."""
        other, at = files.read(self._file_of(name), self._zeros()), self._chosen_index() + 1
        self._edit(self.program.with_program(other, at))
        self.chosen = at + len(other) - 1

    def set_run_speed(self, share: float) -> None:
        """Run at this share of the planned speed; a run under way from its next stop on."""
        self.run_speed = share
        if self.run is not None:
            self.run.speed = share

    def delete(self, name: str) -> None:
        """Delete the file of the program ``name``; the edited program stays."""
        with self.saved_files.changing(name) as file:
            files.delete(name, file.parent)
        self._sentence = texts.deleted(name)

    def clear(self) -> None:
        self._edit(Program())
        self.name, self.chosen = "", None
        self._sentence = self._welcome

    # Guiding, planning, running

    def guide(self) -> None:
        """Start hand guiding of all arms for a limited time. Hold and Stop end it as well."""
        if self.run is None:
            for each in self._guiding.values():
                each.start()

    def plan(self, part: str = ALL) -> None:
        """Plan ``ALL``, the ``REST`` from the selected step on, or that ``STEP`` alone."""
        if self.can_plan:
            arms, program = self._arms, self.program
            if part != ALL:
                first = self._chosen_index()
                program = program.part(first, first + 1 if part == STEP else len(program))
            self._made_for = self._things()

            def plan_all() -> RehearsalTime:
                rehearsal = rehearse(arms, program)
                if not isinstance(arms, Solo):
                    return RehearsalTime(rehearsal, arms)
                solver = TargetSolver(arms.arm.scene, arms.arm.range)
                return RehearsalTime(rehearsal, arms, solver.clearance)

            self._planning = self._submit(plan_all)
            self._sentence = words.PLANNING

    def start(self) -> None:
        if self.timeline is not None and self.can_run:
            self.run = start_program(self._arms, self.timeline.rehearsal, speed=self.run_speed)

    def report(self, error: BaseException) -> None:
        self._sentence = words.ended(error, is_one=self._is_one)

    def tell(self, sentence: Sentence) -> None:
        self._sentence = sentence

    # What is shown

    @property
    def sentence(self) -> Sentence:
        if self.run is not None:
            return words.running(self.run)
        if self._moving:
            return words.MOVING
        guided = self.guided
        for name, each in self._arms.members.items():
            blocked, is_limp = texts.blocked(each.arm.state), each.arm.state.mode is Mode.LIMP
            can_record = name in guided or (is_limp and self._sentence is not words.PRESS_PLAN)
            if blocked is not None and not can_record:
                return self._named(name, blocked)
        if guided:
            left = [each.left for each in self._guiding.values() if each.left is not None]
            return words.guided(guided, min(left, default=None))
        return self._sentence

    @property
    def guided(self) -> list[str]:
        return [name for name, each in self._guiding.items() if each.is_on]

    @property
    def active(self) -> int | None:
        if self.run is not None:
            return self.run.where.index + self.run.program.before
        timeline = self.timeline
        if timeline is None or not 0.0 < self.playback.t < timeline.duration:
            return None
        return timeline.at(self.playback.t)[0]

    @property
    def can_plan(self) -> bool:
        return bool(self.program.steps) and self._planning is None and self._are_ready

    @property
    def can_run(self) -> bool:
        is_planned = self.timeline is not None and self._are_ready
        return is_planned and same_things(self._things(), self._made_for)

    @property
    def can_record(self) -> bool:
        modes = (each.arm.state.mode for each in self._arms.members.values())
        return self.run is None and not self._moving and Mode.FAULT not in modes

    @property
    def _moving(self) -> list[str]:
        """The arms that move, but not in a run of this program."""
        if self.run is not None:
            return []
        states = {name: each.arm.state for name, each in self._arms.members.items()}
        return [
            name
            for name, state in states.items()
            if state.mode in HELD and np.abs(state.qd_ref).max() > STILL
        ]

    @property
    def _are_ready(self) -> bool:
        holding = (each.arm.state.mode is Mode.HOLDING for each in self._arms.members.values())
        return self.run is None and all(holding)

    def refresh(self) -> bool:
        self._watch_hands()
        self._collect_plan()
        self._watch_plan()
        self._collect_run()
        if self._causes.have_changed() and self._sentence.tone is Tone.BAD:
            self._sentence = words.PRESS_PLAN if self.program.steps else self._welcome
        self.playback.advance(self._now())
        self.saved_files.look_again(self._now())
        seen = (
            self.playback.t,
            self.sentence,
            *(each.arm.state.mode for each in self._arms.members.values()),
            *(each.arm.scene for each in self._arms.members.values()),
            self.run and self.run.where,
            self.run_speed,
            self.chosen,
            self.timeline,
            self.program,
            self.saved_files.names,
        )
        before, self._shown = self._shown, seen
        return not before or seen != before

    # Helpers

    def _watch_hands(self) -> None:
        for name, each in self._guiding.items():
            try:
                if each.refresh():
                    self._sentence = self._named(name, words.HELD_AGAIN)
            except Exception as error:  # in other words: what was submitted failed
                self.report(error)

    def _collect_plan(self) -> None:
        if self._planning is None or not self._planning.done():
            return
        planning, self._planning = self._planning, None
        error = planning.exception()
        if error is not None:
            self.report(error)
            return
        self.timeline = planning.result()
        self.playback.load(self.timeline.duration)
        is_whole = len(self.timeline.rehearsal.program.loops) == len(self.program.loops)
        self._sentence = words.PLANNED if is_whole else words.PLANNED_PART

    def _watch_plan(self) -> None:
        if self.timeline is None or self.run is not None:
            return
        stands = self._arms.stands()
        for name, planned in self.timeline.rehearsal.stands.items():
            if not stands_at(planned.q, stands[name].q):
                self._drop_plan(self._named(name, words.ARM_MOVED))
            elif abs(planned.q_jaw - stands[name].q_jaw) > SAME_JAW:
                self._drop_plan(self._named(name, words.JAW_MOVED))
        if self.timeline is not None and not same_things(self._things(), self._made_for):
            self._drop_plan(words.THINGS_CHANGED)

    def _collect_run(self) -> None:
        if self.run is None or not self.run.future.done():
            return
        run, self.run = self.run, None
        error = run.future.exception()
        said = words.done(run) if error is None else words.ended(error, is_one=self._is_one)
        self._drop_plan(said)

    def _named(self, name: str, sentence: Sentence) -> Sentence:
        return sentence if name == ARM else texts.named(name, sentence)

    def _things(self) -> tuple[object, ...]:
        members = self._arms.members.values()
        return tuple(each for member in members for each in things_around(member.arm))

    def _record(self, goals: Mapping[str, Array]) -> None:
        step = {name: Waypoint(name=self._next_letter(), q=q) for name, q in goals.items()}
        self._edit(self.program.with_step(step))
        self.chosen = len(self.program) - 1
        self._sentence = words.recorded(len(self.program))

    def _next_letter(self) -> str:
        return next_letter(each.name for step in self.program.steps for each in step.values())

    def _chosen_index(self) -> int:
        if self.chosen is None:
            raise ConfigError("waypoint", None, "record a waypoint first")
        return self.chosen

    @property
    def _step(self) -> Step:
        return self.program.steps[self._chosen_index()]

    def _change(self, name: str, /, **to: Any) -> None:
        waypoint = self._step.get(name)
        if waypoint is not None:
            self._put(name, replace(waypoint, **to), (self.chosen, name, *to))

    def _take(self, name: str, q: Array) -> None:
        if name in self._step:
            self._change(name, q=q)
        else:
            self._put(name, Waypoint(name=self._next_letter(), q=q))

    def _put(self, name: str, waypoint: Waypoint, kind: Hashable = None) -> None:
        step = {**self._step, name: waypoint}
        self._edit(self.program.with_changed(self._chosen_index(), step), kind)

    def _edit(self, program: Program, kind: Hashable = None) -> None:
        self._restore(program)
        self.history.add(program, kind)

    def _restore(self, program: Program, _words: str = "") -> None:
        if self.run is not None:
            raise ConfigError("program", None, "stop the program before you change it")
        self.program = program
        if self.chosen is not None:
            left = len(program)
            self.chosen = min(self.chosen, left - 1) if left else None
        self._drop_plan(words.PRESS_PLAN if program.steps else self._welcome)

    def _drop_plan(self, sentence: Sentence) -> None:
        self.timeline = self._planning = None
        self._sentence = sentence


def next_letter(taken: Iterable[str]) -> str:
    """The first free name of a waypoint, kept when the order changes: A to Z, then A2."""
    known = set(taken)
    names = (f"{letter}{lap if lap > 1 else ''}" for lap in count(1) for letter in ascii_uppercase)
    return next(name for name in names if name not in known)
