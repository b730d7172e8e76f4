"""Run a sweep: hand out its shards, write the results, and resume where an earlier run ended.

How it works. An executor of ``concurrent.futures`` computes; only this process writes. So workers
need no common file system, and nothing is written twice. A few shards more than there are workers
are under way at any time, which keeps all of them busy and bounds memory. An interruption leaves
only whole shards behind: the same sweep into the same folder computes only those that are missing.

- A shard that fails is recorded with the reason and the others go on; the next run tries it again.
- A worker process that dies (``kill -9``, out of memory) breaks its pool: the pool is replaced, and
  shards that were under way run again, one at a time, so that one that kills its process is found.
- Ctrl-C: no new shards are handed out, those under way end and are written, then the interrupt is
  raised. If this process is killed, its workers notice and end.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import wait as wait_for
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from so101_motion.common.errors import WorkerError
from so101_motion.common.realtime import LOOK_FOR_SIGNALS
from so101_motion.tasks.sweeps.folder import SweepFolder, combined
from so101_motion.tasks.sweeps.packed import digest
from so101_motion.tasks.sweeps.sweep import Outcome, Sweep, compute

_AHEAD = 3
"""Shards under way for each worker: one in work, and the next ones. Chosen."""

_DEATHS = 2
"""A shard fails when its process has died so often while it ran alone. Chosen."""

_IN_A_ROW = 4
"""If so many shards in a row get lost, the executor is at fault. Chosen."""

_KEPT = "; finished shards are kept: run the same sweep into the same folder to go on"


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """The progress of a sweep.

    Attributes:
        done: Finished shards.
        failed: Shards that failed.
        shards: All shards.
        rate: Items a second since this run began; 0 before the first.
        left: How long the rest takes at that rate [s]; None before the first.
    """

    done: int
    failed: int
    shards: int
    rate: float
    left: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepResult:
    """The result of a run.

    Attributes:
        folder: The folder of its shards.
        shards: How many shards the sweep has.
        computed: How many this run has computed; the others were there.
        failed: Why shards are missing, by number.
        sha256: The SHA-256 of the result.
    """

    folder: Path
    shards: int
    computed: int
    failed: dict[int, str]
    sha256: str


def default_workers() -> int:
    """All cores but one, at least one."""
    return max(1, (os.cpu_count() or 1) - 1)


def run_sweep(
    sweep: Sweep,
    folder: Path,
    *,
    workers: int | WorkerPool | None = None,
    executor: Executor | None = None,
    ahead: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    now: Callable[[], float] = time.monotonic,
) -> SweepResult:
    """Run a sweep, or the rest of it after an interrupted run.

    The result is the same, bit for bit, on all computers of one kind (processor, system, versions)
    and with any number of workers.

    Args:
        sweep: The sweep.
        folder: The folder for the shards; a new one, or that of the same sweep.
        workers: How many processes of this computer, or an open pool of them. A script that uses
            this needs ``if __name__ == "__main__":`` around its own work, because Python's
            processes import it again.
        executor: Computes instead: any ``concurrent.futures.Executor``, for example
            ``dask.distributed.Client(...).get_executor()``. It stays open.
        ahead: How many shards are under way in it at a time.
        on_progress: Called after each shard.
        now: Returns the time [s].

    Returns:
        The result, with the shards that failed.

    Raises:
        ConfigError: The folder belongs to another sweep, or cannot be written.
        WorkerError: The executor stopped working; the same call goes on.
        ValueError: Both ``workers`` and an executor are given.
    """
    if workers is not None and executor is not None:
        raise ValueError("give workers or an executor, not both")
    place = SweepFolder(folder)
    with place.opened_for(sweep):
        digests = {}
        for shard in range(sweep.shards):
            columns = place.read(shard)
            if columns is not None:
                digests[shard] = digest(columns)
        pool: _Backend
        if workers is not None:
            pool = WorkerPool(workers) if isinstance(workers, int) else workers
        else:
            pool = _InProcess() if executor is None else _GivenExecutor(executor, ahead or 32)
        run = _Run(sweep, place, digests, pool, on_progress, now)
        with pool.opened():
            return run.go()


class _Run:
    """One run of a sweep."""

    def __init__(
        self,
        sweep: Sweep,
        folder: SweepFolder,
        digests: dict[int, str],
        pool: _Backend,
        on_progress: Callable[[Progress], None] | None,
        now: Callable[[], float],
    ) -> None:
        self._sweep, self._folder, self._pool = sweep, folder, pool
        self._on_progress, self._now = on_progress, now
        self._digests, self._before = digests, len(digests)
        self._failed: dict[int, str] = {}
        self._todo = deque(each for each in range(sweep.shards) if each not in digests)
        self._alone: deque[int] = deque()  # to be run one at a time: their process died
        self._deaths: dict[int, int] = {}
        self._in_a_row = 0
        self._under_way: dict[Future[Outcome], int] = {}
        self._began = now()

    def go(self) -> SweepResult:
        """Compute the missing shards."""
        try:
            while self._todo or self._alone or self._under_way:
                self._hand_out()
                self._collect()
        except BaseException as error:
            self._give_up(finish=isinstance(error, KeyboardInterrupt))
            self._describe(None)
            raise
        sha256 = combined(self._digests, self._sweep.shards)
        self._describe(sha256)
        return SweepResult(
            folder=self._folder.path,
            shards=self._sweep.shards,
            computed=len(self._digests) - self._before,
            failed=self._failed,
            sha256=sha256,
        )

    def _hand_out(self) -> None:
        queue, most = (self._alone, 1) if self._alone else (self._todo, self._pool.ahead)
        while queue and len(self._under_way) < most:
            shard = queue.popleft()
            try:
                self._under_way[self._pool.submit(self._sweep, shard)] = shard
            except BrokenExecutor as error:
                queue.appendleft(shard)
                self._replace(error, [])
                return

    def _collect(self) -> None:
        """Take results that are ready; wait for one if none is."""
        if not self._under_way:
            return
        ready, _ = wait(self._under_way, LOOK_FOR_SIGNALS, FIRST_COMPLETED)
        for future in ready:
            shard = self._under_way.pop(future, None)
            if shard is None:
                continue  # it was lost with the pool
            try:
                outcome = future.result()
            except BrokenExecutor as error:
                self._replace(error, [shard])
            except CancelledError as error:
                raise WorkerError(f"the executor gave up a shard{_KEPT}") from error
            except Exception as error:  # not the shard's own: those are outcomes
                self._lose(shard, f"lost: {type(error).__name__}: {error}", error)
            else:
                self._in_a_row = 0
                self._take(shard, outcome)

    def _take(self, shard: int, outcome: Outcome) -> None:
        if outcome.shard is None:
            self._failed[shard] = outcome.why
        else:
            self._folder.write(shard, outcome.shard)
            self._digests[shard] = outcome.shard.digest
        if self._on_progress is not None:
            self._on_progress(self._progress())

    def _progress(self) -> Progress:
        done, failed = len(self._digests), len(self._failed)
        tried = done - self._before + failed
        spent = self._now() - self._began
        pace = tried / spent if spent > 0.0 else 0.0  # shards a second
        return Progress(
            done=done,
            failed=failed,
            shards=self._sweep.shards,
            rate=pace * self._sweep.items / self._sweep.shards,
            left=(self._sweep.shards - done - failed) / pace if pace else None,
        )

    def _replace(self, error: BrokenExecutor, lost: list[int]) -> None:
        """Replace a pool whose process died, and remember what was under way in it."""
        wait(self._under_way, 10.0)  # the pool says of all of them that it is broken
        alone = len(lost) + len(self._under_way) == 1
        for future, shard in self._under_way.items():
            if future.done() and not future.cancelled() and future.exception() is None:
                self._take(shard, future.result())
            else:
                lost.append(shard)
        self._under_way.clear()
        self._pool.replace(error)
        for shard in lost:
            self._deaths[shard] = self._deaths.get(shard, 0) + alone
            if self._deaths[shard] < _DEATHS:
                self._alone.append(shard)
            else:
                self._lose(shard, "its process died: killed, or out of memory", error)

    def _lose(self, shard: int, why: str, error: Exception) -> None:
        """Note that an executor lost a shard; give up when it loses one after the other."""
        self._in_a_row += 1
        if self._in_a_row >= _IN_A_ROW:
            raise WorkerError(f"one shard after the other is lost ({why}){_KEPT}") from error
        self._take(shard, Outcome(None, why))

    def _give_up(self, *, finish: bool) -> None:
        """Cancel shards that wait; with ``finish`` let those in work end, and keep them."""
        for future in self._under_way:
            future.cancel()
        kept = {each: shard for each, shard in self._under_way.items() if not each.cancelled()}
        for future in wait(kept).done if finish else ():
            if future.exception() is None:
                self._take(kept[future], future.result())

    def _describe(self, sha256: str | None) -> None:
        done = len(self._digests)
        self._folder.describe(self._sweep, done=done, failed=self._failed, sha256=sha256)


class _Backend:
    """Computes shards.

    Attributes:
        ahead: How many shards to have under way.
    """

    ahead: int

    def submit(self, sweep: Sweep, shard: int) -> Future[Outcome]:
        """Have a shard computed."""
        raise NotImplementedError

    def replace(self, error: BrokenExecutor) -> None:
        """Replace a broken executor.

        Raises:
            WorkerError: It cannot be replaced.
        """
        raise WorkerError(f"the executor broke ({error}){_KEPT}") from error

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Keep it open for a block."""
        yield


