"""Answer the commands that record, replay, list, delete and restore paths guided by hand.

A path is recorded while a person moves the arm in manual mode. It is saved in the folder ``paths``
of the module's data when the recording ends: by ``end_path``, by leaving manual mode, when its time
is up, or when the component is closed.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from so101_motion.calib.record import store
from so101_motion.common.attributes import ACCELERATION_RANGE_DEG, SPEED_RANGE_DEG, Attributes
from so101_motion.common.encoder_zeros import EncoderZeros
from so101_motion.common.errors import MotionError, So101Error
from so101_motion.common.units import to_deg, to_rad
from so101_motion.planning.timing.limits import MotionLimits
from so101_motion.tasks.guided import (
    GuidedPath,
    PathRecorder,
    Replay,
    files,
    plan_replay,
    start_replay,
    tool_line,
)
from so101_motion.tasks.guided.path import TOLERANCE
from so101_motion.tasks.guided.replay import TOLERANCE_RANGE
from so101_motion.tasks.teleop.local_arms import jaw_of
from so101_motion.viam.requests.await_motion import own_thread, run_to_end, wait_to_end
from so101_motion.viam.requests.commands import Command, Taking
from so101_motion.viam.requests.manual import LONGEST

if TYPE_CHECKING:
    from so101_motion.viam.models.arm_resource import ArmResource

PATHS = "paths"
"""The folder in the module's data directory that guided paths are saved in."""

_REPLAYED = (
    "name", "outline", "tolerance_deg", "speed_degs_per_sec", "acceleration_degs_per_sec_per_sec"
)  # fmt: skip


_Saving = asyncio.Task[tuple[GuidedPath, Path]]


@dataclass(slots=True, kw_only=True)
class _Recording:
    recorder: PathRecorder
    file: Path
    saved: _Saving


