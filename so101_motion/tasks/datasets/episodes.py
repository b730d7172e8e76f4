"""Record episodes for LeRobot as an operation, whatever moves the arm meanwhile; replay them.

A thread reads the newest state of the arm once a frame, and hands it to a process of the plugin,
which has LeRobot, the camera and the files. The control loop waits for nothing of this.
"""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any, cast

import numpy as np

from so101_motion.common.child_process import spawn
from so101_motion.common.errors import ConfigError, NotPossibleNow, WorkerError
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.operation import Input, LocalOperation, Offer, View
from so101_motion.rig.rig import Rig

LONGEST = 600.0  # longest episode [s]; chosen: what a forgotten recording may take of a disk
OPENED_WITHIN = 180.0  # how long LeRobot and the camera may take to start [s]; seen: 5 to 70
SAVED_WITHIN = 600.0  # how long an episode may take to be encoded and saved [s]; chosen
RATES = ("30", "15", "60")  # frames a second that are offered

_WRITER = "lerobot_robot_so101_motion.episode_writer"
_WELCOME = "Press Record an episode, then move the arm from any tab, by a leader or by hand."
_NOTE = (
    "Data set: a name such as me/pick, or a folder. Camera: 0, /dev/video0 or http://...; none"
    " if left empty."
)
_RECORDING = "Recording. Move the arm from any tab, then keep the episode or throw it away."
_MISSING = (
    "LeRobot is not installed here. To record episodes, make an environment with Python 3.12, run"
    " pip install 'lerobot[core-scripts]' '.[viewer,dataset]' ./lerobot_robot_so101_motion in this"
    " project's folder, and start the page from there."
)


