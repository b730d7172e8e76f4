"""Make plans in a separate process, and replace it when it dies.

Planning holds the interpreter lock for milliseconds at a time, and a control loop in the same
process then misses its ticks. So the planner lives in a child: it is started once, loads the model
and the libraries while the parent is already answering, and from then on takes a ``PlanRequest``
and gives back a ``Plan`` or the error it raised. Both are plain values.

Cancelling a future gives its plan up: a request that waits is dropped, one that is being worked on
ends within milliseconds, so the newest never waits for those that it has superseded. A child that
dies or hangs is replaced, and what it was asked is asked again, once.

The child's end is ``planning_child.py``; between the two, ``planning_process.py`` and
``plan_messages.py``.
"""

from __future__ import annotations

import logging
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

from so101_motion.arm.planning_process import HANG_TIMEOUT, ChildDied, PlanningProcess
from so101_motion.common.errors import WorkerError

if TYPE_CHECKING:
    from so101_motion.planning.request import Plan, PlanRequest

_log = logging.getLogger(__name__)

_ATTEMPTS = 2
"""So many children are asked the same before it is taken as at fault itself. Chosen."""

_CLOSED = "the planning process has been closed; open the arm again"


class PlanningWorker:
    """The planning process, started when it is needed and again when it has died.

    The child starts with the first call of ``start`` or ``plan``. Every method may be called from
    any thread; requests are served in order.

    Args:
        hang_timeout: After how long without a sign of life the child hangs [s].
    """

    def __init__(self, hang_timeout: float = HANG_TIMEOUT) -> None:
        self._requests = ThreadPoolExecutor(max_workers=1, thread_name_prefix="so101-planning")
        self._lock = threading.Lock()
        self._process: PlanningProcess | None = None
        self._hang_timeout = hang_timeout
        self._deaths = 0
        self._closed = False

    def start(self) -> Future[None]:
        """Start the child in the background; done when it is ready to plan without delay."""
        return self._ask(None)

    def plan(self, request: PlanRequest) -> Future[Plan]:
        """Plan in the child.

        The future raises what ``Planner.plan`` raises, or ``WorkerError`` when the child cannot be
        started, dies again and again, or is closed. Cancelling the future gives the plan up, even
        while it is being made.
        """
        answer: Future[Plan] = self._ask(request)
        answer.add_done_callback(self._take_notice)
        return answer

    @property
    def pid(self) -> int | None:
        """The child's process id, or None while there is none."""
        process = self._process
        return process.pid if process is not None else None

    def close(self) -> None:
        """End the child; what is being planned fails with ``WorkerError``. May be called twice."""
        with self._lock:
            self._closed = True
            process = self._process
        if process is not None:
            process.kill()
        self._requests.shutdown(wait=True)
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.close()

    def _ask(self, request: PlanRequest | None) -> Future[Any]:
        """A plan, or only a child that is ready; None if nothing is to be planned."""
        answer: Future[Any] = Future()
        with self._lock:
            closed = self._closed
            if not closed:
                self._requests.submit(self._serve, answer, request)
        if closed:
            answer.set_exception(WorkerError(_CLOSED))
        return answer

    def _take_notice(self, answer: Future[Plan]) -> None:
        """Wake the child if this is what it works on."""
        process = self._process
        if answer.cancelled() and process is not None:
            process.wake()

    # The thread that talks to the child

    def _serve(self, answer: Future[Any], request: PlanRequest | None) -> None:
        if answer.cancelled():
            return
        outcome: Plan | BaseException | None
        try:
            outcome = self._outcome(answer, request)
        except Exception as error:  # whoever waits must hear of it
            outcome = error
        if not answer.set_running_or_notify_cancel():
            return
        if isinstance(outcome, BaseException):
            answer.set_exception(outcome)
        else:
            answer.set_result(outcome)

    def _outcome(self, answer: Future[Any], request: PlanRequest | None) -> Plan | None:
        """The plan, or None where none was asked for or it was given up."""
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
            self._replace_dead(old, ChildDied("ended while it had nothing to do"))
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
            f"the planning process has failed {self._deaths} times in a row; the last one {death}."
            " Ask for something else, or with fewer things around; if that fails too, see the log"
            " and run so101 doctor"
        )
        _log.error("%s", message)
        return WorkerError(message)
