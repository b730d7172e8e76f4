"""How many plans a second two planning processes make, compared with one.

The problems of ``plan_problems.py``, each four times with another seed, from requests to verified
motions, through ``PlanningWorker.plan_many``. By the wall clock, so nothing else should be running;
the processor time of the children and of this process, which packs and unpacks, shows how far a
machine with more processors could go.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Sequence

import numpy as np

from benchmarks import _common
from benchmarks._machine import cpu_time
from benchmarks.plan_problems import SCENES, problems
from so101_motion.arm.planning_worker import PlanningWorker
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.request import Plan, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
SEEDS = 4
ROUNDS = 3


def requests(model: RobotModel, name: str) -> list[PlanRequest]:
    """The requests of a scene."""
    return [
        PlanRequest(
            q_start=start, goal=JointGoal(q=goal), limits=LIMITS, scene=SCENES[name], seed=seed
        )
        for seed in range(SEEDS)
        for start, goal in problems(model, name)
    ]


def attempt(worker: PlanningWorker, asked: Sequence[PlanRequest]) -> dict[str, float]:
    """Plan all; seconds by the wall clock, of the children and of this process."""
    before, own = sum(map(cpu_time, worker.pids)), time.process_time()
    begin = time.perf_counter()
    outcomes = list(worker.plan_many(asked))
    wall = time.perf_counter() - begin
    return {
        "wall": wall,
        "children": sum(map(cpu_time, worker.pids)) - before,
        "own": time.process_time() - own,
        "made": sum(isinstance(each, Plan) for each in outcomes),
    }


def main() -> None:
    """Run everything and write the result."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    model = RobotModel.load()
    rows: list[_common.Row] = []
    workers = {count: PlanningWorker(workers=count) for count in (1, 2)}
    for name in SCENES:
        asked = requests(model, name)
        runs: dict[int, list[dict[str, float]]] = {count: [] for count in workers}
        for count, worker in workers.items():
            attempt(worker, asked[: 4 * count])  # starts the processes
        for _ in range(ROUNDS):
            for count, worker in workers.items():
                runs[count].append(attempt(worker, asked))
        best = {count: min(each["wall"] for each in runs[count]) for count in workers}
        rows += [
            {
                "what": f"{name}, {count} at once",
                "n": len(asked),
                "made": runs[count][0]["made"],
                "plans a second": len(asked) / best[count],
                "times one": best[1] / best[count],
                "children, ms a plan": 1e3 * _median(runs[count], "children") / len(asked),
                "this process, ms a plan": 1e3 * _median(runs[count], "own") / len(asked),
            }
            for count in workers
        ]
    for worker in workers.values():
        worker.close()
    used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    rows.append({"what": "memory of a child, at the most [MB]", "n": 1, "made": round(used)})
    _common.write("bench_many", rows)


def _median(runs: list[dict[str, float]], key: str) -> float:
    return float(np.median([each[key] for each in runs]))


if __name__ == "__main__":
    main()
