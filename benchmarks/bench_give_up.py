"""How long after a plan is cancelled its planning process is free again.

The real planning process plans, and each plan is cancelled at a random moment.
What it was doing then is different for each row: searching and shortening (moves around a table and
into a shelf, and one to a goal that cannot be reached), following lines, timing and verifying (150
waypoints), and taking in a scene of a million points. Likewise how long closing takes with eight
plans pending that cannot be found.

Run: ``python -m benchmarks.bench_give_up``.
"""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks import _common
from benchmarks._machine import awake
from benchmarks.plan_problems import SCENES, problems
from so101_motion.arm.planning_process import PlanningProcess
from so101_motion.arm.planning_worker import PlanningWorker
from so101_motion.common.errors import PlanningError
from so101_motion.common.geometry import SE3
from so101_motion.planning.collision.scene import Box, Obstacle, PointCloud, Scene
from so101_motion.planning.goals import Goal, JointGoal, LineGoal, PathGoal
from so101_motion.planning.kinematics.model import RobotModel
from so101_motion.planning.request import PlanRequest
from so101_motion.planning.timing.limits import MotionLimits

N = 200
LIMITS = MotionLimits.uniform(velocity=3.0, acceleration=10.0, jerk=500.0)
POINTS = 1_000_000


def moves(model: RobotModel, name: str) -> Iterator[PlanRequest]:
    """Moves from one random configuration to another."""
    for start, goal in problems(model, name, N):
        yield _request(start, JointGoal(q=goal), SCENES[name])


def lines(model: RobotModel, name: str) -> Iterator[PlanRequest]:
    """Straight lines of the tool between random configurations."""
    for start, goal in problems(model, name, N):
        yield _request(start, LineGoal(T_base_tool=model.frame(goal)), SCENES[name])


def paths(model: RobotModel, _: str) -> Iterator[PlanRequest]:
    """Paths through 150 waypoints that are near each other."""
    random = np.random.default_rng(0)
    for _n in range(N):
        steps = random.uniform(-0.15, 0.15, (151, 5)).cumsum(axis=0)
        q = np.abs((steps + 0.4) % 1.6 - 0.8) - 0.4
        yield _request(q[0], PathGoal(waypoints=q[1:], tolerance=0.02), Scene(floor_z=None))


def unreachable(model: RobotModel, _: str) -> Iterator[PlanRequest]:
    """A move to behind a wall, searched for two seconds."""
    for _n in range(N):
        yield behind_wall(2.0)


def clouds(model: RobotModel, _: str) -> Iterator[PlanRequest]:
    """A short move beside a cloud that is new each time, on the faces of a box as a camera sees."""
    random = np.random.default_rng(0)
    q = np.zeros(5)
    for _n in range(N // 4):
        points = random.uniform(-0.1, 0.1, (POINTS, 3))
        points[np.arange(POINTS), random.integers(0, 3, POINTS)] = 0.1
        cloud = PointCloud(points=points, resolution=0.01)
        there = Obstacle(
            name="cloud", shape=cloud, T_base_obstacle=SE3.from_translation((0.0, 0.4, 0.15))
        )
        yield _request(q, JointGoal(q=q + 0.2), Scene(obstacles=(there,)))


def behind_wall(budget: float) -> PlanRequest:
    """A goal that is free, and that no path leads to."""
    q = np.radians([60.0, 0.0, 0.0, 0.0, 0.0])
    around = tuple(
        Obstacle(
            name=name, shape=Box(size=np.array(size)), T_base_obstacle=SE3.from_translation(at)
        )
        for name, size, at in (
            ("wall", (0.6, 0.02, 1.2), (0.39, 0.0, 0.6)),
            ("roof", (1.0, 1.0, 0.02), (0.0, 0.0, 0.3)),
        )
    )
    return _request(q, JointGoal(q=-q), Scene(obstacles=around), budget)


def _request(q: np.ndarray, goal: Goal, scene: Scene, budget: float = 5.0) -> PlanRequest:
    return PlanRequest(q_start=q, goal=goal, limits=LIMITS, scene=scene, time_budget=budget)


def row(process: PlanningProcess, what: str, requests: Iterator[PlanRequest]) -> _common.Row:
    """How long it takes until plans are given up, each at a random moment."""
    random = np.random.default_rng(1)
    durations: list[float] = []
    latencies: list[float] = []
    finished = 0
    for number, request in enumerate(requests):
        unwanted = threading.Event()
        told = [0.0]

        def leave(unwanted: threading.Event = unwanted, told: list[float] = told) -> None:
            told[0] = time.perf_counter()
            unwanted.set()
            process.wake()

        typical = float(np.median(durations)) if durations else 0.0
        timer = threading.Timer(random.uniform(0.0, 1.0) * typical, leave)
        begin = time.perf_counter()
        if number >= 5:  # the first few say how long a plan takes
            timer.start()
        try:
            is_given_up = process.ask(request, unwanted.is_set) is None
        except PlanningError:
            is_given_up = False
        end = time.perf_counter()
        if number < 5:
            durations.append(end - begin)
            continue
        timer.cancel()
        timer.join()
        if is_given_up:
            latencies.append(end - told[0])
        else:
            finished += 1
    return {
        "what": what,
        **_common.summary(latencies),
        "finished before": finished,
        "a plan takes (ms)": round(1e3 * float(np.median(durations)), 1),
    }


def closing_row() -> _common.Row:
    """How long closing takes with eight plans pending that cannot be found."""
    times = []
    for _ in range(5):
        worker = PlanningWorker()
        worker.start().result()
        answers = [worker.plan(behind_wall(30.0)) for _ in range(8)]
        threading.Event().wait(0.2)
        begin = time.perf_counter()
        worker.close()
        times.append(time.perf_counter() - begin)
        assert all(answer.exception() is not None for answer in answers)
    return {"what": "closing with 8 plans pending", **_common.summary(times)}


def main() -> None:
    """Run everything and write the result."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    model = RobotModel.load()
    process = PlanningProcess()
    process.wait_until_ready()
    kinds: tuple[tuple[str, Callable[[RobotModel, str], Iterator[PlanRequest]], str], ...] = (
        ("moves, empty", moves, "empty"),
        ("moves, table", moves, "table"),
        ("moves, across the table", moves, "opposite"),
        ("moves, shelf", moves, "shelf"),
        ("lines, empty", lines, "empty"),
        ("lines, table", lines, "table"),
        ("lines, shelf", lines, "shelf"),
        ("150 waypoints", paths, ""),
        ("behind a wall", unreachable, ""),
        ("a million points", clouds, ""),
    )
    with awake():
        rows = [row(process, what, make(model, name)) for what, make, name in kinds]
        process.close()
        rows.append(closing_row())
    _common.write("bench_give_up", rows)


if __name__ == "__main__":
    main()
