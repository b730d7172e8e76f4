"""Run a teleoperation from start to stop, and handle the loss of either side.

Measurements go to the predictor, and the follower asks the pilot, on their I/O threads. The
follower calls ``look`` in every period; one worker thread does what that finds to do. After a fault
the session goes on when the leader has been brought back; a stop, or a motion that another caller
asked for, ends it.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from so101_motion.common.clock import Clock
from so101_motion.common.errors import Interrupted
from so101_motion.common.units import to_deg
from so101_motion.tasks.teleop.pilot import HORIZON, LOST_AFTER, Mirror, Pace, Phase, Pilot
from so101_motion.tasks.teleop.predictor import LONGEST, Predictor
from so101_motion.tasks.teleop.recording import RecordedSample, Recorder
from so101_motion.tasks.teleop.sides import Follower, Leader, Side, SideState

_log = logging.getLogger(__name__)

RETRY = 0.5  # how long to wait after a failed attempt to follow [s]; chosen

MISSED = 0.5
"""A period counts as failed when the leader has been silent for this share of ``lost_after``;
chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """The state of a session."""

    phase: Phase  # the phase of the follower
    reason: str  # why it waits, or why the session ended; empty otherwise
    cycles: int  # periods since the start
    consecutive_errors: int  # periods in a row, up to now, in which one side did not answer
    last_error: str  # the last error, however long ago; empty if there was none
    gap: tuple[str, float]  # the joint farthest from where the leader wants it, and how far [rad]
    beyond: tuple[str, ...]  # joints that the leader wants beyond the follower's range
    held_by: tuple[str, ...]  # what is in its way: ``"the jaw close to the floor"``
    is_gripping: bool  # whether its jaw has closed on something
    leader_is_limp: bool  # whether the leader can be moved by hand
    recorded: int | None  # rows written to the record; None without one

    @property
    def is_running(self) -> bool:
        return self.phase is not Phase.STOPPED

    def to_json(self) -> dict[str, Any]:
        joint, gap = self.gap
        return {
            "running": self.is_running,
            "cycles": self.cycles,
            "consecutive_errors": self.consecutive_errors,
            "last_error": self.last_error,
            "state": self.phase.value,
            "streaming": self.phase is Phase.MIRRORING,
            "reason": self.reason,
            "gap_joint": joint,
            "gap_deg": round(to_deg(gap), 2),
            "beyond_range": list(self.beyond),
            "held_back": bool(self.held_by),
            "held_by": list(self.held_by),
            "gripping": self.is_gripping,
            "leader_limp": self.leader_is_limp,
            "recorded": self.recorded,
        }


