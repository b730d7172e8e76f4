"""Make plans in separate processes, and replace one when it dies.

Planning holds the interpreter lock for milliseconds at a time, and a control loop in the same
process then misses its ticks. So the planner lives in a child: it is started once, loads the model
and the libraries while the parent is already answering, and from then on takes a ``PlanRequest``
and gives back a ``Plan`` or the error it raised. Both are plain values.

Cancelling a future gives its plan up: a request that waits is dropped, one that is being worked on
ends within milliseconds, so the newest never waits for those that it has superseded. A child that
dies or hangs is replaced, and what it was asked is asked again, once.

One child is enough for an arm. For many plans, ask for as many as there are processors: each takes
the next request as soon as it has answered the one before.

The child's end is ``planning_child.py``; between the two, ``planning_process.py`` and
``plan_messages.py``.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, TypeVar

from so101_motion.arm.planning_process import HANG_TIMEOUT, ChildDied, PlanningProcess
from so101_motion.common.errors import ConfigError, So101Error, WorkerError

if TYPE_CHECKING:
    from so101_motion.planning.cell.team_requests import TeamTask
    from so101_motion.planning.request import Plan, PlanRequest

_log = logging.getLogger(__name__)

T = TypeVar("T")

_ATTEMPTS = 2
"""A request fails when so many children have died of it in a row. Chosen."""

_CLOSED = "the planning process has been closed; open the arm again"


class PlannedBatch:
    """The outcomes of several requests, in their order; see ``PlanningWorker.plan_many``.

    Iterating waits for one outcome after the other: a plan, or the error that says why there is
    none. It raises ``concurrent.futures.CancelledError`` at the first that was cancelled.

    Attributes:
        plans: The same as futures, to be taken in any order.
    """

    def __init__(self, plans: list[Future[Plan]]) -> None:
        self.plans = tuple(plans)

    def __iter__(self) -> Iterator[Plan | So101Error]:
        for each in self.plans:
            try:
                yield each.result()
            except So101Error as error:
                yield error

    def __len__(self) -> int:
        return len(self.plans)

    def cancel(self) -> None:
        """Give up all plans that are not made yet; those being made end within milliseconds."""
        for each in reversed(self.plans):  # else the next one would begin
            each.cancel()


class PlanningWorker:
    """One planning process or several, each started when needed and again when it has died.

    The first starts with the first call of ``start`` or ``plan``, each further one when all others
    are busy. Every method may be called from any thread; requests are begun in order.

    Args:
        hang_timeout: After how long without a sign of life a child hangs [s].
        workers: How many processes at the most; each takes 150 MB.

    Raises:
        ConfigError: ``workers`` is less than 1.
    """

    def __init__(self, hang_timeout: float = HANG_TIMEOUT, *, workers: int = 1) -> None:
        if workers < 1:
            raise ConfigError("workers", workers, "must be 1 or more")
        self._requests = ThreadPoolExecutor(workers, thread_name_prefix="so101-planning")
        self._lock = threading.Lock()
        self._slots = [_ChildSlot(hang_timeout) for _ in range(workers)]
        self._idle = list(reversed(self._slots))
        self._closed = False

    def start(self) -> Future[None]:
        """Start a child in the background; done when it is ready to plan without delay."""
        return self._ask(None)

    def plan(self, request: PlanRequest) -> Future[Plan]:
        """Plan in a child.

        The future raises what ``Planner.plan`` raises, or ``WorkerError`` when the child cannot be
        started, dies again and again, or is closed. Cancelling the future gives the plan up, even
        while it is being made.
        """
        answer: Future[Plan] = self._ask(request)
        answer.add_done_callback(self._take_notice)
        return answer

    def plan_for_team(self, task: TeamTask[T]) -> Future[T]:
        """Like ``plan``, for several arms at once."""
        answer: Future[T] = self._ask(task)
        answer.add_done_callback(self._take_notice)
        return answer

    def plan_many(self, requests: Iterable[PlanRequest]) -> PlannedBatch:
        """Plan several in as many children as there are; their outcomes come in order."""
        return PlannedBatch([self.plan(each) for each in requests])

    @property
    def pids(self) -> tuple[int, ...]:
        """The process ids of the children that live."""
        return tuple(pid for each in self._slots if (pid := each.pid) is not None)

    def close(self) -> None:
        """End the children; plans under way fail with ``WorkerError``. May be called twice."""
        with self._lock:
            self._closed = True
        for each in self._slots:
            each.kill()
        self._requests.shutdown(wait=True)
        for each in self._slots:
            each.close()

    def _ask(self, request: PlanRequest | TeamTask[Any] | None) -> Future[Any]:
        """Queue a request; None only makes a child ready."""
        answer: Future[Any] = Future()
        with self._lock:
            closed = self._closed
            if not closed:
                self._requests.submit(self._serve, answer, request)
        if closed:
            answer.set_exception(WorkerError(_CLOSED))
        return answer

    def _take_notice(self, answer: Future[Any]) -> None:
        """Wake the children if a request was cancelled: one of them may be working on it."""
        if answer.cancelled():
            for each in self._slots:
                each.wake()

    # The threads that talk to the children

    def _serve(self, answer: Future[Any], request: PlanRequest | TeamTask[Any] | None) -> None:
        if answer.cancelled():
            return
        slot = self._idle.pop()  # there are as many as threads; the one used last is warm
        outcome: object
        try:
            outcome = slot.outcome(answer, request)
        except Exception as error:  # the caller must get it
            outcome = error
        finally:
            self._idle.append(slot)
        if not answer.set_running_or_notify_cancel():
            return
        if isinstance(outcome, BaseException):
            answer.set_exception(outcome)
        else:
            answer.set_result(outcome)


class _ChildSlot:
    """One child, replaced when it dies. One thread at a time, but any for ``wake`` and ``kill``."""

    def __init__(self, hang_timeout: float) -> None:
        self._lock = threading.Lock()
        self._process: PlanningProcess | None = None
        self._hang_timeout = hang_timeout
        self._deaths = 0
        self._closed = False

    @property
    def pid(self) -> int | None:
        """The child's process id, or None while there is none."""
        process = self._process
        return process.pid if process is not None else None

    def wake(self) -> None:
        """Make the child look whether its plan is still wanted."""
        process = self._process
        if process is not None:
            process.wake()

    def kill(self) -> None:
        """End the child for good; those who wait for it get ``WorkerError``."""
        with self._lock:
            self._closed = True
            process = self._process
        if process is not None:
            process.kill()

    def close(self) -> None:
        """Forget the child after ``kill``."""
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.close()

    def outcome(self, answer: Future[Any], request: PlanRequest | TeamTask[Any] | None) -> object:
        """The plan; None if none was asked for, or it was given up."""
        for attempt in range(1, _ATTEMPTS + 1):
            process, is_new = self._living()
            try:
                if is_new:
                    self._wait_until_ready(process)
                plan = None if request is None else process.ask(request, answer.cancelled)
            except ChildDied as death:
                self._replace_dead(process, death)
                if attempt == _ATTEMPTS:
                    raise self._given_up(death) from death
            else:
                self._deaths = 0
                return plan
            if answer.cancelled():
                break
        return None

    def _wait_until_ready(self, process: PlanningProcess) -> None:
        try:
            process.wait_until_ready()
        except WorkerError as error:
            self._replace_dead(process, ChildDied(f"says: {error}"))
            raise

    def _living(self) -> tuple[PlanningProcess, bool]:
        """A child that lives, and whether it was started just now."""
        old = self._process
        if old is not None and old.pid is None:
            self._replace_dead(old, ChildDied(f"{old.ending()} while it had nothing to do"))
        with self._lock:
            if self._closed:
                raise WorkerError(_CLOSED)
            if self._process is not None:
                return self._process, False
            self._process = PlanningProcess(self._hang_timeout)
            return self._process, True

    def _replace_dead(self, process: PlanningProcess, death: ChildDied) -> None:
        with self._lock:
            self._process = None
            closed = self._closed
        process.close()
        if closed:
            raise WorkerError(_CLOSED) from death
        self._deaths += 1
        _log.warning("the planning process %s; it is replaced", death)

    def _given_up(self, death: ChildDied) -> WorkerError:
        message = (
            f"the planning process failed {self._deaths} times in a row; the last one {death}."
            " Try another goal, or a scene with fewer things; if that fails too, read the log and"
            " run so101 doctor"
        )
        _log.error("%s", message)
        return WorkerError(message)