class _InProcess(_Backend):
    """Computes in this process, at once."""

    ahead = 1

    def submit(self, sweep: Sweep, shard: int) -> Future[Outcome]:
        future: Future[Outcome] = Future()
        future.set_result(compute(sweep, shard))
        return future


class _GivenExecutor(_Backend):
    """Computes on an executor of the caller."""

    def __init__(self, executor: Executor, ahead: int) -> None:
        self._executor, self.ahead = executor, ahead

    def submit(self, sweep: Sweep, shard: int) -> Future[Outcome]:
        call = pickle.dumps(_Call(sweep, shard))
        return self._executor.submit(pickle.loads, call)


class _Call:
    """Computes a shard where it is unpickled.

    A scheduler that only passes it on sees bytes and need not load this package. Dask's scheduler
    unpickles everything but bytes: it loaded the robot model, two seconds of its one core.
    """

    def __init__(self, sweep: Sweep, shard: int) -> None:
        self._arguments = sweep, shard

    def __reduce__(self) -> tuple[Callable[[Sweep, int], Outcome], tuple[Sweep, int]]:
        return compute, self._arguments


class WorkerPool(_Backend):
    """Processes of this computer, which are replaced when one of them dies.

    Args:
        workers: How many processes.
    """

    def __init__(self, workers: int) -> None:
        self._workers, self.ahead = workers, _AHEAD * workers
        self._is_open = False

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Keep them for a block, in which several sweeps may run; nested calls do nothing."""
        if self._is_open:
            yield
            return
        self._pool, self._is_open = self._new(), True
        try:
            yield
        finally:
            self._is_open = False
            self._pool.shutdown(wait=True, cancel_futures=True)

    def submit(self, sweep: Sweep, shard: int) -> Future[Outcome]:
        """Have a shard computed."""
        return self._pool.submit(compute, sweep, shard)

    def replace(self, error: BrokenExecutor) -> None:
        """Replace the processes.

        The old ones are killed: a pool waits for ever for a process that was starting when another
        died (seen with Python 3.11).
        """
        for process in self._spawned.made:
            with suppress(ValueError):  # closed already
                if process.is_alive():
                    process.kill()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._pool = self._new()

    def _new(self) -> ProcessPoolExecutor:
        self._spawned = _Spawned()
        return ProcessPoolExecutor(self._workers, mp_context=self._spawned, initializer=_begin)


class _Spawned(SpawnContext):
    """Spawns processes and remembers them; a fork would copy locks of threads and libraries.

    Attributes:
        made: All processes.
    """

    def __init__(self) -> None:
        super().__init__()
        self.made: list[BaseProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]
        """Make a process, and remember it."""
        made = SpawnProcess(*args, **kwargs)
        self.made.append(made)
        return made


def _begin() -> None:
    """Set up a worker: ignore Ctrl-C, which is the parent's, and end when the parent has."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    wait_for([sentinel])
    os._exit(1)