class Teleop:
    """Lets one arm follow another. Any thread may call; the methods block until done.

    Use it in a ``with`` block or call ``close``.

    Args:
        leader: The leader.
        follower: The follower.
        clock: The clock of both.
        mirror: Maps the leader's angles to the follower's.
        pace: The follower's caps.
        horizon: How far ahead the leader is predicted [s].
        lost_after: The follower holds when the leader has not answered for so long [s].

    Attributes:
        job: The last job that the worker thread got from ``look``; None before the first.
    """

    def __init__(
        self,
        leader: Leader,
        follower: Follower,
        clock: Clock,
        *,
        mirror: Mirror | None = None,
        pace: Pace | None = None,
        horizon: float = HORIZON,
        lost_after: float = LOST_AFTER,
    ) -> None:
        self._leader, self._follower, self._clock = leader, follower, clock
        self._predictor = Predictor(longest=max(LONGEST, 1.5 * lost_after))
        self._mirror = mirror or Mirror()
        self._pilot = Pilot(
            clock,
            self._predictor,
            self._mirror,
            pace or Pace(),
            horizon=horizon,
            lost_after=lost_after,
        )
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="so101-teleop")
        self.job: Future[None] | None = None
        self._recorder: Recorder | None = None
        self._unheard_after = MISSED * lost_after
        self._cycles = self._errors = 0
        self._last_error = self._ended_by = ""
        self._retry_at = -np.inf
        self._closed = threading.Event()

    def start(self, recorder: Recorder | None = None) -> None:
        """Release the leader and bring the follower to it; does nothing while it runs.

        The recorder is closed when the session ends. ``So101Error`` if one side cannot be used.
        """
        self._pool.submit(self._begin, recorder).result()

    def stop(self) -> None:
        """Bring the follower to rest; both hold. Does nothing when it does not run."""
        self._pool.submit(self._end, "").result()

    def close(self) -> None:
        """Stop and end the session's own thread; may be called again."""
        if not self._closed.is_set():
            self._closed.set()
            self._pool.submit(self._end, "").result()
            self._pool.shutdown(wait=True)

    def __enter__(self) -> Teleop:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def status(self) -> Status:
        """The state of the session; never waits."""
        gate, follower = self._pilot.gate, self._follower.state
        return Status(
            phase=gate.phase,
            reason=gate.reason or self._ended_by,
            cycles=self._cycles,
            consecutive_errors=self._errors,
            last_error=self._last_error,
            gap=gate.gap,
            beyond=self._pilot.beyond,
            held_by=follower.held_by,
            is_gripping=follower.is_gripping,
            leader_is_limp=self._leader.state.is_limp,
            recorded=self._recorder.rows if self._recorder is not None else None,
        )

    # The worker thread

    def _begin(self, recorder: Recorder | None) -> None:
        if self._is_running:
            return
        self._predictor.reset()
        self._cycles = self._errors = 0
        self._last_error = self._ended_by = ""
        self._retry_at = -np.inf
        try:
            self._leader.attach(self._predictor)
            self._follower.attach(self._pilot, self.look)
            self._follower.engage()  # it holds until the pilot begins
        except BaseException:
            self._let_go()
            raise
        self._recorder = recorder
        self._pilot.begin()

    def _end(self, reason: str) -> None:
        if not self._is_running:
            return
        self._pilot.stop()
        self._ended_by = reason
        self._let_go()
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.close()

    def _let_go(self) -> None:
        for step in (self._follower.detach, self._leader.detach):
            try:
                step()
            except Exception as error:  # it holds, or cannot be reached
                self._note(error)

    def _engage(self) -> None:
        try:
            self._follower.engage()
        except Exception as error:  # a driver's own, too
            self._note(error)
            self._pilot.trouble(str(error))
            self._retry_at = self._clock.now() + RETRY

    def _recover(self, side: Side) -> None:
        try:
            side.recover()
        except Exception as error:
            self._note(error)
            self._retry_at = self._clock.now() + RETRY

    # The follower's I/O thread

    def look(self) -> None:
        """Start and stop the follower as needed; brief, called in every period."""
        if not self._is_running:
            return
        is_busy = self.job is not None and not self.job.done()
        error = None if is_busy else self._follower.ending()
        follower, now = self._follower.state, self._clock.now()
        self._count(follower, now)
        self._record(follower, now)
        if is_busy:
            return
        if isinstance(error, Interrupted):
            self._note(error)
            self._submit(partial(self._end, f"ended by {error.by} of the follower"))
            return
        if error is not None:
            self._note(error)
            self._pilot.trouble(str(error))
            return
        may_try = now >= self._retry_at
        if not follower.is_engaged:
            if may_try and follower.is_there and self._pilot.may_begin(follower.x[:5]):
                self._submit(self._engage)
            return
        if follower.held_by:
            self._pilot.hold_back()
        if may_try and follower.needs_recovery:
            self._submit(partial(self._recover, self._follower))
        elif may_try and self._leader.state.needs_recovery:
            self._submit(partial(self._recover, self._leader))

    def _submit(self, job: Callable[[], None]) -> None:
        if not self._closed.is_set():
            self.job = self._pool.submit(job)

    def _count(self, follower: SideState, now: float) -> None:
        self._cycles += 1
        track = self._predictor.track
        is_heard = track is not None and now - track.t_heard < self._unheard_after
        self._errors = 0 if is_heard and follower.is_there else self._errors + 1

    def _record(self, follower: SideState, now: float) -> None:
        recorder = self._recorder
        if recorder is None or self._predictor.track is None:
            return
        leader = self._leader.state
        action = np.append(self._mirror.of(leader.x[:5]), leader.x[5])
        phase = self._pilot.gate.phase.value
        recorder.take(
            RecordedSample(t=now, leader=leader, action=action, follower=follower, state=phase)
        )

    # How

    @property
    def _is_running(self) -> bool:
        return self._pilot.gate.phase is not Phase.STOPPED

    def _note(self, error: BaseException) -> None:
        self._last_error = str(error)
        _log.warning("teleoperation: %s", error)
