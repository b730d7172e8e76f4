"""How fast an atlas is computed and queried, and how many verified plans a core makes.

Rates are by processor time of one process, which other programs hardly change. The piece ``wall``
measures what two workers gain by the wall clock, in two minutes; nothing else should be running
then. ``python -m benchmarks.bench_sweep PIECE ...`` measures only some pieces, and leaves the other
rows of the result as they are; an interrupted ``large`` is resumed.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _common
from benchmarks._machine import cpu_time, memory
from benchmarks.plan_problems import SCENES
from so101_motion.tasks.sweeps import (
    Atlas,
    PlansSweep,
    Progress,
    ReachSweep,
    run_sweep,
    scene_text,
)
from so101_motion.tasks.sweeps.engine import dask_executor
from so101_motion.tasks.sweeps.sweep import Sweep

ATLAS = ReachSweep(spacing=0.01)
LARGE = ReachSweep(spacing=0.003)
WALL = ReachSweep(spacing=0.008)
PLANS = 500
REPEATS = 5
QUESTIONS = 20_000
KEPT = Path(tempfile.gettempdir()) / "so101-bench-sweep"
"""Where the large atlas grows."""


def rate(sweep: Sweep) -> float:
    """Items a second of processor time, in this process."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.process_time()
        run_sweep(sweep, Path(folder) / "out")
        return sweep.items / (time.process_time() - begin)


def atlas() -> Iterator[_common.Row]:
    """Points a second."""
    rates = [rate(ATLAS) for _ in range(3)]
    yield {"what": "atlas, 10 mm", "n": ATLAS.items, "a second and core": float(np.median(rates))}


def plans() -> Iterator[_common.Row]:
    """Verified motions a second, several times each."""
    for name in ("empty", "table", "shelf"):
        sweep = PlansSweep(count=PLANS, scenes=(scene_text(SCENES[name]),), voltage=None)
        rates = [rate(sweep) for _ in range(REPEATS)]
        median = float(np.median(rates))
        yield {
            "what": f"plans, {name}",
            "n": REPEATS * PLANS,
            "a second and core": median,
            "least": min(rates),
            "most": max(rates),
            "a night of 8 h on two cores": 2 * 8 * 3600 * median,
        }


def question() -> Iterator[_common.Row]:
    """How long an atlas takes to answer [s]."""
    with tempfile.TemporaryDirectory() as folder:
        run_sweep(ReachSweep(spacing=0.02), Path(folder) / "out")
        yield {"what": "question to an atlas", **answers(Atlas.read(Path(folder) / "out"))}


def answers(known: Atlas) -> dict[str, float]:
    """How long it takes to answer [s]; a hundred questions at a time."""
    random = np.random.default_rng(0)
    points = random.uniform((-0.3, -0.3, 0.0), (0.4, 0.3, 0.4), (QUESTIONS, 3)).tolist()

    def ask(some: list[list[float]]) -> None:
        for x, y, z in some:
            known.at(x, y, z)

    batches = [points[k : k + 100] for k in range(0, QUESTIONS, 100)]
    _, times = _common.measure(ask, batches)
    return _common.summary(np.array(times) / 100.0)


def shares() -> Iterator[_common.Row]:
    """Processor time of the process that runs a sweep, and of one worker and of two.

    What two workers gain on two free cores follows: all of it is shared by two, and one worker has
    to do all but what the running process does beside it.
    """
    spent = {}
    for workers in (1, 2):
        before = [_processor_time(who) for who in _WHO]
        wall(ATLAS, workers=workers)
        spent[workers] = [_processor_time(who) - at for who, at in zip(_WHO, before, strict=True)]
    (own, one), (also_own, two) = spent[1], spent[2]
    yield {
        "what": "atlas, 10 mm, processor time",
        "n": ATLAS.items,
        "running process [s]": own,
        "one worker [s]": one,
        "two workers [s]": two,
        "share of the running process": own / (own + one),
        "two workers, times one, from these": one / (0.5 * (also_own + two)),
    }


_WHO = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)


