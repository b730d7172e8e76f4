"""Record the path of a guided arm from the snapshots of the I/O thread.

A hand that rests adds no points. The recording ends by itself when manual mode ends.
"""

from __future__ import annotations

import threading
from concurrent.futures import Future

import numpy as np

from so101_motion.arm.gripper import Gripper
from so101_motion.common.errors import MotionError
from so101_motion.common.modes import Mode
from so101_motion.common.state import ARM_JOINTS, JointState
from so101_motion.common.units import to_rad
from so101_motion.control.executor import Executor
from so101_motion.tasks.guided.path import GuidedPath

STEP = to_rad(0.25)  # of a joint between two points [rad]; chosen: not quite three ticks
JAW_STEP = 0.01  # the same for the jaw, share of its travel; chosen

REST = 0.1
"""Without a new point for so long the arm rested [s]; chosen. The end of a rest is a point as well,
so that it is known what moved first."""

MOST = 60_000  # the recording ends with so many points, ten minutes of constant motion. Chosen.

_ENDED = {
    Mode.LIMP: "the arm was released",
    Mode.CALIBRATING: "the servos are being set up",
}


class PathRecorder:
    """Records the path of an arm in manual mode, from now on. Any thread may use it.

    ``future`` completes with the path when the recording is over: by ``end``, or by itself, and
    then ``ended_by`` tells why. Without a gripper the jaw is left out. ``MotionError`` if the arm
    is not in manual mode.
    """

    def __init__(self, executor: Executor, gripper: Gripper | None = None) -> None:
        state = executor.state
        if state.mode not in (Mode.GUIDING, Mode.LIMP):
            raise MotionError(
                "a path is recorded while a hand guides the arm, but the arm is"
                f" {state.mode.value}; enter manual mode first"
            )
        self.future: Future[GuidedPath] = Future()
        self.future.set_running_or_notify_cancel()
        self.ended_by = ""
        self._mode, self._gripper, self._lock = state.mode, gripper, threading.Lock()
        self._newest = self._row(state)
        self._rows = [self._newest]
        end_listening = executor.listen(self._hear)
        self.future.add_done_callback(lambda _: end_listening())

    @property
    def points(self) -> int:
        """How many points have been recorded."""
        return len(self._rows)

    @property
    def path(self) -> GuidedPath:
        """The path so far; the arm's present configuration is its end."""
        with self._lock:
            rows = list(self._rows)
            if rows[-1] is not self._newest and self._newest[0] > rows[-1][0]:
                rows.append(self._newest)
        table = np.array(rows)
        jaw = None if self._gripper is None else table[:, 6]
        return GuidedPath(t=table[:, 0] - table[0, 0], q=table[:, 1:6], aperture=jaw)

    def end(self) -> GuidedPath:
        """End the recording, if it has not ended; the arm stays in manual mode."""
        self._end("")
        return self.future.result()

    # How

    def _hear(self, state: JointState) -> None:
        """Record a snapshot; on the I/O thread."""
        if self.future.done():
            return
        if state.mode is not self._mode:
            self._end(state.fault or _ENDED.get(state.mode, "manual mode ended"))
        elif state.t > self._newest[0] and not state.reading.unanswered.intersection(ARM_JOINTS):
            self._take(self._row(state))
            if self.points >= MOST:
                self._end(f"a recording may have at most {MOST} points")

    def _row(self, state: JointState) -> tuple[float, ...]:
        jaw = 0.0 if self._gripper is None else min(max(self._gripper.aperture, 0.0), 1.0)
        return (state.t, *state.q.tolist(), jaw)

    def _take(self, row: tuple[float, ...]) -> None:
        with self._lock:
            before, self._newest = self._newest, row
            last = self._rows[-1]
            moved = max(abs(row[i] - last[i]) for i in range(1, 6))
            if moved < STEP and abs(row[6] - last[6]) < JAW_STEP:
                return
            if before[0] - last[0] > REST:
                self._rows.append(before)  # where it rested
            self._rows.append(row)

    def _end(self, why: str) -> None:
        path = self.path
        with self._lock:
            if self.future.done():
                return
            self.ended_by = why
            self.future.set_result(path)
