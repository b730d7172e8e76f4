"""Make plans in separate processes, and replace one when it dies.

Planning holds the interpreter lock for milliseconds at a time, and a control loop in the same
process then misses its ticks. So the planner lives in a child, which is started once, loads the
model and the libraries while the parent is already answering, and takes plain values.

Cancelling a future gives its plan up: a request that waits is dropped, one that is being worked on
ends within milliseconds. A child that dies or hangs is replaced, and what it was asked is asked
again, once.

Arms that share a worker do not wait for each other, nor does an easy request for a hard one: copies
of the child make the plans, in parallel, and the child itself only makes copies, at once because it
sleeps; one that searches takes up to a second on a busy computer. One copy waits for the next
request, others end when they have nothing to do. Measured here: a copy takes 6 ms and, after ten
seconds of search, 4 MB; a further child 430 ms and 48 MB.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, overload

from so101_motion.arm.planning_process import CAN_COPY, HANG_TIMEOUT, ChildDied, PlanningProcess
from so101_motion.common import interrupts
from so101_motion.common.attributes import checked_kind, checked_number
from so101_motion.common.errors import So101Error, WorkerError

if TYPE_CHECKING:
    from so101_motion.planning.cell.team_requests import TeamTask
    from so101_motion.planning.request import Plan, PlanRequest

_log = logging.getLogger(__name__)

CLOSED = "this planner, or its arm, has been closed; open it again"

T = TypeVar("T")

_ATTEMPTS = 2  # a request fails when so many children have died of it in a row; chosen

SHARE = 4
"""Most plans that are made at a time for one owner, where children are copied. Chosen: a client may
ask for any number of previews, and each takes the memory of a copy."""

_MOST_CHILDREN = 32  # most children in all; chosen: eight arms with their share


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
        workers: How many processes at the most; each takes 110 MB.
        copies: Whether copies of the first one make the plans, as many as are asked for.

    Raises:
        ConfigError: ``workers`` is less than 1.
    """

    def __init__(
        self, hang_timeout: float = HANG_TIMEOUT, *, workers: int = 1, copies: bool = False
    ) -> None:
        checked_number("workers", workers, lower=1)
        self._lock = threading.Lock()  # guards what follows
        self._slots = [_ChildSlot(hang_timeout, self._begin_more) for _ in range(workers)]
        self._idle = list(reversed(self._slots))
        self._hang_timeout, self._copies = hang_timeout, copies
        self._waiting: list[_Asked] = []
        self._owners: Counter[object] = Counter()  # of the requests being served
        self._closed = False
        self._threads = set[threading.Thread]()

    def start(self) -> Future[None]:
        """Start a child in the background; done when it is ready to plan without delay."""
        return self.plan(None)

    @overload
    def plan(self, request: PlanRequest, owner: object = None) -> Future[Plan]: ...

    @overload
    def plan(self, request: TeamTask[T]) -> Future[T]: ...

    @overload
    def plan(self, request: None) -> Future[None]: ...

    def plan(
        self, request: PlanRequest | TeamTask[Any] | None, owner: object = None
    ) -> Future[Any]:
        """Plan in a child, for an owner: an arm; or for several arms at once.

        The future raises what ``Planner.plan`` raises, or ``WorkerError`` when the child cannot be
        started, dies again and again, or is closed. Cancelling the future gives the plan up, even
        while it is being made. Without a request a child is only made ready.
        """
        answer: Future[Any] = Future()
        with self._lock:
            if self._closed:
                answer.set_exception(WorkerError(CLOSED))
            else:
                self._waiting.append(_Asked(answer, request, owner))
                if (taken := self._next()) is not None:
                    self._thread_for(taken).start()
        answer.add_done_callback(self._take_notice)
        return answer

    def plan_many(self, requests: Iterable[PlanRequest]) -> PlannedBatch:
        """Plan several in as many children as there are; their outcomes come in order."""
        from so101_motion.planning.request import PlanRequest

        every = [checked_kind("requests", e, PlanRequest, "PlanRequests") for e in requests]
        return PlannedBatch([self.plan(each) for each in every])

    @property
    def pids(self) -> tuple[int, ...]:
        """The ids of the processes that live."""
        with self._lock:
            slots = tuple(self._slots)
        return tuple(pid for each in slots if (pid := each.pid) is not None)

    def close(self) -> None:
        """End the children; plans under way fail with ``WorkerError``. May be called twice."""
        with self._lock:
            self._closed = True
            waiting, self._waiting = self._waiting, []
            slots = tuple(self._slots)
            threads = self._threads - {threading.current_thread()}
        for each in slots:
            each.kill()
        for asked in waiting:
            if asked.answer.set_running_or_notify_cancel():
                asked.answer.set_exception(WorkerError(CLOSED))
        for thread in threads:
            thread.join()
        for each in slots:
            each.close()

    def _begin_more(self) -> None:
        with self._lock:
            while not self._closed and (taken := self._next()) is not None:
                self._thread_for(taken).start()

    def _take_notice(self, answer: Future[Any]) -> None:
        """Wake the children if a request was cancelled: one of them may be working on it."""
        if answer.cancelled():
            with self._lock:
                slots = tuple(self._slots)
            for each in slots:
                each.wake()

    # The threads that talk to the children

    def _thread_for(self, taken: tuple[_Asked, _ChildSlot]) -> threading.Thread:
        """A thread that serves a request, and then what waits; the lock is held."""
        thread = threading.Thread(target=self._serve, args=taken, name="so101-planning")
        self._threads.add(thread)
        return thread

    def _serve(self, asked: _Asked, slot: _ChildSlot) -> None:
        """Serve a request, and then what waits for it."""
        taken: tuple[_Asked, _ChildSlot] | None = asked, slot
        while taken is not None:
            asked, slot = taken
            outcome: object = None
            try:
                if not asked.answer.cancelled():
                    outcome = slot.outcome(asked.answer, asked.request)
            except Exception as error:  # the caller must get it
                outcome = error
            with self._lock:
                self._owners -= Counter((asked.owner,))
                self._idle.append(slot)
                taken = self._next()  # before it is decided whether one too many waits
                waiting = [each for each in self._idle if each.is_copy]
                is_kept = slot not in waiting or len(waiting) == 1
                if not is_kept:
                    self._idle.remove(slot)
            if not asked.answer.set_running_or_notify_cancel():
                pass
            elif isinstance(outcome, BaseException):
                asked.answer.set_exception(outcome)
            else:
                asked.answer.set_result(outcome)
            if not is_kept:  # a new one costs less than the memory of one that waits
                slot.close()
            with self._lock:
                if not is_kept:
                    self._slots.remove(slot)
                taken = taken or self._next()  # it may have come since
                if taken is None:
                    self._threads.discard(threading.current_thread())

    def _next(self) -> tuple[_Asked, _ChildSlot] | None:
        """The first request that may be served now, and by which child; the lock is held."""
        self._waiting = [each for each in self._waiting if not each.answer.cancelled()]
        for asked in self._waiting:
            slot = self._free_for(asked)
            if slot is not None:
                self._waiting.remove(asked)
                self._owners[asked.owner] += 1
                return asked, slot
        return None

    def _free_for(self, asked: _Asked) -> _ChildSlot | None:
        first = self._slots[0]
        if self._copies and self._owners[asked.owner] >= SHARE:
            return None
        copies = self._copies and asked.request is not None and first.is_ready
        for slot in reversed(self._idle):  # the one used last is warm
            if slot is not first or not (copies and CAN_COPY):
                self._idle.remove(slot)
                return slot
        if not copies or len(self._slots) >= _MOST_CHILDREN:
            return None
        self._slots.append(_ChildSlot(self._hang_timeout, self._begin_more, first))
        return self._slots[-1]


