"""Run a sweep: hand out its shards, write the results, and resume where an earlier run ended.

An executor computes; only this process writes, and only whole shards. A shard that fails is
recorded with the reason; the next run tries it again. A worker process that dies is replaced, and
its shard runs again. At Ctrl-C shards under way end and are written.
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
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from so101_motion.common.errors import ConfigError, MachineUnavailable, WorkerError
from so101_motion.common.realtime import LOOK_FOR_SIGNALS
from so101_motion.tasks.sweeps.folder import SweepFolder, combined
from so101_motion.tasks.sweeps.sweep import Outcome, Sweep, compute, digest

_AHEAD = 3  # shards under way for each worker: one in work, and the next ones. Chosen.
_AHEAD_OF_DASK = 4  # the same for each thread of a cluster: some are always on the network. Chosen.
_PATIENCE = 10.0  # how long a scheduler may take to answer [s]. Chosen.
_DEATHS = 3  # A shard fails when its process has died so often. Chosen.
_IN_A_ROW = 4  # if so many shards in a row get lost, the executor is at fault. Chosen.

_KEPT = "; finished shards are kept: run the same sweep into the same folder to go on"


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """The progress of a sweep."""

    done: int  # finished shards
    failed: int  # shards that failed
    shards: int
    rate: float  # items a second since this run began; 0 before the first
    left: float | None  # how long the rest takes at that rate [s]; None before the first


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepResult:
    """The result of a run."""

    folder: Path  # the folder of its shards
    shards: int  # how many shards the sweep has
    computed: int  # how many this run has computed; the others were there
    failed: dict[int, str]  # why shards are missing, by number
    sha256: str  # the SHA-256 of the result


def run_sweep(
    sweep: Sweep,
    folder: Path,
    *,
    workers: int | None = None,
    executor: Executor | None = None,
    ahead: int = 32,
    on_progress: Callable[[Progress], None] | None = None,
    now: Callable[[], float] = time.monotonic,
) -> SweepResult:
    """Run a sweep, or the rest of it after an interrupted run.

    The result is the same, bit for bit, on all computers of one kind (processor, system, versions)
    and with any number of workers.

    Args:
        sweep: The sweep.
        folder: The folder for the shards; a new one, or that of the same sweep.
        workers: How many processes of this computer. A script that uses this needs
            ``if __name__ == "__main__":`` around its own work, because Python's processes import
            it again.
        executor: Computes instead: any ``concurrent.futures.Executor``, for example a
            ``WorkerPool`` for several sweeps, or
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
    if workers is not None:
        if executor is not None:
            raise ValueError("give workers or an executor, not both")
        with WorkerPool(workers) as pool:
            return run_sweep(
                sweep, folder, executor=pool, ahead=pool.ahead, on_progress=on_progress, now=now
            )
    place = SweepFolder(folder)
    with place.opened_for(sweep):
        digests = {}
        for shard in range(sweep.shards):
            columns = place.read(shard)
            if columns is not None:
                digests[shard] = digest(columns)
        return _Run(sweep, place, digests, executor, ahead, on_progress, now).go()


