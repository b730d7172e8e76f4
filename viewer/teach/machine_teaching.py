"""Record a path by hand on a running machine and replay it, without viser.

The machine's own module records, saves, plans and moves; this sends it the requests and shows what
it answers. Nothing here waits: requests are futures that ``refresh`` collects. One thread owns a
``MachineTeaching``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from itertools import count
from math import isfinite
from typing import Any, NamedTuple, Protocol

import numpy as np

from so101_motion.arm.arm import Arm
from so101_motion.arm.motion_handle import Motion
from so101_motion.common.clock import Clock
from so101_motion.common.errors import MachineRefused, MachineUnavailable, MotionError, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.state import JointState
from so101_motion.rig.protocols import ArmConnection
from so101_motion.tasks.program.rehearsal import stands_at

from ..page import texts
from ..page.guiding import GUIDED_FOR
from ..page.screen_state import Sentence, Tone
from .machine_deletions import MachineDeletions
from .teaching import ARM_MOVED, BEGINS, DONE, PLAN, PLANNING, WELCOME, Doing, holds_again, planned

MOST_NAMES = 500
"""How many saved paths are shown; chosen, more than a person can choose from."""

LONGEST_NAME = 80
"""The longest name of a path that our module takes."""

MOST_POINTS = 1000
"""Of how many points the line that is drawn may be; chosen, more than our module sends."""

CANNOT = Sentence(
    text="This arm's module on the machine cannot record or replay a path.", tone=Tone.WARM
)
ENDS = Sentence(text="The machine saves the path …", tone=Tone.WARM)
_SOFT = (Mode.GUIDING, Mode.LIMP)


class TeachingMachine(Protocol):
    """What is needed of a machine; ``MachineRig`` describes each in full."""

    @property
    def arm(self) -> Arm:
        """Its arm."""

    @property
    def arm_name(self) -> str:
        """The arm's name on the machine."""

    @property
    def clock(self) -> Clock:
        """The clock of the arm's states."""

    @property
    def connection(self) -> ArmConnection:
        """Whether it can be reached."""

    def do_command(self, resource: str, command: Mapping[str, Any]) -> Mapping[str, Any]:
        """Send a request; returns the answer."""

    def start_request(self, command: Mapping[str, Any]) -> Motion:
        """Send a request that moves the arm."""

    def refresh(self) -> JointState:
        """Read the machine's state now."""


class _Recording(NamedTuple):
    name: str
    since: float | None  # None if another client has begun it


class _Question(NamedTuple):
    answer: Future[Mapping[str, Any]]
    take: Callable[[Mapping[str, Any]], None]
    refused: Callable[[], None]