class PathCommands:
    """Records, saves and replays guided paths of one arm component. Lives in the event loop.

    Args:
        arm: The component.

    Attributes:
        commands: The method for each ``command``.
    """

    def __init__(self, arm: ArmResource) -> None:
        self._arm = arm
        self._recording: _Recording | None = None
        self._one_at_a_time = asyncio.Lock()  # of two recordings begun at once, one would be lost
        self._one_outline = asyncio.Lock()  # no thread for each of many requests
        self.commands: Mapping[str, Command] = {
            "record_path": Taking(self._record, ("name", "replace", "enabled_for")),
            "end_path": self._end,
            "list_paths": self._list,
            "replay_path": Taking(self._replay, _REPLAYED),
            "delete_path": Taking(self._delete, ("name",)),
            "restore_path": Taking(self._restore, ("kept_as",)),
        }

    async def close(self) -> None:
        """End and save a running recording."""
        recording, self._recording = self._recording, None
        if recording is not None:
            recording.recorder.end()
            await asyncio.wait([recording.saved])

    async def _record(self, given: Attributes) -> dict[str, Any]:
        file, replace = _file(given), given.flag("replace", False)
        seconds = given.number("enabled_for", 0.0, lower=0.0, upper=LONGEST, unit="s")
        files.refuse_taken(file, replace=replace)
        return await wait_to_end(self._begin(file, seconds, replace=replace))

    async def _begin(self, file: Path, seconds: float, *, replace: bool) -> dict[str, Any]:
        async with self._one_at_a_time:
            await self._begin_alone(file, seconds, replace=replace)
        return {"recording": file.stem, "mode": "manual"}

    async def _begin_alone(self, file: Path, seconds: float, *, replace: bool) -> None:
        if self._recording is not None and not self._recording.recorder.future.done():
            raise MotionError(
                f"{self._recording.file.stem} is being recorded already; send"
                ' {"command": "end_path"} first'
            )
        await self._save_again()
        rig = self._arm.rig
        if seconds > 0.0 or not rig.arm.is_movable_by_hand:
            await self._arm.set_manual_mode(True, seconds)
        recorder = PathRecorder(rig.executor, jaw_of(rig))
        saved = self._saving(recorder, file, replace=replace)
        self._recording = _Recording(recorder=recorder, file=file, saved=saved)

    def _saving(self, recorder: PathRecorder, file: Path, *, replace: bool) -> _Saving:
        saving = asyncio.ensure_future(self._save(recorder, file, replace))
        saving.add_done_callback(lambda task: task.cancelled() or task.exception())  # retrieved
        return saving

    async def _save(
        self, recorder: PathRecorder, file: Path, replace: bool
    ) -> tuple[GuidedPath, Path]:
        """Save a path when its recording ends; under another name if its own is taken by then."""
        path = await asyncio.wrap_future(recorder.future)
        try:
            file = await asyncio.to_thread(
                _written, path, file, replace=replace, zeros=self._arm.rig.connection.encoder_zeros
            )
        except So101Error as error:  # perhaps no caller waits for it
            self._arm.logger.error(
                "the guided path was not saved: %s; end_path tries it again", error
            )
            raise
        if recorder.ended_by:
            self._arm.logger.info("%s is saved: %s", file.stem, recorder.ended_by)
        return path, file

    async def _end(self) -> dict[str, Any]:
        recording = self._recording
        if recording is None:
            raise MotionError('nothing is being recorded; begin with {"command": "record_path"}')
        recording.recorder.end()
        await self._save_again()
        path, file = await asyncio.shield(recording.saved)
        return {
            **_facts(file.stem, path),
            "file": str(file),
            "ended_by": recording.recorder.ended_by or "end_path",
        }

    async def _save_again(self) -> None:
        """Try again to save a path that could not be saved before; nothing of it is lost.

        Raises:
            So101Error: It cannot be saved now either.
        """
        recording = self._recording
        if recording is None or not recording.saved.done() or recording.saved.cancelled():
            return
        if recording.saved.exception() is not None:
            recording.saved = self._saving(recording.recorder, recording.file, replace=False)
            await asyncio.shield(recording.saved)

    async def _list(self) -> dict[str, Any]:
        kept = await asyncio.to_thread(files.listed, store.resolve(PATHS))
        recording = self._recording
        running = recording is not None and not recording.recorder.future.done()
        return {
            "paths": [
                {**_facts(each.name, each.path), "recorded_at": each.recorded_at} for each in kept
            ],
            "recording": recording.file.stem if recording is not None and running else "",
        }

    async def _replay(self, given: Attributes) -> dict[str, Any]:
        file, rig = _file(given), self._arm.rig
        lower, upper = (to_deg(bound) for bound in TOLERANCE_RANGE)
        tolerance_deg = given.number(
            "tolerance_deg", to_deg(TOLERANCE), lower=lower, upper=upper, unit="deg"
        )
        limits, gripper = _limits(given, rig.arm.limits), jaw_of(rig)
        outline = given.flag("outline", False)
        path = await asyncio.to_thread(files.read, file, rig.connection.encoder_zeros)
        planned: list[Replay] = []

        def plan() -> Replay:
            planned.append(
                plan_replay(
                    rig.arm, path, gripper=gripper, tolerance=to_rad(tolerance_deg), limits=limits
                )
            )
            return planned[-1]

        if outline:
            async with self._one_outline:
                await run_to_end(plan)
        else:
            await self._arm.set_manual_mode(False)  # holds again after a fault, too
            # Planning and replay are one motion, so a stop ends it while it is being planned, too.
            await self._arm.arrived(start_replay(rig.arm, gripper, lambda: own_thread(plan)))
        answer = {
            **_facts(file.stem, path),
            "approach_s": round(planned[0].approach.duration, 3),
            "replay_s": round(planned[0].duration, 3),
        }
        if outline:
            line = await asyncio.to_thread(tool_line, path)
            answer["tool_path_mm"] = np.round(1000.0 * line, 1).tolist()
        return answer

    async def _delete(self, given: Attributes) -> dict[str, Any]:
        file = _file(given)
        kept_as = await asyncio.to_thread(files.set_aside, file)
        return {"deleted": file.stem, "kept_as": kept_as}

    async def _restore(self, given: Attributes) -> dict[str, Any]:
        kept_as = given.text("kept_as", "")
        file = await asyncio.to_thread(files.restore, store.resolve(PATHS), kept_as)
        return {"restored": file.stem}


def _file(given: Attributes) -> Path:
    return files.file_of(store.resolve(PATHS), given.text("name", ""))


def _limits(given: Attributes, own: MotionLimits) -> MotionLimits:
    """The arm's caps, lowered to those of a request."""

    def cap(key: str, bounds: tuple[float, float], unit: str) -> float:
        return to_rad(given.number(key, bounds[1], lower=bounds[0], upper=bounds[1], unit=unit))

    return own.lowered_to(
        cap("speed_degs_per_sec", SPEED_RANGE_DEG, "deg/s"),
        cap("acceleration_degs_per_sec_per_sec", ACCELERATION_RANGE_DEG, "deg/s^2"),
    )


def _facts(name: str, path: GuidedPath) -> dict[str, Any]:
    return {"name": name, "points": len(path), "duration_s": round(path.duration, 3)}


def _written(path: GuidedPath, file: Path, *, replace: bool, zeros: EncoderZeros | None) -> Path:
    """Write a path; under its name with a number if that has been taken meanwhile."""
    free = file
    for number in count(2):
        if replace or not free.exists():
            break
        free = file.with_name(f"{file.stem} {number}{file.suffix}")
    files.write(path, free, replace=replace, zeros=zeros)
    return free
