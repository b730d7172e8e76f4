"""Record a path by hand and replay it, without viser.

Nothing here waits: slow calls are futures that ``refresh`` collects. One thread owns a
``PathTeaching``.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from so101_motion.arm.motion_handle import Motion
from so101_motion.common.encoder_zeros import EncoderZeros
from so101_motion.common.errors import ConfigError, Interrupted, So101Error
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.files import user_storage
from so101_motion.rig.rig import Rig
from so101_motion.tasks.guided import (
    GuidedPath,
    PathRecorder,
    Replay,
    files,
    plan_replay,
    tool_line,
)
from so101_motion.tasks.guided import start_replay as start
from so101_motion.tasks.program.rehearsal import stands_at
from so101_motion.tasks.teleop.local_arms import jaw_of

from ..page import texts
from ..page.guiding import Guiding
from ..page.saved_files import SavedFiles
from ..page.screen_state import Sentence, Tone
from .teaching import (
    ARM_MOVED,
    BEGINS,
    DONE,
    PLAN,
    PLANNING,
    STANDS,
    WELCOME,
    Doing,
    holds_again,
    planned,
)


class PathTeaching:
    """Records, keeps, plans and replays one path at a time.

    Args:
        rig: The arm and its gripper.
        submit: Runs a slow call on another thread.

    Attributes:
        path: The path that was recorded or loaded; None before.
        line: Where the tool is along it; None before.
        replay: Its plan, as long as it is valid; else None.
        doing: What is going on.
        sentence: What to know or to do now.
        name: What the path is called.
        saved_files: The saved paths.
    """

    def __init__(self, rig: Rig, submit: Callable[[Callable[[], Any]], Future[Any]]) -> None:
        self._rig, self._submit = rig, submit
        self._guiding = Guiding(rig.arm, rig.clock, submit)
        self._recorder: PathRecorder | None = None
        self._planning: Future[Replay] | None = None
        self._motion: Motion | None = None
        self.path: GuidedPath | None = None
        self.line: Array | None = None
        self.replay: Replay | None = None
        self.doing = Doing.NOTHING
        self._is_simulated = rig.connection.is_simulated
        self.sentence = STANDS if self._is_simulated else WELCOME
        self.name = ""
        self.saved_files = SavedFiles(_file_of, _listed, self._tell)
        self._saved: tuple[Path, bytes] | None = None  # where the path is kept, and as what
        self._kept = ""  # what was said when a path was kept

    # Recording

    @property
    def can_record(self) -> bool:
        """Whether the arm may be led by hand now."""
        return self.doing is Doing.NOTHING and (
            self._guiding.can_start or self._rig.arm.state.mode is Mode.GUIDING
        )

    def record(self) -> None:
        """Let the arm yield to a hand, and record its path; an unsaved one is kept first."""
        if self.can_record:
            self._kept = self._keep_unsaved()
            self.doing, self.sentence = Doing.BEGINNING, BEGINS
            self._guiding.start()

    def end_recording(self) -> None:
        """End the recording; the arm holds where it is."""
        if self._recorder is not None:
            self._keep(self._recorder)
            self._submit(lambda: self._rig.arm.set_manual(False))

    # Replay

    @property
    def can_plan(self) -> bool:
        """Whether a replay can be planned now."""
        return (
            self.path is not None
            and self.doing is Doing.NOTHING
            and self._rig.arm.state.mode is Mode.HOLDING
        )

    @property
    def can_run(self) -> bool:
        """Whether the plan can be run now."""
        return self.can_plan and self.replay is not None

    def plan(self) -> None:
        """Plan the replay; nothing moves."""
        path, rig = self.path, self._rig
        if path is not None and self.can_plan:
            self.replay = None
            self.doing, self.sentence = Doing.PLANNING, PLANNING
            self._planning = self._submit(lambda: plan_replay(rig.arm, path, gripper=jaw_of(rig)))

    def run(self) -> None:
        """Move along the path as it was planned."""
        if self.replay is not None and self.can_run:
            self.doing = Doing.REPLAYING
            self.sentence = texts.MOVING
            self._motion = start(self._rig.arm, jaw_of(self._rig), self.replay)

    # Files

    @property
    def _zeros(self) -> EncoderZeros | None:
        return self._rig.connection.encoder_zeros

    def call(self, name: str) -> None:
        """Set the name for saving."""
        self.name = name

    def save(self) -> None:
        """Save the path under its name; replaces one of that name."""
        if self.path is None:
            raise ConfigError("path", None, "record a path first")
        if not self.name.strip():
            raise ConfigError("name", None, "type a name first")
        with self.saved_files.changing(self.name.strip()) as file:
            files.write(self.path, file, replace=True, zeros=self._zeros)
        self.name, self._saved = file.stem, (file, file.read_bytes())
        self.sentence = texts.saved(file.stem)

    def load(self, name: str) -> None:
        """Take a saved path; nothing moves. An unsaved one is kept under a name first."""
        file = _file_of(name)
        path, content = files.read(file, self._zeros), file.read_bytes()
        kept = self._keep_unsaved()
        self._take(path)
        self.name, self._saved = name, (file, content)
        self.sentence = replace(self.sentence, text=f"{self.sentence.text}{kept}")

    def delete(self, name: str) -> None:
        """Delete a saved path; the one that is shown stays."""
        with self.saved_files.changing(name) as file:
            files.delete(file)
        self.sentence = texts.deleted(name)

    def report(self, error: BaseException) -> None:
        """Show that a command failed."""
        self.sentence = texts.ended(error)

    # Updates

    def refresh(self) -> None:
        """Take in what has happened since the last call."""
        try:
            self._guiding.refresh()
        except So101Error as error:
            self.doing = Doing.NOTHING
            self.report(error)
        self._watch_recording()
        self._collect_plan()
        self._collect_run()
        replay = self.replay
        if replay is not None and self.doing is Doing.NOTHING:
            state = self._rig.arm.state
            if not stands_at(replay.approach.q_start, state.q_ref):
                self.replay, self.sentence = None, ARM_MOVED

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the saved paths."""
        return self.saved_files.names

    # Helpers

    def _watch_recording(self) -> None:
        rig, recorder = self._rig, self._recorder
        if self.doing is Doing.BEGINNING and rig.arm.state.mode is Mode.GUIDING:
            self._recorder, self.doing = PathRecorder(rig.executor, jaw_of(rig)), Doing.RECORDING
        elif recorder is not None and recorder.ended_by:
            self._keep(recorder)
        if self._recorder is not None:
            self.sentence = _recording(self._recorder, self._guiding.left, self._is_simulated)

    def _keep(self, recorder: PathRecorder) -> None:
        why, self._recorder = recorder.ended_by, None
        self._take(recorder.end())
        said = f"The recording ended: {why}. {PLAN.text}" if why else self.sentence.text
        tone = Tone.PLAIN if why else Tone.GOOD
        self.sentence = Sentence(text=f"{said}{self._kept}", tone=tone)

    def _keep_unsaved(self) -> str:
        """Save a path that is in no file; return the sentence about it."""
        if self.path is None or (self._saved is not None and _holds(*self._saved)):
            return ""
        taken = set(self.saved_files.names)
        name = next(name for k in count(1) if (name := f"unsaved {k}") not in taken)
        with self.saved_files.changing(name) as file:
            files.write(self.path, file, zeros=self._zeros)
        self._saved = (file, file.read_bytes())
        return f' The path before is saved as "{name}".'

    def _take(self, path: GuidedPath) -> None:
        self.path, self.replay, self.doing = path, None, Doing.NOTHING
        self.line = tool_line(path)
        self._saved = None
        text = f"{path.duration:.1f} s, {len(path)} points. {PLAN.text}"
        self.sentence = Sentence(text=text, tone=Tone.GOOD)

    def _collect_plan(self) -> None:
        if self._planning is None or not self._planning.done():
            return
        planning, self._planning, self.doing = self._planning, None, Doing.NOTHING
        error = planning.exception()
        if error is not None:
            self.report(error)
            return
        self.replay = planning.result()
        approach = self.replay.approach.duration
        self.sentence = planned(approach, self.replay.duration - approach)

    def _collect_run(self) -> None:
        if self._motion is None or not self._motion.future.done():
            return
        motion, self._motion, self.doing = self._motion, None, Doing.NOTHING
        self.replay = None
        error = motion.future.exception()
        if error is None:
            self.sentence = DONE
        elif isinstance(error, Interrupted) and error.by == "stop":
            self.sentence = Sentence(text="Stopped. The arm holds where it is.")
        else:
            self.report(error)

    def _tell(self, sentence: Sentence) -> None:
        self.sentence = sentence


def _holds(file: Path, content: bytes) -> bool:
    try:
        return file.read_bytes() == content
    except OSError:
        return False


def _folder() -> Path:
    return user_storage.folder() / "paths"


def _file_of(name: str) -> Path:
    return files.file_of(_folder(), name)


def _listed() -> tuple[str, ...]:
    return tuple(each.name for each in files.listed(_folder()))


def _recording(recorder: PathRecorder, left: float | None, is_simulated: bool) -> Sentence:
    points = f"{recorder.points} point{'' if recorder.points == 1 else 's'}"
    todo = "A simulated arm stands still." if is_simulated else "Guide the arm by hand."
    text = f"Recording, {points}. {todo}{holds_again(left)}"
    return Sentence(text=text, tone=Tone.WARM)
