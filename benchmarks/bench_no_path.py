"""How soon it is told that there is no path, and whether that is ever said of a problem with one.

Without a path: a goal whose lower arm is in a window that the gripper cannot pass, and a goal
between walls that the arm cannot get round, 40 each; from the question to the answer. A few of them
have a path after all. Solvable, 500: paths between up to 60 boards, and slots and windows in a
wall, all 2 mm wider than what must pass (``no_path_problems.py``); both ends are examined without
any search before.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

from benchmarks import _common
from benchmarks.no_path_problems import Problem, cut_off, shut_in, slot, tube
from so101_motion.common.errors import NoPath
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.paths.compiled_search import Deadline, Space
from so101_motion.planning.paths.infeasibility import Closed, Infeasibility
from so101_motion.planning.paths.path import LOOKS, PathFinder

BUDGET = 60.0
CPU = "CPU of the thread"


def closed(model: RobotModel, problem: Problem, looks: int) -> Closed | None:
    """What is said of a problem without a search."""
    collision = CollisionModel(model, problem.scene)
    space = Space(lower=model.lower, upper=model.upper, weights=collision.reach)
    ends = Infeasibility(space, collision, 0.0, problem.path[0], [problem.path[-1]])
    return ends.look(Deadline(BUDGET), looks, 1)


def main() -> None:
    """Run everything and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=500, help="solvable problems")
    parser.add_argument("--looks", type=int, default=LOOKS[-2], help="configurations of a kind")
    options = parser.parse_args()
    _common.single_thread()
    model, rows = RobotModel.load(), list[_common.Row]()
    for name, make in (("shut in", shut_in), ("cut off by walls", cut_off)):
        times, answers = list[float](), Counter[str]()
        for seed in range(min(40, options.n)):
            problem = make(model, seed)
            finder = PathFinder(model, CollisionModel(model, problem.scene))
            begin = time.thread_time_ns()
            try:
                finder.find(problem.path[0], [problem.path[-1]], 5.0)
                answers["found"] += 1
                continue
            except NoPath as error:
                answers["told" if str(error).startswith("there is no path") else "late"] += 1
            times.append((time.thread_time_ns() - begin) * 1e-9)
        rows.append({"what": f"goal {name}", **_common.summary(times), "clock": CPU, **answers})
    times, wrong = [], list[int]()
    for seed in range(options.n):
        problem = (slot if seed % 5 == 0 else tube)(model, seed)
        begin = time.thread_time_ns()
        if closed(model, problem, options.looks) is not None:
            wrong.append(seed)
        times.append((time.thread_time_ns() - begin) * 1e-9)
        if seed % 20 == 0:
            print(seed, wrong, flush=True)
    row = {"what": "solvable", **_common.summary(times), "clock": CPU, "told": len(wrong)}
    rows.append(row)
    _common.write("bench_no_path", rows)


if __name__ == "__main__":
    main()
