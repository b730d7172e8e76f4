"""Record episodes for LeRobot as an operation, whatever moves the arm meanwhile; replay them.

A thread reads the newest state of the arm once a frame, and hands it to a process of the plugin,
which has LeRobot, the camera and the files. The control loop waits for nothing of this.
"""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any, cast

from so101_motion.common.child_process import spawn
from so101_motion.common.errors import ConfigError, NotPossibleNow, WorkerError
from so101_motion.common.geometry import Array
from so101_motion.common.modes import Mode
from so101_motion.common.operation import Input, LocalOperation, Offer, View
from so101_motion.rig.rig import Rig

LONGEST = 600.0  # longest episode [s]; chosen: what a forgotten recording may take of a disk
OPENED_WITHIN = 180.0  # how long LeRobot and the camera may take to start [s]; seen: 5 to 70
ADDED_WITHIN = 10.0  # how long a frame may take [s]; chosen
SAVED_WITHIN = 600.0  # how long an episode may take to be encoded and saved [s]; chosen
FAR_OFF_DEG = 2.0  # a joint that was farther off wants higher caps [deg]; chosen
RATES = ("30", "15", "60")  # frames a second that are offered

_WRITER = "lerobot_robot_so101_motion.episode_writer"
_WELCOME = "Press Record an episode, then move the arm from any tab, by a leader or by hand."
_NOTE = (
    "Data set: a name such as me/pick, or a folder. Camera: 0, /dev/video0 or http://...; none"
    " if left empty."
)
_STARTING = "The episode begins as soon as LeRobot is ready."
_CANCELLED = "cancelled; nothing was recorded"
_NOTHING_MOVES = (Mode.FAULT, Mode.CALIBRATING)
_RECORDING = "Recording. Move the arm from any tab, then keep the episode or throw it away."
_MISSING = (
    "LeRobot, which records the episodes, is not installed here. The lines below, in the folder of"
    " this project, make an environment that has it (Python 3.12 or newer, 7 GB of disk). The last"
    " one starts the page from there: end this program first, and give your own options."
)
_INSTALL = """\
python3.12 -m venv .venv-lerobot
.venv-lerobot/bin/pip install "lerobot[core-scripts,feetech]" ".[viewer,dataset]" \
./lerobot_robot_so101_motion
.venv-lerobot/bin/so101 view --port /dev/ttyACM0"""
_FROM_WHEELS = (
    "From a release: the two .whl files in place of the last two names, the first with"
    " [viewer,dataset] behind it. docs/lerobot.md, Install, tells more."
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
        self._starts = False  # whether LeRobot is being started
        self._frames = self._late = 0  # of this episode
        self._kept: tuple[Path, int] | None = None  # the data set, and its newest episode
        self.commands = {
            "record": self._record,
            "cancel": self._cancel,
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
    def recorded(self) -> float | None:
        """How much of an episode is recorded so far [s]; None while none is recorded."""
        writer = self._writer
        return None if writer is None or self._sampler is None else self._frames / writer.fps

    @property
    def view(self) -> View:
        if not self._is_installed:
            return View(state="missing", text=_MISSING, to_copy=_INSTALL, note=_FROM_WHEELS)
        recorded, text = self.recorded, _STARTING if self._starts else _WELCOME
        is_recording = recorded is not None
        if recorded is not None:
            text = f"{_RECORDING} {recorded:.1f} s, {_counted(self._frames, self._late)}."
        return View(
            state="recording" if is_recording else "starting" if self._starts else "idle",
            text=text,
            trouble=self._trouble,
            doing=self._doing,
            note="" if is_recording else _NOTE,
            offers=self._offers(is_recording),
            said=self.said,
            facts={"frames": self._frames, "late": self._late},
        )

    def _offers(self, is_recording: bool) -> tuple[Offer, ...]:
        if is_recording:
            return (
                Offer(command="keep", title="End and keep"),
                Offer(command="discard", title="Throw away"),
            )
        if self._starts:
            return (Offer(command="cancel", title="Cancel", cancels=True),)
        mode = self._rig.arm.state.mode
        record = Offer(
            command="record",
            title="Record an episode",
            why_not=f"the arm is {mode.words}" if mode in _NOTHING_MOVES else None,
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
        self._trouble, self._starts, writer = "", True, self._writer
        self._doing = "Starting LeRobot" + (" and the camera" if wanted["camera"] else "")
        try:
            if writer is None or writer.problem or writer.wanted != wanted:
                self._close_writer()
                writer = self._writer = _Writer(wanted)
                if not self._starts:  # cancelled while the one before was closed
                    writer.end(_CANCELLED)
                writer.ask(OPENED_WITHIN)
            writer.ask(OPENED_WITHIN, begin=task.strip())
            self._frames = self._late = 0
            self._ending.clear()
            sampler = threading.Thread(target=self._sample, name="so101-episode", daemon=True)
            self._sampler = sampler
            sampler.start()
        except BaseException:
            self._close_writer()
            if writer is None or writer.problem != _CANCELLED:
                raise
        finally:
            self._doing, self._starts = "", False
        if self._sampler is None:
            self.say(_CANCELLED)

    def _cancel(self) -> None:
        """End LeRobot's process while it starts."""
        starts, self._starts, writer = self._starts, False, self._writer
        if starts and writer is not None:
            writer.end(_CANCELLED)

    def _sample(self) -> None:
        """Hand the writer a frame a period, until the end. A period that was missed is made up."""
        from so101_motion.tasks.datasets.replay import calibration_of
        from so101_motion.tasks.datasets.units import DEGREES, units_of

        rig, writer = self._rig, self._writer
        assert writer is not None
        units, jaw = units_of(DEGREES, calibration_of(rig)), rig.gripper
        span = jaw.opened - jaw.closed

        def in_numbers(q: Array, q_jaw: float) -> list[float]:
            return units.numbers(q, min(max((q_jaw - jaw.closed) / span, 0.0), 1.0))

        begun, done = time.monotonic(), 0
        while not self._ending.wait(max(0.0, begun + done / writer.fps - time.monotonic())):
            now = rig.arm.state
            measured, wanted = in_numbers(now.q, now.q_jaw), in_numbers(now.q_ref, now.q_jaw_ref)
            due = int((time.monotonic() - begun) * writer.fps) + 1
            try:
                for k in range(done, due):
                    t = begun + k / writer.fps
                    so_far = writer.ask(ADDED_WITHIN, t=t, state=measured, wanted=wanted)
                    self._frames, self._late = so_far["frames"], so_far["late"]
            except WorkerError as error:
                self._trouble = str(error)
            done = due
            if rig.connection.problem is not None:
                self._trouble = "the arm is disconnected; keep what came before, or throw it away"
            elif done > LONGEST * writer.fps:
                self._trouble = f"no episode is longer than {LONGEST:.0f} s; keep it"
            if self._trouble:
                return

    def _keep(self) -> Mapping[str, Any]:
        """End the episode and save it; may take a while."""
        writer = self._end_sampling()
        if writer is None:
            raise NotPossibleNow("keep", "no episode is being recorded")
        self._trouble, self._doing = "", "Saving the episode"
        try:
            facts = writer.ask(SAVED_WITHIN, keep=True)
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
            writer.ask(SAVED_WITHIN, discard=True)
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
        from so101_motion.tasks.datasets import open_data_set, replay
        from so101_motion.tasks.datasets.units import DEGREES, units_of

        if self._kept is None:
            raise NotPossibleNow("replay", "no episode has been recorded yet")
        (root, number), rig = self._kept, self._rig
        units = units_of(DEGREES, replay.calibration_of(rig))
        self._doing = "Replaying"
        try:
            planned = replay.plan_episode(rig, open_data_set(root), number, units=units)
            outcome = replay.replay_episode(rig, planned)
        finally:
            self._doing = ""
        off = max(outcome.differences.rms_deg.values())
        hint = "; higher caps of speed and acceleration (Move) bring it closer"
        self.say(
            f"replayed {planned.duration:.1f} s, {off:.1f}° off at most (RMS of a joint)"
            f"{hint if off > FAR_OFF_DEG else ''}"
        )
        return {"duration_s": planned.duration, "rms_deg": off}


class _Writer:
    """The plugin's process that writes; one thread at a time asks it.

    ``problem`` is why it has ended, in its own words if it said any; empty while it runs.
    """

    def __init__(self, wanted: Mapping[str, Any]) -> None:
        self.wanted, self.fps, self.problem = wanted, wanted["fps"], ""
        self._child = spawn(
            _WRITER, json.dumps(wanted), stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )

    def end(self, problem: str) -> None:
        """End it at once, for this reason; any thread."""
        self.problem = problem
        self._child.kill()

    def ask(self, within: float, **told: Any) -> Mapping[str, Any]:
        """Send it a line, if there is one, and return its answer; ``WorkerError`` without one.

        A new one answers without a line, as soon as it has opened everything. It is killed if it
        does not answer ``within`` [s].
        """
        told_to, heard_from = cast("IO[bytes]", self._child.stdin), self._child.stdout
        said: dict[str, Any] = {}
        with self._killed_after(within), suppress(OSError):
            if told:
                told_to.write(json.dumps(told).encode() + b"\n")
                told_to.flush()
            said = json.loads(cast("IO[bytes]", heard_from).readline() or "{}")
        if not said or "error" in said:
            ended = "LeRobot's process has ended; the log says why"
            self.problem = self.problem or said.get("error", ended)
            raise WorkerError(self.problem)
        return said

    def close(self) -> None:
        """End it; an episode that was not kept is discarded."""
        with self._killed_after(SAVED_WITHIN), suppress(OSError), self._child:
            pass

    @contextmanager
    def _killed_after(self, seconds: float) -> Iterator[None]:
        timer = threading.Timer(seconds, self._child.kill)
        timer.start()
        try:
            yield
        finally:
            timer.cancel()


def _counted(frames: int, late: int) -> str:
    return f"{frames} frames, {late} of them late" if late else f"{frames} frames, none late"