def _processor_time(who: int) -> float:
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def wall(sweep: Sweep, **computed_by: Any) -> float:
    """Seconds by the wall clock, processes started included; arguments as of ``run_sweep``."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        run_sweep(sweep, Path(folder) / "out", **computed_by)
        return time.perf_counter() - begin


def dask() -> Iterator[_common.Row]:
    """Processor time of a Dask scheduler, two workers and the process that runs the sweep.

    Beside the same with two processes of a pool. Started before, so that only the work counts; what
    a worker loads of the arm is part of it.
    """
    with (
        cluster() as (address, scheduler, workers),
        tempfile.TemporaryDirectory() as folder,
        dask_executor(address) as (executor, ahead),
    ):
        pids = {
            "scheduler": [scheduler.pid],
            "workers": [each.pid for each in workers],
            "running process": [os.getpid()],
        }
        before = {name: sum(map(cpu_time, of)) for name, of in pids.items()}
        run_sweep(WALL, Path(folder) / "out", executor=executor, ahead=ahead)
        spent = {name: sum(map(cpu_time, of)) - before[name] for name, of in pids.items()}
    whole = sum(spent.values())
    before_pool = sum(map(_processor_time, _WHO))
    wall(WALL, workers=2)
    pool = sum(map(_processor_time, _WHO)) - before_pool
    yield {
        "what": "atlas, 8 mm, Dask, processor time",
        "n": WALL.items,
        **{f"{name} [s]": seconds for name, seconds in spent.items()},
        "share of the scheduler": spent["scheduler"] / whole,
        "of the scheduler a shard [s]": spent["scheduler"] / WALL.shards,
        "two processes, their start included [s]": pool,
        "times the processes": whole / pool,
    }


WORKERS_SETTINGS = {
    "distributed.worker.profile.enabled": False,
    "distributed.nanny.pre-spawn-environ": {
        "MALLOC_TRIM_THRESHOLD_": 2**27,
        "MALLOC_MMAP_THRESHOLD_": 2**25,
    },
}
"""What docs/sweeps.md advises for the workers of a Dask cluster."""


def two_at_the_wall() -> Iterator[_common.Row]:
    """One worker, two, and two of a Dask LocalCluster, in turn, three times; the clock on the wall.

    The cluster is started before, with the settings that docs/sweeps.md advises; its workers load
    the arm while the clock runs, as processes do.
    """
    import dask.config
    from distributed import Client, LocalCluster

    start: Any = LocalCluster
    connect: Any = Client
    rows: dict[str, list[float]] = {"one": [], "two": [], "dask": []}
    for _ in range(3):
        for workers, name in ((1, "one"), (2, "two")):
            rows[name].append(wall(WALL, workers=workers))
        options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
        with (
            dask.config.set(WORKERS_SETTINGS),
            start(**options) as local,
            connect(local, set_as_default=False) as client,
        ):
            rows["dask"].append(wall(WALL, executor=client.get_executor(pure=False), ahead=8))
    one, two, through_dask = (float(np.median(rows[name])) for name in ("one", "two", "dask"))
    yield {
        "what": "atlas, 8 mm, wall clock",
        "n": WALL.items,
        "one worker [s]": one,
        "two workers [s]": two,
        "two workers of a LocalCluster [s]": through_dask,
        "two workers, times one": one / two,
        "LocalCluster, times two workers": through_dask / two,
        "load before": os.getloadavg()[2],
    }


@contextmanager
def cluster() -> Iterator[tuple[str, subprocess.Popen[bytes], list[subprocess.Popen[bytes]]]]:
    """A Dask scheduler and two workers of one thread; its address, and their processes."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        file = folder / "scheduler.json"
        quiet = ("--scheduler-file", str(file), "--no-dashboard", "--local-directory", str(folder))
        here = ("--host", "127.0.0.1", "--port", "0")
        scheduler = stack.enter_context(_running("dask", "scheduler", *quiet[:3], *here))
        while not file.exists() or not file.read_text():
            time.sleep(0.1)
        workers = [
            stack.enter_context(_running("dask", "worker", *quiet, "--nthreads", "1", "--no-nanny"))
            for _ in range(2)
        ]
        address = json.loads(file.read_text())["address"]
        from distributed import Client

        connect: Any = Client
        with connect(address, set_as_default=False) as client:
            client.wait_for_workers(2)
        yield address, scheduler, workers


@contextmanager
def _running(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def large() -> Iterator[_common.Row]:
    """An atlas of ten million points by two workers; memory as it grows; questions to it."""
    notes = KEPT / "notes.json"
    KEPT.mkdir(exist_ok=True)
    known: dict[str, Any] = {"spent": 0.0, "wall": 0.0, "memory": []}
    if notes.exists():
        known = json.loads(notes.read_text())
    before, begun_with = sum(map(_processor_time, _WHO)), known["spent"]
    at_start, begun_after = time.perf_counter(), known["wall"]
    own, looked = os.getpid(), 0

    def note(progress: Progress) -> None:
        nonlocal looked
        looked += 1
        if looked % 100 == 0 or progress.done == progress.shards:
            children = Path(f"/proc/{own}/task/{own}/children").read_text().split()
            most = max((memory(int(pid)) for pid in children), default=0)
            known["memory"].append([progress.done, memory(own), most])
            running = sum(cpu_time(int(pid)) for pid in children)
            known["spent"] = begun_with + sum(map(_processor_time, _WHO)) - before + running
            known["wall"] = begun_after + time.perf_counter() - at_start
            notes.write_text(json.dumps(known))

    result = run_sweep(LARGE, KEPT / "atlas", workers=2, on_progress=note)
    spent = known["spent"]
    at_first, at_last = known["memory"][0], known["memory"][-1]
    begin = time.process_time()
    whole = Atlas.read(KEPT / "atlas")
    yield {
        "what": "atlas, 3 mm",
        "n": LARGE.items,
        "processor time [s]": spent,
        "a second and core": LARGE.items / spent,
        "two workers, wall clock [s]": known["wall"],
        "load before": os.getloadavg()[2],
        "running process after 100 shards [bytes]": at_first[1],
        "running process at the end [bytes]": at_last[1],
        "worker after 100 shards [bytes]": at_first[2],
        "worker at the end [bytes]": at_last[2],
        "files [bytes]": sum(each.stat().st_size for each in (KEPT / "atlas/shards").iterdir()),
        "sha256": result.sha256,
        "to read it [s]": time.process_time() - begin,
        "read, in memory [bytes]": memory(own),
    }
    yield {"what": "question to an atlas of 3 mm", **answers(whole)}
    shutil.rmtree(KEPT)


PIECES: dict[str, Callable[[], Iterator[_common.Row]]] = {
    "atlas": atlas,
    "plans": plans,
    "question": question,
    "shares": shares,
    "dask": dask,
    "large": large,
    "wall": two_at_the_wall,
}


def main() -> None:
    """Run the pieces that are asked for, all without any, and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pieces", nargs="*", choices=[*PIECES, []], metavar="PIECE")
    wanted = parser.parse_args().pieces or PIECES
    _common.single_thread()
    for piece in wanted:
        _common.update("bench_sweep", [*PIECES[piece]()], peers=("dask", "distributed"))


if __name__ == "__main__":
    main()
