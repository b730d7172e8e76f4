"""Write what an arm does and a camera sees into a LeRobot data set, for the page's Record tab.

Runs in a process of its own, so that LeRobot, the camera and the encoder never have the interpreter
of the control loop. It is told on standard input, a line of JSON each: ``{"begin": TASK}``,
``{"t": ..., "state": [...], "wanted": [...]}`` once a frame, then ``{"keep": true}`` or
``{"discard": true}``. It answers each with a line. The end of the input discards the episode.

The action of a frame is where the arm was sent by the time of the next one, as of a person who
leads it: an action that is where the arm is already would teach a policy to stand still.

Each episode that is kept is finished at once, so the data set can be read whatever happens later.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.cameras.opencv import OpenCVCamera, OpenCVCameraConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.constants import ACTION, HF_LEROBOT_HOME, OBS_STR
from lerobot.utils.feature_utils import build_dataset_frame, hw_to_dataset_features

from lerobot_robot_so101_motion.robot import SO101Motion
from lerobot_robot_so101_motion.units import KEYS
from so101_motion.common.realtime import restore_normal_priority

CAMERA = "front"  # the name of the camera in the data set
WRITERS = 4  # threads that write pictures, as lerobot-record has for a camera
NICENESS = 10  # how much it gives way to the arm's process; chosen
OLDEST_MS = 500  # an older picture than this means that the camera is gone [ms]; LeRobot's own


class EpisodeWriter:
    """Opens the camera and checks the data set; writes nothing before the first frame.

    Args:
        data_set: A folder, if it begins with ``/``, ``.`` or ``~``; else a name such as me/pick.
        camera: An index, a device or an address; empty for none.
        fps: Frames a second.

    Raises:
        ValueError: The data set cannot be appended to; the text says why.
        ConnectionError: The camera cannot be opened.
    """

    def __init__(self, data_set: str, camera: str, fps: int) -> None:
        is_folder = data_set.startswith(("/", ".", "~"))
        self.root = Path(data_set).expanduser() if is_folder else HF_LEROBOT_HOME / data_set
        self._name = "/".join(self.root.parts[-2:]) if is_folder else data_set
        self._fps, self._is_new = fps, not self.root.exists()
        self._data_set: Any = None
        self._camera = _open_camera(camera) if camera else None
        joints: dict[str, Any] = dict.fromkeys(KEYS, float)
        seen = {**joints}
        if self._camera is not None:
            try:
                self._camera.connect()
            except (ConnectionError, RuntimeError) as error:
                reason = "cannot be opened; check that it is on, and that no other program has it"
                raise ConnectionError(f"the camera {camera} {reason}") from error
            seen[CAMERA] = (self._camera.height, self._camera.width, 3)
        self._features = {
            **hw_to_dataset_features(joints, ACTION),
            **hw_to_dataset_features(seen, OBS_STR),
        }
        self.episodes = 0 if self._is_new else self._check()

    @property
    def facts(self) -> dict[str, Any]:
        return {"root": str(self.root), "episodes": self.episodes}

    def begin(self, task: str) -> None:
        """Begin an episode."""
        self._task, self._is_new = task, not self.root.exists()
        self.frames = self.late = 0
        self._picture: object = None
        self._frame: dict[str, Any] | None = None  # the newest, which has no action yet
        threads = {"image_writer_threads": WRITERS if self._camera is not None else 0}
        if not self._is_new:
            self._check()
            self._data_set = LeRobotDataset.resume(self._name, self.root, **threads)
            return
        self._data_set = LeRobotDataset.create(
            self._name, self._fps, self._features, self.root, SO101Motion.name, **threads
        )

    def add(self, t: float, state: list[float], wanted: list[float]) -> None:
        """Add a frame of time ``t``, ``time.monotonic`` [s], with the camera's newest picture.

        ``wanted`` is where the arm is sent then, the action of the frame before. A frame counts as
        late if its picture is that of the frame before, or taken more than a period after ``t``.
        ``TimeoutError`` if the camera sends no pictures any more.
        """
        if self._frame is not None:
            action = np.array(wanted, dtype=np.float32)
            self._data_set.add_frame({**self._frame, ACTION: action, "task": self._task})
            self.frames += 1
        values: dict[str, Any] = dict(zip(KEYS, state, strict=True))
        is_late = time.monotonic() - t > 1.0 / self._fps
        if self._camera is not None:
            picture = self._camera.read_latest(OLDEST_MS)
            is_late |= picture is self._picture
            self._picture = values[CAMERA] = picture
        self._frame = build_dataset_frame(self._features, values, OBS_STR)
        self.late += is_late

    def keep(self) -> dict[str, Any]:
        """Save the episode and finish the files; ``ValueError`` if it has no frame yet."""
        if not self.frames:
            raise ValueError("the episode has no frame yet, so it is thrown away")
        data_set, self._data_set = self._data_set, None
        data_set.save_episode()
        data_set.finalize()
        self._is_new, self.episodes = False, self.episodes + 1
        return {**self.facts, "frames": self.frames, "late": self.late}

    def discard(self) -> None:
        """Leave the data set as it was before the episode; one that began with it is gone."""
        data_set, self._data_set = self._data_set, None
        if data_set is None:
            return
        data_set.clear_episode_buffer()
        data_set.finalize()
        if self._is_new:
            shutil.rmtree(self.root)

    def close(self) -> None:
        self.discard()
        if self._camera is not None:
            self._camera.disconnect()

    def _check(self) -> int:
        """How many episodes the data set has; ``ValueError`` if this one would not fit."""
        try:
            info = json.loads((self.root / "meta" / "info.json").read_text())
            version, robot = str(info["codebase_version"]), info["robot_type"]
            fps, episodes, known = info["fps"], info["total_episodes"], info["features"]
        except (OSError, ValueError, KeyError, TypeError):
            raise ValueError(f"{self.root} is there and is no data set; name another") from None
        why = ""
        if not version.startswith("v3"):
            why = f"it has version {version}, not v3"
        elif robot != SO101Motion.name:
            why = f"it was recorded with {robot}, not {SO101Motion.name}"
        elif fps != self._fps:
            why = f"it has {fps} frames a second, not {self._fps}"
        elif not episodes:
            why = "it has no episode"
        elif _shapes(known) != _shapes(self._features):
            why = f"it has {_shapes(known)}, not {_shapes(self._features)}"
        if why:
            raise ValueError(f"{self.root} cannot be appended to: {why}; name another")
        return int(episodes)


def _shapes(features: Mapping[str, Any]) -> str:
    wanted = sorted(key for key in features if key == ACTION or key.startswith(OBS_STR))
    return ", ".join(f"{key} {'x'.join(map(str, features[key]['shape']))}" for key in wanted)


def _open_camera(camera: str) -> OpenCVCamera:
    # An address stays text: as a Path it would lose one of its slashes.
    where: Any = camera if "://" in camera else Path(camera)
    return OpenCVCamera(OpenCVCameraConfig(int(camera) if camera.isdigit() else where))


def main() -> None:
    """In the child: open what the arguments name, then do what each line of the input says."""
    restore_normal_priority()
    with suppress(AttributeError):  # not on this system
        os.nice(NICENESS)
    logging.basicConfig(level=logging.WARNING)
    answers = os.dup(1)
    os.dup2(2, 1)  # what a library prints is for the log
    with os.fdopen(answers, "w", buffering=1) as stream:

        def say(**said: Any) -> None:
            with suppress(BrokenPipeError):
                stream.write(json.dumps(said) + "\n")

        try:
            _serve(say)
        except Exception as error:
            say(error=str(error) or type(error).__name__)


def _serve(say: Callable[..., None]) -> None:
    writer = EpisodeWriter(**json.loads(sys.argv[1]))
    try:
        say(**writer.facts)
        for line in sys.stdin:
            told = json.loads(line)
            if "begin" in told:
                writer.begin(told["begin"])
                say(**writer.facts)
            elif "keep" in told:
                say(**writer.keep())
            elif "discard" in told:
                writer.discard()
                say(**writer.facts)
            else:
                writer.add(**told)
                say(frames=writer.frames, late=writer.late)
    finally:
        writer.close()