class _Asked(NamedTuple):
    answer: Future[Any]
    request: PlanRequest | TeamTask[Any] | None
    owner: object


class _ChildSlot:
    """One child, replaced when it dies. One thread at a time, but any for ``wake`` and ``kill``."""

    def __init__(
        self,
        hang_timeout: float,
        on_ready: Callable[[], None],
        original: _ChildSlot | None = None,
    ) -> None:
        self._lock = threading.Lock()
        self._on_ready, self._original = on_ready, original
        self._process: PlanningProcess | None = None
        self._hang_timeout = hang_timeout
        self._deaths = 0
        self._closed = False

    @property
    def is_ready(self) -> bool:
        process = self._process
        return process is not None and process.is_ready and process.pid is not None

    @property
    def is_copy(self) -> bool:
        """Whether its child is a copy of another's, where one can be made."""
        return self._original is not None

    @property
    def pid(self) -> int | None:
        process = self._process
        return process.pid if process is not None else None

    def wake(self) -> None:
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
        self._on_ready()

    def _living(self) -> tuple[PlanningProcess, bool]:
        """A child that lives, and whether it was started just now."""
        old = self._process
        if old is not None and old.pid is None:
            self._replace_dead(old, ChildDied(f"{old.ending()} while it had nothing to do"))
        with self._lock:
            if self._closed:
                raise WorkerError(CLOSED)
            if self._process is not None:
                return self._process, False
        process = self._copied() or PlanningProcess(self._hang_timeout)
        with self._lock:
            closed = self._closed
            if not closed:
                self._process = process
        if closed:
            process.close()
            raise WorkerError(CLOSED)
        return process, not process.is_ready

    def _copied(self) -> PlanningProcess | None:
        """A copy of the original's child, if that is ready and makes one."""
        original = None if self._original is None else self._original._process
        if original is None or not original.is_ready or not CAN_COPY:
            return None
        try:
            return PlanningProcess(self._hang_timeout, original)
        except (ChildDied, OSError) as error:
            _log.warning("the planning process %s; a new one is started", error)
            return None

    def _replace_dead(self, process: PlanningProcess, death: ChildDied) -> None:
        with self._lock:
            self._process = None
            closed = self._closed
        process.close()
        if closed:
            raise WorkerError(CLOSED) from death
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


_worker_lock = threading.Lock()
_worker: PlanningWorker | None = None
_worker_users = 0


def acquire_worker() -> PlanningWorker:
    """The planning process that all rigs share; give it back with ``release_worker``."""
    global _worker, _worker_users
    with _worker_lock:
        if _worker is None:
            _worker = PlanningWorker(copies=True)
        _worker_users += 1
        return _worker


@contextmanager
def planner_started() -> Iterator[None]:
    """Start the planning process in the background, and keep it at least until this block ends.

    A verb or a page that will plan starts it before it imports and opens an arm, which takes as
    long. Later, it would hold every file that is open here while it starts, so the arm's port would
    seem to be in use.
    """
    is_acquired = False
    try:
        with interrupts.held():  # raises after it
            acquire_worker().start()
            is_acquired = True
        yield
    finally:
        if is_acquired:
            release_worker()


def release_worker() -> None:
    """Give the planning process back; the last user ends it."""
    global _worker, _worker_users
    with _worker_lock:
        _worker_users -= 1
        if _worker_users > 0:
            return
        worker, _worker = _worker, None
    if worker is not None:
        worker.close()
