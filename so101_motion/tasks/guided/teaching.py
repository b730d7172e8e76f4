"""Teaching a path as an operation: record it by hand, keep it, plan its replay, replay it.

A recording is saved whenever it ends; one that could not be saved is kept for the next try.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.common.attributes import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG, checked_number
from so101_motion.common.errors import MotionError, NotPossibleNow
from so101_motion.common.modes import LONGEST_GUIDING, Mode
from so101_motion.common.operation import Input, LocalOperation, Offer, Picture, Started, View
from so101_motion.common.units import to_deg, to_rad
from so101_motion.control.request_queue import own_thread, running_future
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.rig.hardware_rig import HardwareRig
from so101_motion.rig.rig import Rig
from so101_motion.tasks.guided import files
from so101_motion.tasks.guided.path import TOLERANCE, GuidedPath, tool_line
from so101_motion.tasks.guided.recorder import PathRecorder
from so101_motion.tasks.guided.replay import TOLERANCE_RANGE, Replay, plan_replay, start_replay
from so101_motion.tasks.program.rehearsal import stands_at
from so101_motion.tasks.teleop.sides import jaw_of

TAUGHT = (
    "record_path", "end_path", "list_paths", "replay_path", "delete_path", "restore_path",
)  # fmt: skip
"""The commands that are DoCommands of an arm as well."""

GUIDED_FOR = 180.0  # the arm yields to a hand for ``record`` for so long [s]; chosen
MOST_NAMES = 500  # how many saved paths are offered; chosen, more than a person can choose from

_WELCOME = "Press Record a path, then guide the arm by hand."
_STANDS = "A simulated arm cannot be guided by hand: what you record stands still."
_CHOOSE = "Press Plan replay to check a saved path, or Record a path. Neither moves the arm."
_BY_HAND = "Press Record a path, then guide the arm by hand. To replay one, press Hold first."
_MOVED = "The arm has moved. Press Plan replay again."

_log = logging.getLogger(__name__)


@dataclass(slots=True, kw_only=True)
class _Recording:
    recorder: PathRecorder
    file: Path
    replace: bool
    until: float | None  # when the arm holds again, by its clock [s]; None for no limit
    saved: Future[tuple[GuidedPath, Path]]


class TeachingOperation(LocalOperation):
    """Records, keeps, plans and replays guided paths of one arm.

    ``set_manual`` switches manual mode, for some seconds or, with 0, without limit; by default the
    arm's own, whose limit is kept by the surface that shows the operation.
    """

    refuses = False

    def __init__(
        self,
        rig: Rig,
        folder: Callable[[], Path],
        set_manual: Callable[[bool, float], None] | None = None,
    ) -> None:
        super().__init__()
        self._rig, self._folder = rig, folder
        self._set_manual = set_manual or (lambda enabled, _seconds: rig.arm.set_manual(enabled))
        self._recording: _Recording | None = None
        self._one_at_a_time = threading.Lock()  # of two recordings begun at once one would be lost
        self._one_plan = threading.Lock()
        self._planned: Replay | None = None
        self._line: tuple[tuple[float, ...], ...] = ()
        self._deleted: list[tuple[str, str]] = []  # name, and what it is kept as
        self._doing = self._chosen = ""
        self._sentence = ""  # what has happened; what to press now follows from the arm's mode
        self.commands = {
            "record_path": self._record_path,
            "end_path": self._end_path,
            "list_paths": self._list_paths,
            "replay_path": self._replay_path,
            "delete_path": self._delete_path,
            "restore_path": self._restore_path,
            "record": self._record,
            "end": self._end,
            "plan": self._plan,
            "run": self._run,
        }

    def close(self) -> None:
        """End and save a running recording."""
        recording, self._recording = self._recording, None
        if recording is not None:
            recording.recorder.end()
            recording.saved.exception()  # waits; an error is in the log

    # The view

    @property
    def view(self) -> View:
        recording = self._running()
        return View(
            state="recording" if recording is not None else self._doing or "idle",
            text=self._text() if recording is None else self._about(recording),
            offers=self._offers(recording),
            picture=Picture(line=self._line),
            said=self.said,
        )

    def _text(self) -> str:
        mode, said, planned = self._rig.arm.state.mode, self._sentence, self._planned
        if mode in (Mode.LIMP, Mode.GUIDING):
            return f"{said} {_BY_HAND}".strip()
        if mode is not Mode.HOLDING or self._doing:
            return said
        if planned is None:
            welcome = _STANDS if self._rig.connection.is_simulated else _WELCOME
            return f"{said} {_CHOOSE if self._names else welcome}".strip()
        if not self._stands_at(planned):
            return _MOVED
        approach, along = planned.approach.duration, planned.duration - planned.approach.duration
        times = f"{approach:.1f} s to its start, then {along:.1f} s along it, without its pauses"
        return f"Planned: {times}. Press Replay."

    def _offers(self, recording: _Recording | None) -> tuple[Offer, ...]:
        if recording is not None:
            left = None if recording.until is None else recording.until - self._rig.clock.now()
            return (Offer(command="end", title="End the recording", due_in=left),)
        mode, names = self._rig.arm.state.mode, self._names
        busy = f"the arm is {self._doing}" if self._doing else None
        can_record = mode in (Mode.HOLDING, Mode.GUIDING, Mode.LIMP)
        limp = None if can_record else f"the arm is {mode.words}"
        moves = None if mode is Mode.HOLDING else f"the arm is {mode.words}"
        planned = self._planned
        is_planned = planned is not None and self._stands_at(planned)
        chosen = self._chosen if self._chosen in names else (*names, "")[0]
        saved = {"name": Input(label="Saved", choices=names)}
        record = Offer(
            command="record", title="Record a path", arguments={"name": ""},
            inputs={"name": Input(label="Path name")}, why_not=busy or limp,
        )  # fmt: skip
        of_saved = (
            Offer(
                command="plan", title="Plan replay", arguments={"name": chosen}, inputs=saved,
                why_not=busy or moves,
            ),
            Offer(
                command="run", title="Replay",
                why_not=busy or moves or (None if is_planned else "plan it first"),
            ),
            Offer(
                command="delete_path", title="Delete", arguments={"name": chosen}, inputs=saved,
                why_not=busy,
            ),
        )  # fmt: skip
        return (
            record,
            *(of_saved if names else ()),
            *(
                Offer(command="restore_path", title=f"Bring back {name}",
                      arguments={"kept_as": kept_as})
                for name, kept_as in self._deleted[-1:]
            ),
        )  # fmt: skip

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple(sorted(each.stem for each in self._folder().glob("*.json"))[:MOST_NAMES])

    def _running(self) -> _Recording | None:
        recording = self._recording
        is_over = recording is None or recording.recorder.future.done()
        return None if is_over else recording

    def _about(self, recording: _Recording) -> str:
        points = recording.recorder.points
        todo = "Guide the arm by hand."
        if self._rig.connection.is_simulated:
            todo = "A simulated arm stands still."
        count = f"{points} point{'' if points == 1 else 's'}"
        return f'Recording "{recording.file.stem}", {count}. {todo}'

    def _stands_at(self, replay: Replay) -> bool:
        return stands_at(replay.approach.q_start, self._rig.arm.state.q_ref)

    # Recording

    def _record_path(
        self, name: str = "", replace: bool = False, enabled_for: float = 0.0
    ) -> dict[str, Any]:
        file = self._file(name)
        checked_number("enabled_for", enabled_for, lower=0.0, upper=LONGEST_GUIDING, unit="s")
        with self._one_at_a_time:
            files.refuse_taken(file, replace=replace)
            self._begin(file, replace, enabled_for)
        return {"recording": file.stem, "mode": "manual"}

    def _record(self, name: str = "") -> dict[str, Any]:
        """Record for a person: under a free name, and not for ever."""
        file = self._file(name.strip() or "path")
        return self._record_path(_free(file).stem, enabled_for=GUIDED_FOR)

    def _begin(self, file: Path, replace: bool, seconds: float) -> None:
        if (running := self._running()) is not None:
            raise MotionError(
                f"{running.file.stem} is being recorded already; send"
                ' {"command": "end_path"} first'
            )
        self._save_again()
        rig = self._rig
        if seconds > 0.0 or not rig.arm.is_movable_by_hand:
            if isinstance(rig, HardwareRig):
                rig.drive()  # if a page has only looked at it
            self._set_manual(True, seconds)
        recorder = PathRecorder(rig.executor, jaw_of(rig))
        self._recording = recording = _Recording(
            recorder=recorder,
            file=file,
            replace=replace,
            until=rig.clock.now() + seconds if seconds > 0.0 else None,
            saved=running_future(),
        )
        recorder.future.add_done_callback(lambda _: own_thread(lambda: self._save(recording)))

    def _save(self, recording: _Recording) -> None:
        """Save a path whose recording has ended; with a number if its name is taken by then."""
        recorder, saved, file = recording.recorder, recording.saved, recording.file
        path, why = recorder.future.result(), recorder.ended_by
        try:
            file = file if recording.replace else _free(file)
            files.write(
                path, file, replace=recording.replace, zeros=self._rig.connection.encoder_zeros
            )
        except Exception as error:  # perhaps no caller waits for it
            _log.error("the guided path was not saved: %s; end_path tries it again", error)
            self._sentence = f"The path is not saved: {error}"
            saved.set_exception(error)
            return
        if why:
            _log.info("%s is saved: %s", file.stem, why)
        begin = f"The recording ended: {why}. " if why else ""
        facts = f"{path.duration:.1f} s, {len(path)} point{'' if len(path) == 1 else 's'}"
        self._choose(file.stem, path)
        self._sentence = f'{begin}"{file.stem}" is saved: {facts}.'
        saved.set_result((path, file))

    def _save_again(self) -> None:
        """Try again to save a path that could not be saved before."""
        recording = self._recording
        if recording is not None and recording.saved.exception() is not None:
            recording.saved, recording.replace = running_future(), False
            self._save(recording)
            recording.saved.result()

    def _end_path(self) -> dict[str, Any]:
        with self._one_at_a_time:
            recording = self._recording
            if recording is None:
                raise MotionError(
                    'nothing is being recorded; begin with {"command": "record_path"}'
                )
            if recording.recorder.future.done():
                self._save_again()
            recording.recorder.end()
            path, file = recording.saved.result()
        ended_by = recording.recorder.ended_by or "end_path"
        return {**_facts(file.stem, path), "file": str(file), "ended_by": ended_by}

    def _end(self) -> dict[str, Any]:
        """End the recording for a person: the arm holds where it is."""
        was_running = self._running() is not None
        try:
            return self._end_path()
        finally:
            if was_running:
                self._set_manual(False, 0.0)

    # Saved paths

    def _file(self, name: str) -> Path:
        return files.file_of(self._folder(), name)

    def _list_paths(self) -> dict[str, Any]:
        recording = self._running()
        return {
            "paths": [
                {**_facts(each.name, each.path), "recorded_at": each.recorded_at}
                for each in files.listed(self._folder())
            ],
            "recording": "" if recording is None else recording.file.stem,
        }

    def _delete_path(self, name: str = "") -> dict[str, Any]:
        file = self._file(name)
        kept_as = files.set_aside(file)
        self._deleted.append((file.stem, kept_as))
        self._sentence = f'"{file.stem}" is deleted.'
        if self._chosen == file.stem:
            self._choose("", None)
        return {"deleted": file.stem, "kept_as": kept_as}

    def _restore_path(self, kept_as: str = "") -> dict[str, Any]:
        name = files.restore(self._folder(), kept_as).stem
        self._deleted = [each for each in self._deleted if each[1] != kept_as]
        self._sentence = f'"{name}" is there again.'
        return {"restored": name}

    def _choose(self, name: str, path: GuidedPath | None) -> None:
        self._chosen, self._planned, self._line = name, None, ()
        if path is not None:
            self._line = tuple(map(tuple, np.round(tool_line(path), 4).tolist()))

    # Replay

    def _replay_path(
        self,
        name: str = "",
        outline: bool = False,
        tolerance_deg: float = to_deg(TOLERANCE),
        speed_degs_per_sec: float = SPEED_RANGE_DEG[1],
        acceleration_degs_per_sec_per_sec: float = ACCELERATION_RANGE_DEG[1],
    ) -> Mapping[str, Any] | Started:
        file, rig = self._file(name), self._rig
        lower, upper = (to_deg(bound) for bound in TOLERANCE_RANGE)
        checked_number("tolerance_deg", tolerance_deg, lower=lower, upper=upper, unit="deg")
        limits = _lowered(rig.arm.limits, speed_degs_per_sec, acceleration_degs_per_sec_per_sec)
        path = files.read(file, rig.connection.encoder_zeros)
        planned: list[Replay] = []

        def plan() -> Replay:
            planned.append(
                plan_replay(
                    rig.arm, path, gripper=jaw_of(rig), tolerance=to_rad(tolerance_deg),
                    limits=limits,
                )
            )  # fmt: skip
            return planned[-1]

        def answer() -> dict[str, Any]:
            return {
                **_facts(file.stem, path),
                "approach_s": round(planned[0].approach.duration, 3),
                "replay_s": round(planned[0].duration, 3),
            }

        if outline:
            with self._one_plan:
                plan()
            return {**answer(), "tool_path_mm": np.round(1000.0 * tool_line(path), 1).tolist()}
        self._set_manual(False, 0.0)  # holds again after a fault, too
        # Planning and replay are one motion, so a stop ends it while it is being planned, too.
        motion = start_replay(rig.arm, jaw_of(rig), lambda: own_thread(plan))
        return Started(motion.future, motion.interrupt, answer)

    def _plan(self, name: str) -> dict[str, Any]:
        path = files.read(self._file(name), self._rig.connection.encoder_zeros)
        with self._one_plan:
            self._choose(name, path)
            self._doing, self._sentence = "planning", ""
            try:
                replay = plan_replay(self._rig.arm, path, gripper=jaw_of(self._rig))
            finally:
                self._doing = ""
        self._planned = replay
        return {
            "approach_s": round(replay.approach.duration, 3),
            "replay_s": round(replay.duration, 3),
        }

    def _run(self) -> Started:
        planned, self._planned = self._planned, None
        if planned is None or not self._stands_at(planned):
            raise NotPossibleNow("run", "the replay is not planned from where the arm is")
        self._sentence = "Moving."
        motion = start_replay(self._rig.arm, jaw_of(self._rig), planned)
        motion.future.add_done_callback(self._told)
        return Started(motion.future, motion.interrupt, dict)

    def _told(self, moved: Future[None]) -> None:
        self._sentence = "Done." if moved.exception() is None else ""


def _free(file: Path) -> Path:
    """This file, or one with a number after its name, that is not there."""
    numbered = (file.with_name(f"{file.stem} {k}{file.suffix}") for k in count(2))
    return file if not file.exists() else next(each for each in numbered if not each.exists())


def _lowered(own: MotionLimits, speed_deg: float, acceleration_deg: float) -> MotionLimits:
    def cap(key: str, value: float, bounds: tuple[float, float], unit: str) -> float:
        return to_rad(checked_number(key, value, lower=bounds[0], upper=bounds[1], unit=unit))

    return own.lowered_to(
        cap("speed_degs_per_sec", speed_deg, SPEED_RANGE_DEG, "deg/s"),
        cap(
            "acceleration_degs_per_sec_per_sec", acceleration_deg, ACCELERATION_RANGE_DEG, "deg/s^2"
        ),
    )


def _facts(name: str, path: GuidedPath) -> dict[str, Any]:
    return {"name": name, "points": len(path), "duration_s": round(path.duration, 3)}
