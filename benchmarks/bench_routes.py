"""How long motions around obstacles take, over the shortest that are known, by route effort.

The first 20 problems of the four sets in ``plan_problems.py`` in which the straight line is
blocked, or most often is. ``results/best_routes.json`` holds the shortest durations that are known:
``--best S`` plans each problem with other seeds and much more effort for S seconds of processor
time, and keeps what is shorter. S was 17 for shelf and slot and 5 for the others, on a busy
machine; 3 seconds more were spent by other code with the same cuts.

Run: ``python -m benchmarks.bench_routes [--best S [SET ...]]``.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks import _common
from benchmarks.plan_problems import SCENES, problems
from so101_motion.planning.goals import JointGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.planner import Planner
from so101_motion.planning.request import ROUTE_EFFORT, PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

SETS = ("shelf", "slot", "opposite", "cage")
COUNT = 20
EFFORTS = (1, 3, ROUTE_EFFORT)
LONG = 64
"""Route effort in the search for the shortest."""
LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
BEST = _common.RESULTS / "best_routes.json"


def requests(model: RobotModel, name: str) -> Iterator[PlanRequest]:
    """The requests of a set; the seed is the problem's number."""
    for seed, (start, goal) in enumerate(problems(model, name, COUNT)):
        yield PlanRequest(
            q_start=start, goal=JointGoal(q=goal), limits=LIMITS, scene=SCENES[name], seed=seed
        )


def row(planner: Planner, name: str, asked: list[PlanRequest], best: list[float]) -> _common.Row:
    """Durations over the best, and the cost of the whole request."""
    plans, times = _common.measure(planner.plan, asked)
    over = np.array([plan.duration for plan in plans]) / best
    return {
        "what": f"{name}, route effort {asked[0].route_effort}",
        "duration over best": float(np.median(over)),
        "at p95": float(np.percentile(over, 95.0)),
        **_common.summary(times),
    }


def improve(planner: Planner, name: str, asked: list[PlanRequest], seconds: float) -> None:
    """Search for shorter motions, and write them to the file of the best."""
    for k, request in enumerate(asked):
        end, found, seed = time.thread_time() + seconds, np.inf, 0
        while time.thread_time() < end:
            seed += 1
            again = replace(request, seed=1000 * seed + k, route_effort=LONG, time_budget=600.0)
            found = min(found, planner.plan(again).duration)
        best = json.loads(BEST.read_text()) if BEST.exists() else {}
        mine = best.setdefault(name, [])
        mine += [float("inf")] * (k + 1 - len(mine))
        mine[k] = min(mine[k], found)
        BEST.write_text(json.dumps(best, indent=1) + "\n")


def main() -> None:
    """Run everything and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--best", nargs="+", metavar="S [SET ...]", default=())
    seconds, *chosen = parser.parse_args().best or (0.0,)
    _common.single_thread()
    model, rows = RobotModel.load(), list[_common.Row]()
    planner = Planner(model)
    planner.warm_up()
    for name in chosen or SETS:
        asked = list(requests(model, name))
        if float(seconds):
            improve(planner, name, asked, float(seconds))
            continue
        for effort in EFFORTS:
            tried = [replace(each, route_effort=effort) for each in asked]
            rows.append(row(planner, name, tried, json.loads(BEST.read_text())[name]))
    if rows:
        _common.write("bench_routes", rows)


if __name__ == "__main__":
    main()
