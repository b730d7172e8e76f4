"""Sweeps: how fast an atlas is made and asked, and how many verified plans a core makes.

Rates by processor time of one process, which neighbours on the machine do not change much; what two
workers gain by the wall clock, for which nothing else should be running.
"""

from __future__ import annotations

import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks import _common
from benchmarks.plan_problems import SCENES
from so101_motion.tasks.sweeps import Atlas, PlansSweep, ReachSweep, run_sweep, scene_text
from so101_motion.tasks.sweeps.sweep import Sweep

ATLAS = ReachSweep(spacing=0.01)
PLANS = 500
QUESTIONS = 20_000


def rate(sweep: Sweep) -> float:
    """Items a second of processor time, in this process."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.process_time()
        run_sweep(sweep, Path(folder) / "out")
        return sweep.items / (time.process_time() - begin)


def wall(sweep: Sweep, workers: int) -> float:
    """Seconds by the wall clock, processes started included."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        run_sweep(sweep, Path(folder) / "out", workers=workers)
        return time.perf_counter() - begin


def shares(sweep: Sweep) -> _common.Row:
    """Processor time of the process that runs a sweep, and of one worker and of two.

    What two workers gain on two free cores follows: all of it is shared by two, and one worker has
    to do all but what the running process does beside it.
    """
    spent = {}
    for workers in (1, 2):
        before = [_processor_time(who) for who in _WHO]
        wall(sweep, workers)
        spent[workers] = [_processor_time(who) - at for who, at in zip(_WHO, before, strict=True)]
    (own, one), (also_own, two) = spent[1], spent[2]
    return {
        "what": "atlas, 10 mm, processor time",
        "n": sweep.items,
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


def question() -> dict[str, float]:
    """How long an atlas takes to answer [s]; a hundred questions at a time."""
    with tempfile.TemporaryDirectory() as folder:
        run_sweep(ReachSweep(spacing=0.02), Path(folder) / "out")
        atlas = Atlas.read(Path(folder) / "out")
    random = np.random.default_rng(0)
    points = random.uniform((-0.3, -0.3, 0.0), (0.4, 0.3, 0.4), (QUESTIONS, 3)).tolist()

    def ask(some: list[list[float]]) -> None:
        for x, y, z in some:
            atlas.at(x, y, z)

    batches = [points[k : k + 100] for k in range(0, QUESTIONS, 100)]
    _, times = _common.measure(ask, batches)
    return _common.summary(np.array(times) / 100.0)


def main() -> None:
    """Run everything and write the result."""
    _common.single_thread()
    rows: list[_common.Row] = [
        {"what": "atlas, 10 mm", "n": ATLAS.items, "a second and core": rate(ATLAS)}
    ]
    for name in ("empty", "table", "shelf"):
        sweep = PlansSweep(count=PLANS, scenes=(scene_text(SCENES[name]),), voltage=None)
        rate_of = rate(sweep)
        night = 2 * 8 * 3600 * rate_of
        rows.append(
            {
                "what": f"plans, {name}",
                "n": PLANS,
                "a second and core": rate_of,
                "a night of 8 h on two cores": night,
            }
        )
    rows.append({"what": "question to an atlas", **question()})
    rows.append(shares(ATLAS))
    one, two = wall(ATLAS, 1), wall(ATLAS, 2)
    rows += [
        {"what": "atlas, 10 mm, two workers, times one", "n": ATLAS.items, "times one": one / two}
    ]
    _common.write("bench_sweep", rows)


if __name__ == "__main__":
    main()
