"""Write the motions of ``so101 sweep plans`` as MCAP, for Foxglove, Rerun and PlotJuggler.

ROS 2 messages, radians, one motion after the other, with times that begin at 0:

- ``/joint_commands`` (``sensor_msgs/msg/JointState``): setpoints and velocities of the five arm
  joints and the gripper;
- ``/motion`` (``std_msgs/msg/String``), at the begin of each: JSON with the number of its problem,
  its ``duration_s``, ``room_mm`` and the number of its scene;
- ``/scene``, when it changes: the scene file of the plans, as JSON;
- ``/sweep``, once: the parameters of the data set, without scenes and given problems.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from so101_motion.arm.gripper import JAW_CLOSED, JAW_OPEN
from so101_motion.common.errors import ConfigError
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_mm, to_rad
from so101_motion.files import atomic
from so101_motion.files.trajectory_export import JOINT_STATE, STRING, joint_state, mcap_writer
from so101_motion.tasks.sweeps.folder import SweepFolder
from so101_motion.tasks.sweeps.motion_problems import scene_of_shard
from so101_motion.tasks.sweeps.plans import Episode, episodes

PAUSE = 1.0
"""Pause between two motions, because the next one begins somewhere else [s]. Chosen."""

_NAMES = (*ARM_JOINTS, GRIPPER_JOINT)

_LONG = ("scenes", "problems")


def write_mcap(
    folder: Path, path: Path, *, first: int = 0, count: int | None = None
) -> tuple[int, float]:
    """Write motions of a sweep of plans to one file; memory does not grow with their number.

    Args:
        folder: The folder of the sweep, complete or not.
        path: The file; an existing one is replaced in one step.
        first: The number of the first problem.
        count: How many problems; None for all. Those without a motion are left out.

    Returns:
        How many motions were written, and how long they take with the pauses between them [s].

    Raises:
        ConfigError: The folder has no such sweep, the file cannot be written, or MCAP needs a
            package that is not installed.
    """
    manifest: dict[str, Any] = SweepFolder(folder).manifest()
    writer = mcap_writer(path)
    try:
        with atomic.replacing(path) as file, writer(file) as out:
            lines = _Lines(out, manifest.get("facts", {}))
            for episode in episodes(folder, first=first, count=count):
                lines.add(episode)
    except OSError as error:
        raise ConfigError("out", str(path), f"cannot be written: {error.strerror}") from error
    return lines.motions, 1e-9 * lines.now


class _Lines:
    """Writes motions to an open MCAP file.

    Attributes:
        motions: How many have been written.
        now: Time at which the next one begins [ns].
    """

    def __init__(self, out: Any, facts: Mapping[str, Any]) -> None:
        self.motions = self.now = 0
        self._out, self._frames = out, 0
        self._states = out.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        self._texts = out.register_msgdef("std_msgs/msg/String", STRING)
        self._scenes, self._scatter = facts.get("scenes", []), facts.get("scatter", 0.0)
        self._seed, self._of_a_shard = facts.get("seed", 0), facts.get("problems_of_a_shard", 1)
        self._scene: int | None = None
        self._say("/sweep", {name: each for name, each in facts.items() if name not in _LONG})

    def add(self, episode: Episode) -> None:
        """Write a motion."""
        shard = episode.problem // self._of_a_shard
        scene = shard if self._scatter else shard % len(self._scenes)
        if scene != self._scene:
            self._say("/scene", scene_of_shard(self._scenes, self._scatter, self._seed, shard))
            self._scene = scene
        duration = float(episode.timestamp[-1])
        self._say(
            "/motion",
            {
                "problem": episode.problem,
                "duration_s": round(duration, 3),
                "room_mm": round(to_mm(episode.room), 1),
                "scene": scene,
            },
        )
        action = episode.action.astype(float)
        q, qd = to_rad(action), to_rad(episode.velocity.astype(float))
        q[:, 5] = JAW_CLOSED + 0.01 * action[:, 5] * (JAW_OPEN - JAW_CLOSED)
        for at, q_now, qd_now in zip(episode.timestamp.tolist(), q, qd, strict=True):
            at_ns = self.now + round(at * 1e9)
            message = joint_state(at_ns, _NAMES, q_now, np.append(qd_now, 0.0))
            self._out.write_message(
                "/joint_commands", self._states, message, at_ns, at_ns, self._frames
            )
            self._frames += 1
        self.now += round((duration + PAUSE) * 1e9)
        self.motions += 1

    def _say(self, topic: str, content: object) -> None:
        message = {"data": json.dumps(content)}
        self._out.write_message(topic, self._texts, message, self.now, self.now, self.motions)
