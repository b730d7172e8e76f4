"""Run one motion at a time on a machine; each is a call that lasts as long as the motion.

Cancelling the call ends the motion: our module stops the arm when its caller goes away, and Stop is
sent as well to be sure. A new motion takes over from the old one without a stop between them.
Futures complete on the loop's thread, after the snapshot that shows their effect.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from so101_motion.common.errors import SUPERSEDED, Interrupted, So101Error
from so101_motion.control.request_queue import running_future
from so101_motion.viam.client.link import Link

Work = Callable[[], Awaitable[None]]


@dataclass(slots=True, kw_only=True)
class _Job:
    work: Work
    future: Future[None] = field(default_factory=running_future)
    task: asyncio.Task[None] | None = None
    ending: str | None = None
    brakes: bool = True

    def end(self, by: str, *, brakes: bool = True) -> None:
        if self.ending is None and self.task is not None:
            self.ending, self.brakes = by, brakes
            self.task.cancel()


class MotionRunner(ABC):
    """Runs one motion at a time of a component on a machine. Any thread may call."""

    def __init__(self, link: Link, refresh: Work) -> None:
        self._link, self._refresh = link, refresh
        self._job: _Job | None = None

    @abstractmethod
    async def _brake(self) -> None:
        """Stop the machine; returns at rest."""

    def begin(self, work: Work) -> Future[None]:
        """Run ``work``, which raises our errors; it replaces the motion under way."""
        job = _Job(work=work)
        self._link.post(lambda: self._start(job))
        return job.future

    def interrupt(self, motion: Future[Any], by: str) -> Future[None]:
        """End the motion whose future is ``motion``; done when it is over."""
        over = running_future()
        motion.add_done_callback(lambda _: over.set_result(None))

        def end() -> None:
            if self._job is not None and self._job.future is motion:
                self._job.end(by)

        self._link.post(end)
        return over

    def bring_to_rest(self, by: str) -> Future[None]:
        """Stop the machine, also a motion that another client began; done at rest."""
        return self._link.run(self._stop(by))

    def close(self) -> None:
        """End our own motion, if one is under way, and wait until it is over."""
        self._link.run(self._end()).result()

    # The loop's thread

    async def _end(self) -> None:
        job = self._job
        if job is not None and job.task is not None:
            job.end("shutdown")
            await asyncio.wait([job.task])

    def _start(self, job: _Job) -> None:
        if self._job is not None:
            self._job.end(SUPERSEDED, brakes=False)
        self._job = job
        job.task = asyncio.get_running_loop().create_task(self._run(job))

    async def _stop(self, by: str) -> None:
        job = self._job
        if job is not None:
            job.end(by, brakes=False)
        await self._brake()
        if job is not None and job.task is not None:
            await asyncio.wait([job.task])
        await self._refresh()

    async def _run(self, job: _Job) -> None:
        problem: BaseException | None = None
        try:
            await job.work()
        except asyncio.CancelledError:
            problem = Interrupted(job.ending or "shutdown")
            if job.brakes:
                with suppress(So101Error):  # lost: the machine stops when its caller goes away
                    await self._brake()
        except Exception as error:
            problem = error
        finally:
            if self._job is job:
                self._job = None
            with suppress(So101Error):
                await self._refresh()
            if problem is None:
                job.future.set_result(None)
            else:
                job.future.set_exception(problem)