class _Run:
    def __init__(
        self,
        sweep: Sweep,
        folder: SweepFolder,
        digests: dict[int, str],
        executor: Executor | None,
        ahead: int,
        on_progress: Callable[[Progress], None] | None,
        now: Callable[[], float],
    ) -> None:
        self._sweep, self._folder, self._executor = sweep, folder, executor
        self._ahead = 1 if executor is None else ahead
        self._on_progress, self._now = on_progress, now
        self._digests, self._before = digests, len(digests)
        self._failed: dict[int, str] = {}
        self._todo = deque(each for each in range(sweep.shards) if each not in digests)
        self._in_a_row = 0
        self._under_way: dict[Future[Outcome], int] = {}
        self._began = now()

    def go(self) -> SweepResult:
        try:
            while self._todo or self._under_way:
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
        while self._todo and len(self._under_way) < self._ahead:
            shard = self._todo.popleft()
            try:
                self._under_way[self._submit(shard)] = shard
            except BrokenExecutor as error:
                raise WorkerError(f"the executor broke ({error}){_KEPT}") from error

    def _submit(self, shard: int) -> Future[Outcome]:
        if self._executor is not None:
            return self._executor.submit(pickle.loads, pickle.dumps(_Call(self._sweep, shard)))
        done: Future[Outcome] = Future()
        done.set_result(compute(self._sweep, shard))
        return done

    def _collect(self) -> None:
        """Take results that are ready; wait for one if none is."""
        if not self._under_way:
            return
        ready, _ = wait(self._under_way, LOOK_FOR_SIGNALS, FIRST_COMPLETED)
        for future in ready:
            shard = self._under_way.pop(future)
            try:
                outcome = future.result()
            except CancelledError as error:
                raise WorkerError(f"the executor gave up a shard{_KEPT}") from error
            except Exception as error:  # not the shard's own: those are outcomes
                self._lose(shard, f"{type(error).__name__}: {error}", error)
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


class _Call:
    """A shard to compute where it is unpickled, so that a scheduler passes it on as bytes.

    Dask's scheduler unpickles everything else: it loaded the robot model, two seconds of its one
    core.
    """

    def __init__(self, sweep: Sweep, shard: int) -> None:
        self._arguments = sweep, shard

    def __reduce__(self) -> tuple[Callable[[Sweep, int], Outcome], tuple[Sweep, int]]:
        return compute, self._arguments


class WorkerPool(Executor):
    """Processes of this computer, each of which is replaced when it dies.

    They start when needed, by default on all cores but one. Each is a pool with a thread that waits
    for it, so it is known which call it died of. ``ahead`` shards are best under way in it.
    """

    def __init__(self, workers: int | None = None) -> None:
        workers = workers or max(1, (os.cpu_count() or 1) - 1)
        self.ahead = _AHEAD * workers
        self._threads = ThreadPoolExecutor(workers)
        self._idle = SimpleQueue[ProcessPoolExecutor | None]()
        for _ in range(workers):
            self._idle.put(None)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function in a process; ``BrokenExecutor`` if it kills one after the other."""
        return self._threads.submit(self._run, partial(fn, *args, **kwargs))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes after their present calls."""
        self._threads.shutdown(cancel_futures=cancel_futures)
        while not self._idle.empty():
            if (process := self._idle.get()) is not None:
                process.shutdown()

    def _run(self, call: Callable[[], Any]) -> Any:
        for _ in range(_DEATHS):
            process: ProcessPoolExecutor | None
            process = self._idle.get() or ProcessPoolExecutor(1, _SPAWN, _begin)
            try:
                return process.submit(call).result()
            except BrokenExecutor:
                process.shutdown()
                process = None
            finally:
                self._idle.put(process)
        raise BrokenExecutor("its process died: killed, or out of memory")


_SPAWN = multiprocessing.get_context("spawn")  # a fork would copy locks of threads and libraries


def _begin() -> None:
    """Prepare a process: Ctrl-C is for its parent, and without that it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


@contextmanager
def dask_executor(address: str) -> Iterator[tuple[Executor, int]]:
    """An executor on a Dask cluster, and how many shards to have under way in it.

    Its workers need this package, in the same version. Raises ``ConfigError`` without Dask, and
    ``MachineUnavailable`` if no scheduler answers there, or it has no workers.
    """
    try:
        import distributed
    except ImportError as error:
        reason = "needs dask and distributed; try: pip install 'so101-motion[cluster]'"
        raise ConfigError("dask", address, reason) from error
    try:
        connect: Any = distributed.Client
        client = connect(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise MachineUnavailable(address, f"no Dask scheduler answers: {error}") from error
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            reason = f"its Dask scheduler has no workers; start some: dask worker {address}"
            raise MachineUnavailable(address, reason)
        # pure=False: Dask would otherwise return a cached result for a shard that it knows.
        yield client.get_executor(pure=False), _AHEAD_OF_DASK * threads
