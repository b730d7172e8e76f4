"""Share one planning process between everything in this process that plans.

It imports little, so that the planning process can be started before an arm has been imported.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from so101_motion.arm.planning_worker import PlanningWorker
from so101_motion.common import interrupts

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
