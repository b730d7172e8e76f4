"""Run slow calls beside the page, one at a time; the page's thread takes their results."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, TypeVar

from so101_motion.common.errors import So101Error

T = TypeVar("T")

log = logging.getLogger(__name__)


@dataclass(slots=True, kw_only=True)
class Worker:
    """One worker thread: what runs, and why the last run failed. For the page's thread."""

    doing: str = ""
    trouble: Exception | None = None
    _workers: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(1, thread_name_prefix="so101-page-worker")
    )
    _job: tuple[Future[Any], Callable[[Any], None]] | None = None
    _look: Future[object] | None = None

    def do(
        self,
        doing: str,
        call: Callable[[], T],
        then: Callable[[T], None] = lambda _result: None,
    ) -> bool:
        """Run ``call``, unless something runs already; return whether it runs.

        ``then`` takes the result on the page's thread; after an error that is in ``trouble``.
        """
        if self._job is not None:
            return False
        self.doing, self.trouble = doing, None
        self._job = (self._workers.submit(call), then)
        return True

    def watch(self, look: Callable[[], object]) -> None:
        """Look at something, unless something runs already.

        Nobody waits for it, and errors are ignored: it is called again soon.
        """
        if self._job is None and self._look is None:
            self._look = self._workers.submit(look)

    @property
    def is_looking(self) -> bool:
        return self._look is not None

    def collect(self) -> bool:
        if self._look is not None and self._look.done():
            looked, self._look = self._look, None
            error = looked.exception()
            if error is not None and not isinstance(error, So101Error):
                log.error("the page could not look", exc_info=error)
        return self._collect_job()

    def _collect_job(self) -> bool:
        if self._job is None or not self._job[0].done():
            return False
        (future, then), self._job, self.doing = self._job, None, ""
        error = future.exception()
        if error is None:
            then(future.result())
            return True
        if not isinstance(error, So101Error):
            log.error("a command of the page failed", exc_info=error)
        assert isinstance(error, Exception)
        self.trouble = error
        return True

    def end(self) -> None:
        self._workers.shutdown(wait=True)