class MachineTeaching:
    """Records, plans and replays one path at a time on a machine, which also keeps the paths.

    Args:
        rig: The machine.
        submit: Runs a slow call on another thread.

    Attributes:
        line: Where the tool is along the chosen path; None before it was planned.
        saved_files: Undoes deletions. A path is saved as soon as its recording ends.
        doing: What is going on.
        sentence: What to know or to do now.
        name: What the next path will be called; a number is added if that name is taken.
        names: The saved paths.
        chosen: The path to replay; empty for none.
    """

    def __init__(
        self, rig: TeachingMachine, submit: Callable[[Callable[[], Any]], Future[Any]]
    ) -> None:
        self._rig, self._submit = rig, submit
        self._question: _Question | None = None
        self._listing: tuple[Future[Mapping[str, Any]], int] | None = None
        self._asked = 0  # how many requests were sent that change what is listed
        self._list_due = True
        self._mode: Mode | None = None
        self._recording: _Recording | None = None
        self._motion: Motion | None = None
        self._q_plan = rig.arm.state.q_ref
        self._is_planned = False
        self._can_teach = False
        self.saved_files = MachineDeletions(self._ask_if_idle, self._take_change)
        self.doing = Doing.NOTHING
        self.sentence = WELCOME
        self.name = ""
        self.names: tuple[str, ...] = ()
        self.chosen = ""
        self.line: Array | None = None

    # Recording

    @property
    def can_record(self) -> bool:
        """Whether the arm may be led by hand now."""
        allowed = (Mode.HOLDING, *_SOFT)
        return self._can_teach and self._is_idle and self._rig.arm.state.mode in allowed

    def record(self) -> None:
        """Let the arm yield to a hand, and record its path; a path that is there already stays."""
        if self.can_record:
            name = self._free(self.name.strip() or "path")
            command = {"command": "record_path", "name": name, "enabled_for": GUIDED_FOR}
            self.doing, self.sentence = Doing.BEGINNING, BEGINS
            self._ask(command, self._take_beginning)

    def end_recording(self) -> None:
        """End the recording; the arm holds where it is."""
        if self.doing is Doing.RECORDING:
            self._end(holds=True)

    # Replay

    @property
    def can_plan(self) -> bool:
        """Whether a replay can be planned now."""
        holds = self._rig.arm.state.mode is Mode.HOLDING
        return bool(self.chosen) and self._can_teach and self._is_idle and holds

    @property
    def can_run(self) -> bool:
        """Whether the plan can be run now."""
        return self.can_plan and self._is_planned

    def plan(self) -> None:
        """Let the machine plan the replay; nothing moves."""
        if self.can_plan:
            self._drop_plan()
            self.doing, self.sentence = Doing.PLANNING, PLANNING
            self._q_plan = self._rig.arm.state.q_ref
            self._ask({**self._replay(), "outline": True}, self._take_plan)

    def run(self) -> None:
        """Let the machine replay the path; it plans once more from where the arm is."""
        if self.can_run:
            self._motion = self._rig.start_request(self._replay())
            self.doing, self.sentence = Doing.REPLAYING, texts.MOVING

    # Saved paths

    def call(self, name: str) -> None:
        """Set the name of the next path."""
        self.name = name

    def load(self, name: str) -> None:
        """Choose a saved path; nothing moves."""
        if name in self.names and self._is_idle:
            self._choose(name)
            self.name = name
            self.sentence = Sentence(text=f'"{name}" is chosen. {PLAN.text}', tone=Tone.GOOD)

    def delete(self, name: str) -> None:
        """Delete a saved path on the machine."""
        if name in self.names:
            self.saved_files.delete(name)

    def report(self, error: BaseException) -> None:
        """Show that a command failed."""
        self.sentence = texts.ended(error)
        if isinstance(error, MachineRefused):  # without the request's name, which nobody typed
            text = f"The machine says: {texts.capital(error.reason)}"
            self.sentence = Sentence(text=text, tone=Tone.BAD)

    # Updates

    def refresh(self) -> None:
        """Take in what has happened since the last call."""
        self._collect_answer()
        self._collect_run()
        self._collect_list()
        state, is_up = self._rig.arm.state, self._rig.connection.is_up
        if state.mode is not self._mode:
            # Another client may have begun, ended or deleted a path, or the machine is back.
            self._list_due |= self._mode in (*_SOFT, Mode.FAULT) or state.mode in _SOFT
            self._mode = state.mode
        if self.doing is Doing.RECORDING:
            self._show_recording()
            # A report of the mode may be late, so the machine is asked whether it still records.
            self._list_due |= state.mode not in _SOFT
        may_list = self._question is None and self.doing in (Doing.NOTHING, Doing.RECORDING)
        if self._list_due and is_up and may_list and self._listing is None:
            self._list_due = False
            answer = self._submit(lambda: self._send({"command": "list_paths"}))
            self._listing = answer, self._asked
        if self._is_planned and self._is_idle and not stands_at(self._q_plan, state.q_ref):
            self._drop_plan()
            self.sentence = ARM_MOVED

    # Helpers

    @property
    def _is_idle(self) -> bool:
        return self.doing is Doing.NOTHING and self._question is None

    def _send(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        return self._rig.do_command(self._rig.arm_name, command)

    def _ask(
        self,
        command: Mapping[str, Any],
        take: Callable[[Mapping[str, Any]], None],
        refused: Callable[[], None] = lambda: None,
    ) -> None:
        """Send a request; ``take`` gets its answer once the state after it has been read."""

        def ask() -> Mapping[str, Any]:
            answer = self._send(command)
            self._rig.refresh()
            return answer

        self._put(ask, take, refused)

    def _ask_if_idle(
        self,
        command: Mapping[str, Any],
        take: Callable[[Mapping[str, Any]], None],
        *,
        refused: Callable[[], None],
    ) -> None:
        if self._is_idle:
            self._ask(command, take, refused)

    def _put(
        self,
        ask: Callable[[], Mapping[str, Any]],
        take: Callable[[Mapping[str, Any]], None],
        refused: Callable[[], None] = lambda: None,
    ) -> None:
        self._asked += 1
        self._question = _Question(self._submit(ask), take, refused)

    def _replay(self) -> dict[str, Any]:
        return {"command": "replay_path", "name": self.chosen}

    def _end(self, *, holds: bool) -> None:
        def end() -> Mapping[str, Any]:
            try:
                return self._send({"command": "end_path"})
            finally:
                if holds:
                    self._rig.arm.set_manual(False)

        self.doing, self.sentence, self._recording = Doing.ENDING, ENDS, None
        self._put(end, self._take_path)

    def _free(self, name: str) -> str:
        taken = set(self.names)
        numbered = (name if k == 1 else f"{name} {k}" for k in count(1))
        return next(each for each in numbered if each not in taken)

    def _choose(self, name: str) -> None:
        self.chosen, self.line = name, None
        self._drop_plan()

    def _drop_plan(self) -> None:
        self._is_planned = False

    def _show_recording(self) -> None:
        assert self._recording is not None  # set with what is being done
        name, since = self._recording
        text, left = f'Recording "{name}"', None
        if since is not None:
            took = self._rig.clock.now() - since
            text, left = f"{text}, {took:.0f} s", GUIDED_FOR - took
        text = f"{text}. Guide the arm by hand.{holds_again(left)}"
        self.sentence = Sentence(text=text, tone=Tone.WARM)

    # Answers

    def _collect_answer(self) -> None:
        if self._question is None or not self._question.answer.done():
            return
        (answer, take, refused), self._question = self._question, None
        self.doing, self._list_due = Doing.NOTHING, True
        try:
            take(answer.result())
        except So101Error as error:
            if isinstance(error, MachineRefused):
                refused()
            self.report(error)

    def _collect_run(self) -> None:
        if self._motion is None or not self._motion.future.done():
            return
        motion, self._motion, self.doing = self._motion, None, Doing.NOTHING
        self._drop_plan()
        error = motion.future.exception()
        if error is None:
            self.sentence = DONE
        else:
            self.report(error)

    def _collect_list(self) -> None:
        if self._listing is None or not self._listing[0].done():
            return
        (answer, asked), self._listing = self._listing, None
        error = answer.exception()
        if error is None:
            self._take_list(answer.result(), is_new=asked == self._asked)
        elif isinstance(error, MachineUnavailable):
            self._list_due = True
        else:
            self._take_list({}, is_new=True)

    def _take_list(self, answer: Mapping[str, Any], *, is_new: bool) -> None:
        paths, recording = answer.get("paths"), answer.get("recording")
        self._can_teach = isinstance(paths, list)
        if not isinstance(paths, list):
            self.sentence = CANNOT
            return
        if self.sentence is CANNOT:
            self.sentence = WELCOME
        listed = (each.get("name") for each in paths[:MOST_NAMES] if isinstance(each, Mapping))
        self.names = tuple(
            each for each in listed if isinstance(each, str) and 0 < len(each) <= LONGEST_NAME
        )
        if self.chosen not in self.names:
            self._choose("")
        if is_new and isinstance(recording, str):
            self._follow_recording(recording[:LONGEST_NAME])

    def _follow_recording(self, name: str) -> None:
        """Show a recording that another client has begun, or ask why one has ended."""
        if self.doing is Doing.RECORDING and not name:
            self._end(holds=False)
        elif name and (self._is_idle or self.doing is Doing.RECORDING):
            if self._recording is None or self._recording.name != name:
                self._recording = _Recording(name, None)
            self.doing = Doing.RECORDING

    def _take_beginning(self, answer: Mapping[str, Any]) -> None:
        self._recording = _Recording(_name(answer, "recording"), self._rig.clock.now())
        self.doing = Doing.RECORDING
        self._show_recording()

    def _take_path(self, answer: Mapping[str, Any]) -> None:
        name, duration = _name(answer, "name"), _number(answer, "duration_s")
        points = round(_number(answer, "points"))
        plural = "" if points == 1 else "s"
        self.names = tuple(sorted({*self.names, name}))
        self._choose(name)
        why = answer.get("ended_by")
        ended = isinstance(why, str) and why not in ("", "end_path")
        begin = f"The recording ended: {why}. " if ended else ""
        facts = f"{duration:.1f} s, {points} point{plural}"
        text = f'{begin}"{name}" is saved: {facts}. {PLAN.text}'
        self.sentence = Sentence(text=text, tone=Tone.PLAIN if ended else Tone.GOOD)

    def _take_plan(self, answer: Mapping[str, Any]) -> None:
        approach, total = _number(answer, "approach_s"), _number(answer, "replay_s")
        self.line, self._is_planned = _line(answer), True
        self.sentence = planned(approach, max(total - approach, 0.0))

    def _take_change(self, sentence: Sentence, name: str, is_there: bool) -> None:
        """A path was deleted, or is there again."""
        names = {*self.names, name} if is_there else {*self.names} - {name}
        self.names = tuple(sorted(names))
        if self.chosen not in self.names:
            self._choose("")
        self.sentence = sentence


def _name(answer: Mapping[str, Any], key: str) -> str:
    value = answer.get(key)
    if not isinstance(value, str) or not 0 < len(value) <= LONGEST_NAME:
        raise MotionError("the machine's answer does not name the path")
    return value


def _line(answer: Mapping[str, Any]) -> Array | None:
    """The tool's way [m]; None from a module that does not tell it."""
    line_mm = answer.get("tool_path_mm")
    if not isinstance(line_mm, list) or not 0 < len(line_mm) <= MOST_POINTS:
        return None
    try:
        line = np.array(line_mm, dtype=float) / 1000.0
    except (TypeError, ValueError):
        return None
    return line if line.shape[1:] == (3,) and np.isfinite(line).all() else None


def _number(answer: Mapping[str, Any], key: str) -> float:
    value = answer.get(key)
    if not isinstance(value, int | float) or not isfinite(value):
        raise MotionError(f"the machine's answer does not say {key}")
    return float(value)
