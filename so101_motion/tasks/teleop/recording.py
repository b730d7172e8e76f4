"""Record both arms of a teleoperation: MCAP for viewers, CSV for learning.

``docs/teleoperation.md`` has the columns and topics. Rows come from an I/O thread, which must not
wait for a disk, so another thread writes them.
"""

from __future__ import annotations

import contextlib
import csv
import logging
import math
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from so101_motion.common.errors import ConfigError
from so101_motion.common.geometry import Array, frozen_array
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.common.units import to_deg
from so101_motion.files.trajectory_export import JOINT_STATE, STRING, joint_state, mcap_writer
from so101_motion.tasks.teleop.sides import SideState

_log = logging.getLogger(__name__)

JOINTS = (*ARM_JOINTS, GRIPPER_JOINT)

FPS = 100.0  # rows a second by default [1/s]: each period of the bus
_BACKLOG = 6000  # rows that may wait for the disk, a minute's; further ones are counted and dropped


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedSample:
    """One row of a recording."""

    t: float  # time on the session's clock [s]
    leader: SideState
    action: Array  # the target it gives the follower: joint angles [rad] and aperture, shape (6,)
    follower: SideState
    state: str  # its phase, as in ``Status.phase``; only while it mirrors is the target an action


class Recorder:
    """Writes rows to a file until closed.

    Args:
        path: Ends with ``.mcap`` or ``.csv``; what was there is replaced.
        epoch: The wall clock's time when the session's clock showed 0 [s].
        middles: The follower's angles in the middle of its joints' recorded travels, shape (5,),
            [rad]; LeRobot's zero.
        fps: How many rows a second, at most those of the session.

    Attributes:
        rows: How many have been written.
        lost: How many could not be, because the disk did not keep up.

    Raises:
        ConfigError: There is no such format, the file cannot be written, or MCAP needs a package
            that is not installed.
    """

    def __init__(
        self, path: Path, *, epoch: float = 0.0, middles: Array | None = None, fps: float = FPS
    ) -> None:
        if not 0.1 <= fps <= 1000.0:
            raise ConfigError("fps", fps, "must be a number from 0.1 to 1000")
        self.rows = self.lost = 0
        self._path, self._fps = path, fps
        zero = frozen_array(np.zeros(5) if middles is None else middles, (5,))
        self._file = _opened(path, epoch, fps, zero)
        self._t0: float | None = None
        self._taken = 0
        self._queue: queue.Queue[RecordedSample | None] = queue.Queue(_BACKLOG)
        self._thread = threading.Thread(target=self._write, name="so101-recorder", daemon=True)
        self._thread.start()

    def take(self, row: RecordedSample) -> None:
        """Record ``row`` if one is due; never waits. Times must not go back."""
        if self._t0 is None:
            self._t0 = row.t
        due = math.floor((row.t - self._t0) * self._fps + 0.5) + 1
        # A gap in time is filled with the row after it, because frames are counted without gaps.
        for _ in range(due - self._taken):
            try:
                self._queue.put_nowait(row)
                self._taken += 1
            except queue.Full:
                self.lost += 1
                return

    def close(self) -> None:
        """Write the rest and close the file; may be called again."""
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()

    def _write(self) -> None:
        try:
            while (row := self._queue.get()) is not None:
                self._file.write(self.rows, row)
                self.rows += 1
            self._file.close()
        except OSError as error:
            _log.error("%s cannot be written any more: %s", self._path, error)
            with contextlib.suppress(OSError):
                self._file.close()


class _Csv:
    def __init__(self, path: Path, fps: float, middles: Array) -> None:
        self._fps, self._zero = fps, np.append(middles, 0.0)
        self._file = open(path, "w", newline="", encoding="utf-8")  # noqa: SIM115  # closed below
        self._out = csv.writer(self._file)
        groups = (
            ("action", "pos"), ("observation.state", "pos"),
            ("leader", "pos"), ("leader", "goal"), ("follower", "goal"),
            ("leader", "load"), ("follower", "load"),
        )  # fmt: skip
        self._out.writerow(
            ["timestamp", "frame_index", "episode_index"]
            + [f"{group}.{joint}.{what}" for group, what in groups for joint in JOINTS]
            + ["state"]
        )

    def write(self, index: int, row: RecordedSample) -> None:
        leader, follower = row.leader, row.follower
        positions = (row.action, follower.x, leader.x, leader.x_goal, follower.x_goal)
        loads = (leader.loads, follower.loads)
        self._out.writerow(
            [f"{index / self._fps:.6f}", index, 0]
            + [f"{value:.4f}" for x in positions for value in self._in_lerobots_units(x)]
            + [f"{value:.3f}" for group in loads for value in group or [math.nan] * len(JOINTS)]
            + [row.state]
        )

    def _in_lerobots_units(self, x: Array) -> list[float]:
        angles = to_deg(x - self._zero)
        angles[5] = 100.0 * x[5]
        return [float(value) for value in angles]

    def close(self) -> None:
        self._file.close()


class _Mcap:
    def __init__(self, path: Path, epoch: float) -> None:
        self._epoch = epoch
        writer = mcap_writer(path)
        self._file = open(path, "wb")  # noqa: SIM115  # closed below
        self._out = writer(self._file)
        self._schema = self._out.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        self._text = self._out.register_msgdef("std_msgs/msg/String", STRING)

    def write(self, index: int, row: RecordedSample) -> None:
        at_ns = round((self._epoch + row.t) * 1e9)
        for topic, x, loads in (
            ("/leader/joint_states", row.leader.x, row.leader.loads),
            ("/leader/joint_commands", row.leader.x_goal, ()),
            ("/follower/joint_states", row.follower.x, row.follower.loads),
            ("/follower/joint_commands", row.follower.x_goal, ()),
        ):
            message = joint_state(at_ns, JOINTS, x, effort=loads)
            self._out.write_message(topic, self._schema, message, at_ns, at_ns, index)
        state = {"data": row.state}
        self._out.write_message("/follower/state", self._text, state, at_ns, at_ns, index)

    def close(self) -> None:
        self._out.finish()
        self._file.close()


def _opened(path: Path, epoch: float, fps: float, middles: Array) -> _Csv | _Mcap:
    kinds: dict[str, Callable[[], _Csv | _Mcap]] = {
        ".csv": lambda: _Csv(path, fps, middles),
        ".mcap": lambda: _Mcap(path, epoch),
    }
    kind = kinds.get(path.suffix.lower())
    if kind is None:
        raise ConfigError("record", str(path), f"must end with one of {', '.join(kinds)}")
    try:
        return kind()
    except OSError as error:
        raise ConfigError("record", str(path), f"cannot be written: {error.strerror}") from error
