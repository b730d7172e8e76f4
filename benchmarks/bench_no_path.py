"""How soon it is told that there is no path, and whether that is ever said of a problem with one.

Without a path: a goal whose lower arm is in a window that the gripper cannot pass, and a goal
between walls that the arm cannot get round, 40 each; from the question to the answer, which counts
as late after ``BUDGET``. A few of them have a path after all. Solvable, 500: paths between up to 60
boards, and slots and windows in a wall, all 2 mm wider than what must pass
(``no_path_problems.py``); both ends are examined without any search before. Budget and times are
processor time. A run that was interrupted is resumed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from benchmarks import _common
from benchmarks.no_path_problems import Problem, cut_off, shut_in, slot, tube
from so101_motion.common.errors import NoPath
from so101_motion.planning.collision.collision import CollisionModel
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.paths.compiled_search import Deadline, Space
from so101_motion.planning.paths.infeasibility import Closed, Infeasibility
from so101_motion.planning.paths.path import LOOKS, PathFinder

CPU = "CPU of the thread"
BUDGET, FOR_EVER = 2.0, 600.0  # time budget of a search, and of an examination [s]
PIECE = 10  # problems between which an interrupted run is resumed
MAKE = {"goal shut in": shut_in, "goal cut off by walls": cut_off}


def told(what: str, seed: int) -> tuple[str, float]:
    """How a search ended, and the processor time it took [s]."""
    model = RobotModel.load()
    problem = MAKE[what](model, seed)
    finder = PathFinder(model, CollisionModel(model, problem.scene))
    begin, answer = time.thread_time(), "found"
    try:
        finder.find(problem.path[0], [problem.path[-1]], BUDGET)
    except NoPath as error:
        answer = "told" if str(error).startswith("there is no path") else "late"
        is_named = bool(error.blockers) and str(error.blockers[0]) in str(error)
        answer += "" if is_named or answer == "late" else " without a name"
    return answer, time.thread_time() - begin


def closed(model: RobotModel, problem: Problem, looks: int) -> Closed | None:
    """What is said of a problem without a search."""
    collision = CollisionModel(model, problem.scene)
    space = Space(lower=model.lower, upper=model.upper, weights=collision.reach)
    ends = Infeasibility(space, collision, 0.0, problem.path[0], [problem.path[-1]])
    return ends.look(Deadline(FOR_EVER), looks, 1)


def is_closed(looks: int, seed: int) -> tuple[bool, float]:
    """Whether it is said of a solvable problem that it has no path, and the time it took [s]."""
    model = RobotModel.load()
    problem = (slot if seed % 5 == 0 else tube)(model, seed)
    begin = time.thread_time()
    return closed(model, problem, looks) is not None, time.thread_time() - begin


def of_all(
    what: str, call: Callable[[int], tuple[Any, float]], n: int, since: str | None
) -> list[tuple[Any, float]]:
    """The answers to problems of one kind."""

    def piece(seeds: range) -> list[tuple[Any, float]]:
        return [call(seed) for seed in seeds]

    pieces = {
        f"{what} {first}": partial(piece, range(first, min(first + PIECE, n)))
        for first in range(0, n, PIECE)
    }
    return sum(_common.in_pieces("bench_no_path", pieces, since), list[tuple[Any, float]]())


def main() -> None:
    """Run everything and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=500, help="solvable problems")
    parser.add_argument("--looks", type=int, default=LOOKS[-2], help="configurations of a kind")
    parser.add_argument(
        "--since", metavar="COMMIT", help="use the pieces of an earlier commit, too"
    )
    options = parser.parse_args()
    _common.single_thread()
    _common.on_processor_time()
    rows = list[_common.Row]()
    for what in MAKE:
        answers = of_all(what, partial(told, what), min(40, options.n), options.since)
        for answer in ("told", "late", "found", "told without a name"):
            times = [took for each, took in answers if each == answer]
            if times:
                rows.append({"what": f"{what}: {answer}", **_common.summary(times), "clock": CPU})
    looks = options.looks
    solvable = of_all(
        f"solvable, {looks} looks", partial(is_closed, looks), options.n, options.since
    )
    wrong = [seed for seed, (each, _) in enumerate(solvable) if each]
    spent = _common.summary([took for _, took in solvable])
    row = {"what": f"solvable, {looks} looks", **spent, "clock": CPU, "told": len(wrong)}
    print("told of solvable problems:", wrong)
    _common.update("bench_no_path", [*rows, row])


if __name__ == "__main__":
    main()
