"""State and commands of the Program tab, without viser.

A program is edited, planned as a whole and run. The plan is dropped when the waypoints, the arm's
position, the gripper, the speed limits or the surroundings change. Nothing here waits: slow calls
are futures that ``refresh`` collects. One thread owns a ``ProgramModel``.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import Future
from dataclasses import replace
from itertools import count
from string import ascii_uppercase
from typing import Any

from so101_motion.arm.arm import Arm
from so101_motion.common.clock import Clock
from so101_motion.common.encoder_zeros import EncoderZeros
from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.rig.protocols import GripperLike
from so101_motion.tasks.program import (
    Loop,
    Program,
    ProgramRun,
    Waypoint,
    files,
    rehearse,
    start_program,
)
from so101_motion.tasks.program.rehearsal import stands_at

from ..page.guiding import Guiding
from ..page.history import History
from ..page.playback import Playback
from ..page.saved_files import SavedFiles
from ..page.screen_state import Sentence
from ..page.target_ik import Surroundings, TargetSolver
from . import program_texts as words
from .program_screen import ProgramScreen
from .rehearsal_time import RehearsalTime

ALL, REST, STEP = "all", "from here", "this one"
"""How much of a program is planned and run."""

SAME_JAW = 0.05
"""A jaw that moved by less than this since the program was planned makes no difference [rad]."""


class ProgramModel:
    """State and commands of the Program tab.

    Args:
        q_arm: Where the arm is, as it can be gone to again, shape (5,), [rad].

    Attributes:
        saved_files: The user's programs.
    """

    def __init__(
        self,
        *,
        arm: Arm,
        gripper: GripperLike,
        clock: Clock,
        submit: Callable[[Callable[[], Any]], Future[Any]],
        q_arm: Callable[[], Array],
        q_target: Callable[[], Array],
        set_target: Callable[[Array], None],
        zeros: Callable[[], EncoderZeros | None] = lambda: None,
    ) -> None:
        self._zeros = zeros
        self._arm, self._gripper, self._clock, self._submit = arm, gripper, clock, submit
        self._q_arm, self._q_target, self._aim_at = q_arm, q_target, set_target
        self._program = Program()
        self._history = History(self._program, clock.now)
        self._first = 0
        self._playback = Playback()
        self._chosen: int | None = None
        self._name = ""
        self.saved_files = SavedFiles(files.file_of, files.names, self._tell)
        self._sentence = words.WELCOME
        self._rehearsing: Future[tuple[RehearsalTime, dict[int, float]]] | None = None
        self._timeline: RehearsalTime | None = None
        self._clearances: dict[int, float] = {}
        self._made_for: tuple[object, ...] = ()
        self._run: ProgramRun | None = None
        self._guiding = Guiding(arm, clock, submit)
        self._shown: tuple[object, ...] = ()

    # Waypoints

    def record_arm(self) -> None:
        """Add a waypoint at the arm's place; the jaw stays as it is there."""
        self._record(self._q_arm())

    def record_target(self) -> None:
        """Add a waypoint at the ghost's place; the jaw stays as it is there."""
        self._record(self._q_target())

    def choose(self, index: int) -> None:
        """Select a waypoint for editing, and show the ghost there."""
        if 0 <= index < len(self._program):
            self._chosen = index
            self._aim_at(self._program.waypoints[index].q)

    def rename(self, name: str) -> None:
        """Rename the selected waypoint."""
        self._change(name=name)

    def set_pause(self, seconds: float) -> None:
        """Set the pause at the selected waypoint [s]; the arm then stops there."""
        passed = self._program.waypoints[self._chosen_index()].passes
        self._change(pause=seconds, passes=passed and seconds == 0.0)
        if passed and seconds > 0.0:
            self._sentence = words.PAUSE_STOPS

    def set_aperture(self, aperture: float | None) -> None:
        """Set the jaw's aperture at the selected waypoint, 0 to 1; None to leave it.

        The arm stops at a waypoint where the jaw moves.
        """
        passed = self._program.waypoints[self._chosen_index()].passes
        self._change(aperture=aperture, passes=passed and aperture is None)
        if passed and aperture is not None:
            self._sentence = words.JAW_STOPS

    def set_speed(self, share: float) -> None:
        """Set how fast the selected waypoint is gone to, as a share of the arm's speed."""
        self._change(speed=share)

    def set_passes(self, passes: bool) -> None:
        """Pass the selected waypoint without a stop, pause and jaw; or stop there."""
        index = self._chosen_index()
        if not passes:
            self._change(passes=False)
            return
        before = self._program.waypoints[index]
        self._change(passes=True, pause=0.0, aperture=None)
        self._sentence = words.passing(before, is_last=self._program.stops_at(index))

    def move(self, by: int) -> None:
        """Move the selected waypoint earlier (-1) or later (1)."""
        index = self._chosen_index()
        self.reorder(index, index + by)

    def reorder(self, index: int, to: int) -> None:
        """Put a waypoint at another place, and select it."""
        if min(index, to) >= 0 and max(index, to) < len(self._program):
            self._edit(self._program.moved(index, to))
            self._chosen = to

    def remove(self) -> None:
        """Remove the selected waypoint."""
        index = self._chosen_index()
        self._edit(self._program.without(index))

    def duplicate(self) -> None:
        """Add the selected waypoint once more behind itself."""
        index = self._chosen_index()
        again = replace(self._program.waypoints[index], name=self._next_letter())
        self._edit(self._program.with_waypoint(again).moved(len(self._program), index + 1))
        self._chosen = index + 1

    def take_place(self) -> None:
        """Put the selected waypoint to where the arm is."""
        self._change(q=self._q_arm())

    def undo(self) -> None:
        """Undo the last edit."""
        self._set(self._history.undo())

    def redo(self) -> None:
        """Redo what was undone last."""
        self._set(self._history.redo())

    @property
    def can_undo(self) -> bool:
        """Whether there is an edit to undo."""
        return self._history.can_undo and self._run is None

    @property
    def can_redo(self) -> bool:
        """Whether one was undone."""
        return self._history.can_redo and self._run is None

    def set_rounds(self, rounds: int | None) -> None:
        """Set the number of rounds; None for endless."""
        self._edit(self._program.with_rounds(rounds), "rounds")

    def set_loop(self, first: int, last: int, times: int) -> None:
        """Repeat the waypoints from ``first`` to ``last`` (indices) so many times in a row."""
        self._edit(self._program.with_loop(Loop(first=first, last=last, times=times)))

    def end_loop(self) -> None:
        """Remove the inner one of the loops around the selected waypoint."""
        around = self._program.loops_around(self._chosen_index())
        if not around:
            raise ConfigError("loop", None, "the chosen waypoint is in no loop")
        self._edit(self._program.without_loop(around[-1]))

    # Files

    def call(self, name: str) -> None:
        """Set the name for saving."""
        self._name = name

    def save(self) -> None:
        """Save the program under its name; replaces one of that name."""
        if not self._program.waypoints:
            raise ConfigError("program", None, "record a waypoint first")
        with self.saved_files.changing(self._name) as file:
            files.write(self._program, file, self._zeros())
        self._name = file.stem
        self._sentence = words.saved(file)

    def load(self, name: str) -> None:
        """Load the program ``name``; nothing moves."""
        program = files.read(files.file_of(name), self._zeros())
        self._edit(program)
        self._name, self._chosen = name, 0 if program.waypoints else None
        self._sentence = words.loaded(name, len(program))

    def delete(self, name: str) -> None:
        """Delete the file of the program ``name``; the edited program stays."""
        with self.saved_files.changing(name):
            files.delete(name)
        self._sentence = words.deleted(name)

    def clear(self) -> None:
        """Start a new program."""
        self._edit(Program())
        self._name, self._chosen = "", None
        self._sentence = words.WELCOME

    # Guiding, planning, running

    def guide(self) -> None:
        """Start hand guiding for a limited time. Hold and Stop end it as well."""
        if self._can_guide():
            self._guiding.start()

    def plan(self, part: str = ALL) -> None:
        """Plan the program, or a part of it; nothing moves.

        Args:
            part: ``ALL``, ``REST`` from the selected waypoint on, or ``STEP``: that one alone.
        """
        if self._can_plan():
            program, arm, gripper = self._program, self._arm, self._gripper
            self._first = 0 if part == ALL else self._chosen_index()
            if part != ALL:
                last = self._first + 1 if part == STEP else len(program)
                program = program.part(self._first, last)
            self._made_for = things_around(self._arm)

            def plan_all() -> tuple[RehearsalTime, dict[int, float]]:
                timeline = RehearsalTime(rehearse(arm, gripper, program), gripper.angle_of)
                solver = TargetSolver.load(Surroundings(arm.scene, arm.range))
                return timeline, timeline.clearances(solver.clearance)

            self._rehearsing = self._submit(plan_all)
            self._sentence = words.PLANNING

    def run(self) -> None:
        """Run the program as it was planned."""
        if self._timeline is not None and self._can_run():
            rehearsal = self._timeline.rehearsal
            self._run = start_program(self._arm, self._gripper, self._clock, rehearsal)

    def preview(self, t: float) -> None:
        """Show the ghost ``t`` seconds into the rehearsal."""
        self._playback.seek(t)

    def play(self, rate: float) -> None:
        """Play the rehearsal with the ghost at ``rate`` times real time, or pause."""
        if self._timeline is not None:
            self._playback.play(rate)

    def report(self, error: BaseException) -> None:
        """Show that a command failed."""
        self._sentence = words.ended(error)

    # Updates

    def refresh(self) -> bool:
        """Take in changes since the last call; return whether there is anything new to show."""
        self._watch_hand()
        self._collect_rehearsal()
        self._watch_plan()
        self._collect_run()
        self._playback.advance(self._clock.now())
        self.saved_files.look_again(self._clock.now())
        run = self._run
        seen = (
            self._playback.t,
            self._status(),
            self._arm.state.mode,
            run and run.where,
            self._timeline,
            self._program,
            self.saved_files.names,
        )
        before, self._shown = self._shown, seen
        pairs = zip(seen, before, strict=False)
        return not before or any(new is not old and new != old for new, old in pairs)

    def screen(self) -> ProgramScreen:
        """Everything to be shown now."""
        return ProgramScreen(
            program=self._program,
            chosen=self._chosen,
            name=self._name,
            sentence=self._status(),
            timeline=self._timeline,
            clearances=self._clearances,
            run=self._run,
            guided=self._guiding.is_on,
            can_edit=self._run is None,
            can_plan=self._can_plan(),
            can_run=self._can_run(),
            can_guide=self._can_guide(),
            first=self._first,
            t=self._playback.t,
        )

    # Helpers

    def _status(self) -> Sentence:
        if self._run is not None:
            return words.running(self._run, self._first)
        if self._guiding.is_on:
            return words.guided(self._guiding.left)
        return self._sentence

    def _tell(self, sentence: Sentence) -> None:
        self._sentence = sentence

    def _record(self, q: Array) -> None:
        number = len(self._program) + 1
        waypoint = Waypoint(name=self._next_letter(), q=q)
        self._edit(self._program.with_waypoint(waypoint))
        self._chosen = number - 1
        self._sentence = words.recorded(number)

    def _next_letter(self) -> str:
        return next_letter(waypoint.name for waypoint in self._program.waypoints)

    def _chosen_index(self) -> int:
        if self._chosen is None:
            raise ConfigError("waypoint", None, "record a waypoint first")
        return self._chosen

    def _change(self, **to: Any) -> None:
        index = self._chosen_index()
        changed = replace(self._program.waypoints[index], **to)
        self._edit(self._program.with_changed(index, changed), (index, *to))

    def _edit(self, program: Program, kind: Hashable = None) -> None:
        if self._run is not None:
            raise ConfigError("program", None, "stop the program before you change it")
        self._history.add(program, kind)
        self._set(program)

    def _set(self, program: Program) -> None:
        self._program = program
        if self._chosen is not None:
            left = len(program)
            self._chosen = min(self._chosen, left - 1) if left else None
        self._drop_plan(words.PRESS_PLAN if program.waypoints else words.WELCOME)

    def _drop_plan(self, sentence: Sentence) -> None:
        self._timeline = self._rehearsing = None
        self._sentence = sentence

    def _can_plan(self) -> bool:
        return (
            bool(self._program.waypoints)
            and self._run is None
            and self._rehearsing is None
            and self._arm.state.mode is Mode.HOLDING
        )

    def _can_run(self) -> bool:
        return (
            self._timeline is not None
            and self._run is None
            and self._arm.state.mode is Mode.HOLDING
            and same_things(things_around(self._arm), self._made_for)
        )

    def _can_guide(self) -> bool:
        return self._run is None and self._guiding.can_start

    def _watch_hand(self) -> None:
        try:
            if self._guiding.refresh():
                self._sentence = words.HELD_AGAIN
        except Exception as error:  # in other words: what was submitted failed
            self.report(error)

    def _collect_rehearsal(self) -> None:
        if self._rehearsing is None or not self._rehearsing.done():
            return
        rehearsing, self._rehearsing = self._rehearsing, None
        error = rehearsing.exception()
        if error is not None:
            self.report(error)
            return
        self._timeline, self._clearances = rehearsing.result()
        self._playback.load(self._timeline.duration)
        is_whole = len(self._timeline.rehearsal.program.loops) == len(self._program.loops)
        self._sentence = words.PLANNED if is_whole else words.PLANNED_PART

    def _watch_plan(self) -> None:
        if self._timeline is None or self._run is not None:
            return
        rehearsal, state = self._timeline.rehearsal, self._arm.state
        if not stands_at(rehearsal.q_start, state.q_ref):
            self._drop_plan(words.ARM_MOVED)
        elif abs(rehearsal.q_jaw_start - state.q_jaw_ref) > SAME_JAW:
            self._drop_plan(words.JAW_MOVED)
        elif not same_things(things_around(self._arm), self._made_for):
            self._drop_plan(words.THINGS_CHANGED)

    def _collect_run(self) -> None:
        if self._run is None or not self._run.future.done():
            return
        run, self._run = self._run, None
        error = run.future.exception()
        self._drop_plan(words.done(run) if error is None else words.ended(error))


def next_letter(taken: Iterable[str]) -> str:
    """The first free name of a waypoint, kept when the order changes: A to Z, then A2."""
    known = set(taken)
    names = (f"{letter}{lap if lap > 1 else ''}" for lap in count(1) for letter in ascii_uppercase)
    return next(name for name in names if name not in known)


def things_around(arm: Arm) -> tuple[object, ...]:
    """What an arm's plans depend on besides its position."""
    return (arm.scene, arm.range, arm.speed, arm.acceleration)


def same_things(things: tuple[object, ...], others: tuple[object, ...]) -> bool:
    """Whether scenes and ranges are identical objects, and figures equal."""
    return len(things) == len(others) and all(
        one is other or (isinstance(one, float) and one == other)
        for one, other in zip(things, others, strict=True)
    )