class EpisodeOperation(LocalOperation):
    """Records episodes of one arm into a LeRobot data set, and replays them.

    ``camera`` is proposed: an index, a device or an address; empty for none.
    """

    def __init__(self, rig: Rig, camera: str = "") -> None:
        super().__init__()
        self._rig = rig
        self._is_installed = all(map(find_spec, ("lerobot", _WRITER.partition(".")[0])))
        self._given = {"data_set": "me/so101", "task": "", "camera": camera, "fps": RATES[0]}
        self._writer: _Writer | None = None
        self._sampler: threading.Thread | None = None  # while an episode is recorded
        self._ending = threading.Event()
        self._doing = self._trouble = ""
        self._kept: tuple[Path, int] | None = None  # the data set, and its newest episode
        self.commands = {
            "record": self._record,
            "keep": self._keep,
            "discard": self._discard,
            "replay": self._replay,
        }

    def close(self) -> None:
        """Discard an episode that is being recorded."""
        self._end_sampling()
        self._close_writer()

    # The view

    @property
    def view(self) -> View:
        if not self._is_installed:
            return View(state="missing", text=_MISSING)
        writer, is_recording = self._writer, self._sampler is not None
        text, frames, late = _WELCOME, 0, 0
        if is_recording and writer is not None:
            frames, late = writer.frames, writer.late
            text = f"{_RECORDING} {frames / writer.fps:.1f} s, {_counted(frames, late)}."
        return View(
            state="recording" if is_recording else "idle",
            text=text,
            trouble=self._trouble or ("" if writer is None or not is_recording else writer.problem),
            doing=self._doing,
            note="" if is_recording else _NOTE,
            offers=self._offers(is_recording),
            said=self.said,
            facts={"frames": frames, "late": late},
        )

    def _offers(self, is_recording: bool) -> tuple[Offer, ...]:
        if is_recording:
            return (
                Offer(command="keep", title="End and keep"),
                Offer(command="discard", title="Throw away"),
            )
        record = Offer(
            command="record",
            title="Record an episode",
            arguments=self._given,
            inputs={
                "data_set": Input(label="Data set"),
                "task": Input(label="Task"),
                "camera": Input(label="Camera"),
                "fps": Input(label="Frames a second", choices=RATES),
            },
        )
        if self._kept is None:
            return (record,)
        mode = self._rig.arm.state.mode
        replay = Offer(
            command="replay",
            title=f"Replay episode {self._kept[1]}",
            asks="The arm moves to its start, then along it. Go?",
            why_not=None if mode is Mode.HOLDING else f"the arm is {mode.words}",
        )
        return record, replay

    # Recording

    def _record(
        self, data_set: str = "", task: str = "", camera: str = "", fps: str = RATES[0]
    ) -> None:
        """Begin an episode; returns when it is being recorded."""
        if self._sampler is not None:
            raise NotPossibleNow("record", "an episode is being recorded")
        if not task.strip():
            raise ConfigError("task", "", "the task is missing; say in a few words what is done")
        if not data_set.strip():
            raise ConfigError("data_set", "", "the data set has no name; give one, such as me/pick")
        if fps not in RATES:
            raise ConfigError("fps", fps, f"must be one of {', '.join(RATES)} frames a second")
        self._given = {"data_set": data_set, "task": task, "camera": camera, "fps": fps}
        wanted = {"data_set": data_set.strip(), "camera": camera.strip(), "fps": int(fps)}
        self._trouble, self._doing = "", "Starting LeRobot and the camera"
        try:
            if self._writer is None or self._writer.problem or self._writer.wanted != wanted:
                self._close_writer()
                self._writer = _Writer(wanted)
            self._writer.ask({"begin": task.strip()}, OPENED_WITHIN)
            self._ending.clear()
            sampler = threading.Thread(target=self._sample, name="so101-episode", daemon=True)
            self._sampler = sampler
            sampler.start()
        finally:
            self._doing = ""

    def _sample(self) -> None:
        """Hand the writer a frame a period, until the end. A period that was missed is made up."""
        rig, writer = self._rig, self._writer
        assert writer is not None
        in_numbers = _Numbers(rig)
        begun, done = time.monotonic(), 0
        while not self._ending.wait(max(0.0, begun + done / writer.fps - time.monotonic())):
            now = rig.arm.state
            measured, wanted = in_numbers(now.q, now.q_jaw), in_numbers(now.q_ref, now.q_jaw_ref)
            due = int((time.monotonic() - begun) * writer.fps) + 1
            for k in range(done, due):
                t = begun + k / writer.fps
                writer.tell({"t": t, "state": measured, "wanted": wanted})
            done = due
            if rig.connection.problem is not None:
                self._trouble = "the arm is disconnected; keep what came before, or throw it away"
            elif done > LONGEST * writer.fps:
                self._trouble = f"no episode is longer than {LONGEST:.0f} s; keep it"
            if self._trouble or writer.problem:
                return

    def _keep(self) -> Mapping[str, Any]:
        """End the episode and save it; may take a while."""
        writer = self._end_sampling()
        if writer is None:
            raise NotPossibleNow("keep", "no episode is being recorded")
        self._trouble, self._doing = "", "Saving the episode"
        try:
            facts = writer.ask({"keep": True}, SAVED_WITHIN)
        finally:
            self._doing = ""
        self._kept = Path(facts["root"]), facts["episodes"] - 1
        told = _counted(facts["frames"], facts["late"])
        self.say(f"episode {self._kept[1]} is in {facts['root']}: {told}", "good", **facts)
        return facts

    def _discard(self) -> None:
        """End the episode; the data set stays as it was."""
        writer = self._end_sampling()
        self._trouble = ""
        if writer is not None:
            writer.ask({"discard": True}, SAVED_WITHIN)
            self.say("the episode is thrown away; the data set is as it was")

    def _end_sampling(self) -> _Writer | None:
        """The writer of the episode that ends here; None without one."""
        sampler, self._sampler = self._sampler, None
        if sampler is None:
            return None
        self._ending.set()
        sampler.join()
        return self._writer

    def _close_writer(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()

    # Replay

    def _replay(self) -> Mapping[str, Any]:
        """Move to the start of the newest episode and along it; returns when the arm rests."""
        from so101_motion.tasks import datasets
        from so101_motion.tasks.datasets.units import DEGREES

        if self._kept is None:
            raise NotPossibleNow("replay", "no episode has been recorded yet")
        (root, number), rig = self._kept, self._rig
        units = datasets.units_of(DEGREES, datasets.replay.calibration_of(rig))
        self._doing = "Replaying"
        try:
            planned = datasets.plan_episode(rig, datasets.open_data_set(root), number, units=units)
            outcome = datasets.replay_episode(rig, planned)
        finally:
            self._doing = ""
        off = max(outcome.differences.rms_deg.values())
        self.say(f"replayed {planned.duration:.1f} s, {off:.1f}° off at most (RMS of a joint)")
        return {"duration_s": planned.duration, "rms_deg": off}


class _Numbers:
    """Turns angles [rad] into LeRobot's numbers: degrees by its calibration, the jaw 0 to 100."""

    def __init__(self, rig: Rig) -> None:
        from so101_motion.tasks.datasets.replay import calibration_of
        from so101_motion.tasks.datasets.units import DEGREES, units_of

        self._units = units_of(DEGREES, calibration_of(rig))
        self._closed, self._opened = rig.gripper.closed, rig.gripper.opened

    def __call__(self, q: Array, q_jaw: float) -> list[float]:
        arm = self._units.from_model(np.append(q, 0.0))[:5].tolist()
        opened = (q_jaw - self._closed) / (self._opened - self._closed)
        return [*arm, 100.0 * min(max(opened, 0.0), 1.0)]


class _Writer:
    """The plugin's process that writes. ``frames`` and ``late`` count those of this episode.

    ``WorkerError`` if it cannot start, with its own words where it has said why.
    """

    def __init__(self, wanted: Mapping[str, Any]) -> None:
        self.wanted, self.fps = wanted, wanted["fps"]
        self.frames = self.late = 0
        self.problem = ""  # why it has ended; empty while it runs
        self._answers: SimpleQueue[Mapping[str, Any]] = SimpleQueue()
        self._child = spawn(
            _WRITER, json.dumps(wanted), stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self._hearing = threading.Thread(target=self._hear, name="so101-episode-writer")
        self._hearing.start()
        try:
            self._wait(OPENED_WITHIN)
        except BaseException:
            self.close()
            raise

    def tell(self, told: Mapping[str, Any]) -> None:
        """Send it a line; one that has ended says so by ``problem``."""
        try:
            stream = cast("IO[bytes]", self._child.stdin)
            stream.write(json.dumps(told).encode() + b"\n")
            stream.flush()
        except (OSError, ValueError):
            self._hearing.join()

    def ask(self, told: Mapping[str, Any], within: float) -> Mapping[str, Any]:
        """Send it a line and wait for the answer; ``WorkerError`` without one."""
        if "begin" in told:
            self.frames = self.late = 0
        self.tell(told)
        return self._wait(within)

    def close(self) -> None:
        """End it; an episode that was not kept is discarded."""
        with suppress(OSError):  # it has ended already
            cast("IO[bytes]", self._child.stdin).close()
        try:
            self._child.wait(SAVED_WITHIN)
        finally:
            self._child.kill()
            self._hearing.join()

    def _wait(self, within: float) -> Mapping[str, Any]:
        try:
            answer = self._answers.get(timeout=within)
        except Empty:
            self._child.kill()
            raise WorkerError(f"LeRobot's process did not answer within {within:.0f} s") from None
        if "ready" not in answer:
            raise WorkerError(self.problem)
        return cast("Mapping[str, Any]", answer["ready"])

    def _hear(self) -> None:
        with cast("IO[bytes]", self._child.stdout) as stream:
            for line in stream:
                said = json.loads(line)
                if "frames" in said:
                    self.frames, self.late = said["frames"], said["late"]
                else:
                    self.problem = said.get("error", "")
                    self._answers.put(said)
        self.problem = self.problem or "LeRobot's process has ended; the log says why"
        self._answers.put({})


def _counted(frames: int, late: int) -> str:
    return f"{frames} frames, {late} of them late" if late else f"{frames} frames, none late"
