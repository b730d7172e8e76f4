"""How long an easy plan waits: the first of a new process, and one beside another arm's hard ones.

In the second part an arm asks for plans of five seconds, each superseding the one before, on the
planning process that it shares with the other, whose small moves are timed. Wall clock.

Run: ``python -m benchmarks.bench_fair``.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from concurrent.futures import Future

import numpy as np

from benchmarks import _common
from benchmarks.bench_give_up import LIMITS, behind_wall
from so101_motion.arm.planning_worker import PlanningWorker
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.request import Plan, PlanRequest

FIRST = """
import so101_motion as so101
with so101.open("sim") as rig:
    rig.arm.plan(so101.point(0.25, 0.12, 0.15))
"""
MOST = 1.0  # [s]


def first_row(n: int) -> _common.Row:
    """From the start of a program that opens a simulated arm until its end after a plan."""
    _, times = _common.measure(
        lambda _: subprocess.run([sys.executable, "-c", FIRST], check=True),
        range(n),
        clock=time.perf_counter_ns,
    )
    return {"what": "a new program and its first plan", **_common.summary(times)}


def beside_row(n: int) -> _common.Row:
    """Moves of 5 deg of arm b, while arm a asks for what is hard, again and again."""
    worker, hard = PlanningWorker(copies=True), list[Future[Plan]]()
    worker.start().result()

    def ask(k: int) -> None:
        if len(hard) == 4:
            hard.pop(0).cancel()
        hard.append(worker.plan(behind_wall(5.0), owner="a"))
        goal = JointGoal(q=np.radians([5.0 if k % 2 else -5.0, 0.0, 0.0, 0.0, 0.0]))
        worker.plan(PlanRequest(q_start=np.zeros(5), goal=goal, limits=LIMITS), "b").result()

    _, times = _common.measure(ask, range(n), clock=time.perf_counter_ns)
    worker.close()
    late = sum(each > MOST for each in times)
    return {"what": "beside hard ones", **_common.summary(times), "later than 1 s": late}


def main() -> None:
    """Run both, and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=100)
    n = parser.parse_args().n
    _common.write("bench_fair", [first_row(max(n // 5, 1)), beside_row(n)])


if __name__ == "__main__":
    main()
